"""A job as shots: pure data, made one after another and never all held, so that 720,000 of them
need no memory.

shot      one picture to make; its id is the hash of all that determines its pixels (inputs, never
pixels: two runs differ by 2e-6)
draw      what a job leaves to chance comes from SeedSequence(job.seed, spawn_key=(shape, materials,
light, occurrence)), each a hash
          of what it is: adding a shape, a material, a light or a view to a job alters nobody else's
          draws
view      a shot without a picture, of a job that wants geometry alone: shape and viewpoint; its id
is the geometry file's
order     shape, light, light resolution, tier, materials, rotation, view: what is dear to change
changes least (persistent data pays)
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import msgspec
import numpy as np

from factory.planning.assets import Assets
from manifests import ids
from manifests.ids import TEXELS, camera_words, geometry_id, shot_seed
from manifests.schema import Draw, Failure, Job, LightResolution, Record, Tier, View
from manifests.splits import split_of

__all__ = ["TEXELS", "Plan", "Shot", "camera_words", "geometry_id", "shot_seed"]


# Fields of a Shot that the lines of a data set repeat as they are; its geometry is an id, theirs a
# path
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
    """One picture to make. Shape, materials (one a segment) and light are names in the plan's
    assets; geometry is a geometry file's id.

    picture        False: geometry alone; materials and light are empty then, and split is the
    shape's side
    geometry_hash  sha256 of the geometry file where a record of the folder names it already; None:
    no record does
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
    split: str
    picture: bool = True
    geometry_hash: str | None = None

    def repeated_in(self, line: type[Record | View | Failure]) -> dict[str, Any]:
        """{field: value} of what a line of this kind repeats of its shot, under the same names."""
        return {name: getattr(self, name) for name in REPEATED if name in line.__struct_fields__}


@dataclass(frozen=True)
class Plan:
    """A job whose names are resolved.

    assets  shapes, materials and lights of the job, hashed
    render  fingerprint of the settings in force (factory.planning.fingerprint)
    """

    job: Job
    assets: Assets
    render: str

    def __len__(self):
        if not self.job.pictures:
            return len(self.assets.shapes) * self._views
        return (
            sum(len(self.choices(shape)) for shape in self.assets.shapes)
            * len(self.job.lights)
            * self.each
        )

    @property
    def each(self):
        """Shots of one shape, one choice of materials and one light."""
        job = self.job
        rotations = job.rotations.random if isinstance(job.rotations, Draw) else len(job.rotations)
        return self._views * rotations * len(job.tiers) * len(job.light_resolutions) * job.repeats

    @property
    def _views(self):
        """Viewpoints of each combination."""
        return self.job.views.random if isinstance(self.job.views, Draw) else len(self.job.views)

    def choices(self, shape):
        """What a shape may be made of: (materials, one a segment; or a number, of a draw not yet
        made).
        """
        if self.job.segment_materials:
            return range(self.job.segment_materials)
        kept = [m for m in self.assets.materials if self.job.mixed or m.side == shape.side]
        return [(m,) * shape.segments for m in kept]

    def __iter__(self):
        """Every shot, in the order in which they are best made."""
        for shape in self.assets.shapes:
            if not self.job.pictures:
                yield from self.views_alone(shape)
                continue
            for light, occurrence in self.lights:
                yield from self.group(shape, light, occurrence)

    def views_alone(self, shape):
        """The shots of one shape in a job without pictures."""
        for view in ids.views_alone(self.job, shape.hash):
            id_ = geometry_id(shape.hash, self._camera, view, self.render)
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

    def group(self, shape, light, occurrence=0):
        """The shots of one shape under one light, in order."""
        return sorted(self._under(shape, light, occurrence), key=_order)

    @cached_property
    def lights(self):
        """(light, occurrence) of each name in the job: a light named twice, or under two names,
        occurs as 0 and 1.
        """
        result, seen = [], {}
        for name in self.job.lights:
            light = self.assets.lights[name]
            occurrence = seen[light.hash] = seen.get(light.hash, -1) + 1
            result.append((light, occurrence))
        return result

    def _under(self, shape, light, occurrence):
        """The shots of one shape under one light, unordered."""
        for choice in self.choices(shape):
            materials = (
                self._drawn_materials(shape, light, occurrence, choice)
                if isinstance(choice, int)
                else choice
            )
            draw = choice if isinstance(choice, int) else None
            key = ids.combination_key(
                shape.hash, [m.hash for m in materials], light.hash, occurrence, draw
            )
            yield from self._shots(shape, materials, light, key)

    def _drawn_materials(self, shape, light, occurrence, draw):
        """One material a segment, different ones while there are enough, all of the shape's own
        side while there is one.
        """
        pool = [m for m in self.assets.materials if m.side == shape.side] or list(
            self.assets.materials
        )
        key = (0x5E6, ids.hash_word(shape.hash), ids.hash_word(light.hash), occurrence, draw)
        rng = np.random.default_rng(np.random.SeedSequence(self.job.seed, spawn_key=key))
        return tuple(
            pool[i]
            for i in rng.choice(len(pool), shape.segments, replace=shape.segments > len(pool))
        )

    def _shots(self, shape, materials, light, key):
        """The shots of one shape, one choice of materials and one light."""
        job, names = self.job, tuple(m.name for m in materials)
        word, views, turns = ids.draws(job, key)
        split = split_of(shape.side, [m.side for m in materials])
        hashes = tuple(m.hash for m in materials)
        shared = ids.shots_digest(
            self.render, shape.hash, hashes, light.hash, self._camera, job.samples
        )
        for view, rotations in zip(views, turns, strict=True):
            geometry = geometry_id(shape.hash, self._camera, view, self.render)
            for turn, tier, resolution, repeat in product(
                rotations, job.tiers, job.light_resolutions, range(job.repeats)
            ):
                seed = shot_seed(word, ids.shot_place(view, turn, tier, resolution, repeat))
                yield Shot(
                    id=ids.shot_id(shared, view, turn, tier, resolution, seed),
                    geometry=geometry,
                    shape=shape.name,
                    materials=names,
                    light=light.name,
                    viewpoint=view,
                    rotation_texels=turn,
                    tier=tier,
                    light_resolution=resolution,
                    seed=seed,
                    split=split,
                )

    @cached_property
    def _camera(self):
        return camera_words(self.job.camera)


def _order(shot):
    """Sort key of shots under one shape and light. Materials before rotations: new nodes cost twice
    what a new light does (docs/log.md).
    """
    return (
        shot.light_resolution,
        shot.tier,
        shot.materials,
        shot.rotation_texels,
        shot.viewpoint,
        shot.seed,
    )
