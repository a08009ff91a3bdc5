"""A job as shots: pure data, generated one after another, so that 720,000 shots need no memory.

shot   one picture to make. Its id is the hash of all inputs that determine its pixels; the pixels
       themselves are not hashed, because two runs differ by 2e-6.
draw   what a job leaves to chance. Draws come from SeedSequence(job.seed, spawn_key=(shape,
       materials, light, occurrence)), where each part is a word of a hash: a shape, material, light
       or view that is added to a job does not change the draws of the others.
camera the job's, or one that each view of each shape draws (manifests.ids.camera_of).
view   a shot without a picture, in a job of geometry alone: shape and viewpoint. Its id is that of
       the geometry file.
order  shape, light, light resolution, tier, materials, rotation, view: what is expensive to change
       in Cycles changes least often.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import msgspec
import numpy as np

from factory.planning.assets import Assets, Light, Material
from factory.planning.job_shapes import Shape
from manifests import ids
from manifests.errors import InputError
from manifests.ids import TEXELS, camera_words, geometry_id, shot_seed
from manifests.schema import Draw, Failure, Job, LightResolution, Record, Split, Tier, View
from manifests.splits import split_of

__all__ = ["TEXELS", "Plan", "Shot", "camera_words", "geometry_id", "shot_seed"]


# fields that a data set's lines have under the same name; a Shot's geometry is an id, theirs a path
REPEATED = (
    "id",
    "shape",
    "materials",
    "light",
    "viewpoint",
    "rotation_texels",
    "tier",
    "light_resolution",
    "seed",
    "split",
)


class Shot(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """One picture to make.

    geometry       id of the geometry file
    materials      one per segment; these, the shape and the light are names in the plan's assets
    picture        False: geometry alone; materials and light are then empty, and split is the
                   shape's side
    geometry_hash  sha256 of the geometry file if a record in the folder names it already, else None
    """

    id: str
    geometry: str
    shape: str
    materials: tuple[str, ...]
    light: str
    viewpoint: int
    rotation_texels: int
    tier: Tier
    light_resolution: LightResolution
    seed: int
    split: Split
    picture: bool = True
    geometry_hash: str | None = None

    def repeated_in(self, line: type[Record | View | Failure]) -> dict[str, Any]:
        """Return the fields {name: value} that a line of this kind has in common with its shot."""
        return {name: getattr(self, name) for name in REPEATED if name in line.__struct_fields__}


def require_shots(shots: int, shapes: Iterable[Shape]) -> None:
    """Raise InputError for a job all of whose shots are left out because `mixed` is false.

    shapes  all shapes of the job
    """
    if not shots:
        sides = " and ".join(sorted({shape.side for shape in shapes}))
        raise InputError(
            "job: mixed",
            "shapes and materials of one split, because it is false",
            f"shapes of {sides} alone, and no material of it",
            "name other shapes or materials, or leave mixed out",
        )


@dataclass(frozen=True)
class Plan:
    """A job with its assets; iterating over it yields its shots.

    fingerprint  of the render settings (factory.planning.fingerprint)
    """

    job: Job
    assets: Assets
    fingerprint: str

    def __len__(self) -> int:
        if not self.job.pictures:
            return len(self.assets.shapes) * self._views
        return (
            sum(len(self.choices(shape)) for shape in self.assets.shapes)
            * len(self.job.lights)
            * self.shots_per_choice
        )

    @property
    def shots_per_choice(self) -> int:
        """Number of shots per shape, choice of materials and light."""
        job = self.job
        rotations = job.rotations.random if isinstance(job.rotations, Draw) else len(job.rotations)
        return self._views * rotations * len(job.tiers) * len(job.light_resolutions) * job.repeats

    @property
    def _views(self) -> int:
        """Number of viewpoints per shape, choice of materials and light."""
        return self.job.views.random if isinstance(self.job.views, Draw) else len(self.job.views)

    def choices(self, shape: Shape) -> Sequence[int | tuple[Material, ...]]:
        """Return the choices of materials for a shape.

        A choice is a tuple with one material per segment, or the number of a draw of materials.
        """
        if self.job.segment_materials:
            is_kept = self.job.mixed or self.split_of_draws(shape) != "mixed"
            return range(self.job.segment_materials if is_kept else 0)
        allowed = [m for m in self.assets.materials if self.job.mixed or m.side == shape.side]
        return [(m,) * shape.segments for m in allowed]

    def split_of_draws(self, shape: Shape) -> Split:
        """Return the split of all draws of materials for a shape."""
        return split_of(shape.side, [m.side for m in self._pool(shape)])

    def _pool(self, shape: Shape) -> list[Material]:
        """Return what materials are drawn from: those of the shape's side, or all without such."""
        materials = self.assets.materials
        return [m for m in materials if m.side == shape.side] or list(materials)

    def __iter__(self) -> Iterator[Shot]:
        """Yield every shot, in the order in which rendering them is fastest."""
        for shape in self.assets.shapes:
            if not self.job.pictures:
                yield from self.views_alone(shape)
                continue
            for light, occurrence in self.lights:
                yield from self.shots_under(shape, light, occurrence)

    def views_alone(self, shape: Shape) -> Iterator[Shot]:
        """Yield the shots of one shape in a job without pictures."""
        for view in ids.views_alone(self.job, shape.hash):
            id_ = geometry_id(shape.hash, self._camera(shape, view), view, self.fingerprint)
            yield Shot(
                id=id_,
                geometry=id_,
                shape=shape.name,
                materials=(),
                light="",
                viewpoint=view,
                rotation_texels=0,
                tier="direct",
                light_resolution="64x128",
                seed=0,
                split=shape.side,
                picture=False,
            )

    def shots_under(self, shape: Shape, light: Light, occurrence: int = 0) -> list[Shot]:
        """Return the shots of one shape under one light, in order."""
        return sorted(self._under(shape, light, occurrence), key=_order)

    @cached_property
    def lights(self) -> list[tuple[Light, int]]:
        """(light, occurrence) of each name in the job.

        A light that the job names twice, or by two names, has the occurrences 0 and 1.
        """
        result: list[tuple[Light, int]] = []
        seen: dict[str, int] = {}
        for name in self.job.lights:
            light = self.assets.lights[name]
            occurrence = seen[light.hash] = seen.get(light.hash, -1) + 1
            result.append((light, occurrence))
        return result

    def _under(self, shape: Shape, light: Light, occurrence: int) -> Iterator[Shot]:
        """Yield the shots of one shape under one light, unordered."""
        for choice in self.choices(shape):
            materials = (
                self._drawn_materials(shape, light, occurrence, choice)
                if isinstance(choice, int)
                else choice
            )
            draw = choice if isinstance(choice, int) else None
            key = ids.combination_key(
                shape.hash, tuple(m.hash for m in materials), light.hash, occurrence, draw
            )
            yield from self._shots(shape, materials, light, key)

    def _drawn_materials(
        self, shape: Shape, light: Light, occurrence: int, draw: int
    ) -> tuple[Material, ...]:
        """Return one drawn material per segment.

        They are of the shape's side if there are any, and different if there are enough.
        """
        pool = self._pool(shape)
        key = (0x5E6, ids.hash_word(shape.hash), ids.hash_word(light.hash), occurrence, draw)
        rng = np.random.default_rng(np.random.SeedSequence(self.job.seed, spawn_key=key))
        return tuple(
            pool[i]
            for i in rng.choice(len(pool), shape.segments, replace=shape.segments > len(pool))
        )

    def _shots(
        self, shape: Shape, materials: tuple[Material, ...], light: Light, key: tuple[int, ...]
    ) -> Iterator[Shot]:
        """Yield the shots of one shape, one choice of materials and one light.

        key  spawn key of their draws
        """
        job, names = self.job, tuple(m.name for m in materials)
        word, views, rotations = ids.draws(job, key)
        split = split_of(shape.side, [m.side for m in materials])
        hashes = tuple(m.hash for m in materials)
        shared: dict[str, Any] = {}  # by camera, which may differ between views
        for view, of_view in zip(views, rotations, strict=True):
            camera = self._camera(shape, view)
            if camera not in shared:
                shared[camera] = ids.shots_digest(
                    self.fingerprint, shape.hash, hashes, light.hash, camera, ids.sampling(job)
                )
            geometry = geometry_id(shape.hash, camera, view, self.fingerprint)
            for rotation, tier, resolution, repeat in product(
                of_view, job.tiers, job.light_resolutions, range(job.repeats)
            ):
                seed = shot_seed(word, ids.shot_place(view, rotation, tier, resolution, repeat))
                yield Shot(
                    id=ids.shot_id(shared[camera], view, rotation, tier, resolution, seed),
                    geometry=geometry,
                    shape=shape.name,
                    materials=names,
                    light=light.name,
                    viewpoint=view,
                    rotation_texels=rotation,
                    tier=tier,
                    light_resolution=resolution,
                    seed=seed,
                    split=split,
                )

    def _camera(self, shape: Shape, view: int) -> str:
        """Return the words of the camera that sees a shape from a viewpoint."""
        if self.job.camera_ranges is None:
            return self._one_camera
        return camera_words(ids.camera_of(self.job, shape.hash, view))

    @cached_property
    def _one_camera(self) -> str:
        return camera_words(self.job.camera)


def _order(shot: Shot) -> tuple:
    """Return the sort key of a shot among those of one shape and light.

    Materials come before rotations: new nodes cost twice as much as a new light (docs/log.md).
    """
    return (
        shot.light_resolution,
        shot.tier,
        shot.materials,
        shot.rotation_texels,
        shot.viewpoint,
        shot.seed,
    )
