"""The shapes, materials and lights that a job names, with their hashes, sides and licences.

Meshes and light maps are read to be hashed, and are not kept.

source     where a shape or a light is read from: a spec such as "chair:17", or a path
duplicate  the same mesh, fit or map under a second name. It is left out, because its pictures would
           be those of the first.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from factory.planning.material_names import chosen_entries
from factory.planning.shape_names import Source, load_mesh, local, sources
from manifests import splits
from manifests.errors import InputError
from manifests.materials import Entry
from manifests.schema import CameraRanges, Draw, Job, Role, Side


class Shape(msgspec.Struct, frozen=True, kw_only=True):
    """A shape of a job; segments: number of regions that get a material each."""

    name: str
    source: Source
    category: str
    hash: str
    segments: int
    side: Side
    role: Role
    licence: str
    report: str


class Material(msgspec.Struct, frozen=True, kw_only=True):
    """A material of a job; entry: its entry in a catalogue, which materials.json repeats."""

    name: str
    hash: str
    side: Side
    licence: str
    source: str
    entry: Entry


@dataclass(frozen=True, eq=False)
class Light:
    """A light of a job.

    origin  where the map comes from, for credits
    L64     (64, 128, 3), the map that the data set stores
    """

    name: str
    source: str
    hash: str
    scale: float
    licence: str
    origin: str
    L64: np.ndarray


@dataclass(frozen=True)
class Assets:
    """Everything that a job names.

    lights  by the names that the job uses
    notes   one line for each asset that was left out
    """

    shapes: list[Shape]
    materials: list[Material]
    lights: dict[str, Light]
    notes: list[str] = field(default_factory=list)


Asset = TypeVar("Asset", Shape, Material)
Watch = Callable[..., Iterable]  # as tqdm: (items, desc=, unit=) → items


def resolve(
    job: Job,
    folder: str | Path | None = None,
    library: str | None = None,
    catalogues: Sequence[str | Path] = (),
    watch: Watch | None = None,
) -> Assets:
    """Return the Assets of a job.

    folder      where the job's relative paths start; a path that leaves it is refused. None: paths
                may lead anywhere
    library     a folder of the user's light maps, or None
    catalogues  files of materials besides the built-in ones
    watch       wraps an iterable to show its progress, as tqdm does, or None
    Raises      InputError: an unknown name, a broken file, a path that leaves the folder, a job
                without shapes
    """
    check(job)
    notes: list[str] = []
    materials = _without_duplicates(_materials(job, catalogues), "material", notes)
    lights = _lights(job, folder, library)
    shapes = _without_duplicates(_shapes(job, folder, watch or _unwatched), "shape", notes)
    if not shapes:
        raise InputError(
            "job: shapes",
            f"some with a role among {', '.join(job.roles)}",
            "none",
            "widen shapes or roles",
        )
    return Assets(shapes, materials, lights, notes)


def check(job: Job) -> None:
    """Raise InputError for values that repeat, draws of too many values, and empty ranges."""
    _check_ranges(job.camera_ranges)
    for key, most in (("views", 24), ("rotations", 128)):
        value = getattr(job, key)
        if isinstance(value, Draw):
            if value.random > most:
                raise InputError(
                    f"job: {key}.random",
                    f"at most {most}",
                    str(value.random),
                    f"there are {most} different ones",
                )
        elif len(set(value)) < len(value):
            raise InputError(
                f"job: {key}",
                "each number once",
                f"{sorted({v for v in value if value.count(v) > 1})} twice",
                "name each once",
            )
    for key in ("tiers", "light_resolutions"):
        value = getattr(job, key)
        if len(set(value)) < len(value):
            raise InputError(f"job: {key}", "each name once", ", ".join(value), "name each once")


def _check_ranges(ranges: CameraRanges | None) -> None:
    """Raise InputError for a range whose lowest value is above its highest."""
    for key in ("elevation_deg", "roll_deg", "fov_deg"):
        span = getattr(ranges, key, None)
        if span and span[0] > span[1]:
            raise InputError(
                f"job: camera_ranges.{key}",
                "[lowest, highest]",
                f"[{span[0]:g}, {span[1]:g}]",
                "write the lower value first",
            )


def _unwatched(items: Iterable, **_: Any) -> Iterable:
    return items


def _shapes(job: Job, folder: str | Path | None, watch: Watch) -> list[Shape]:
    result: dict[str, tuple[Source, str, str, int, str]] = {}
    for source in watch(
        list(dict.fromkeys(sources(job, folder))), desc="reading shapes", unit="shape"
    ):
        mesh = load_mesh(source)
        known = result.setdefault(
            mesh.name, (source, mesh.category, mesh.hash, mesh.segments, mesh.report.line())
        )
        if known[2] != mesh.hash:
            raise InputError(
                f"shape '{mesh.name}'",
                "one mesh under a name",
                f"{known[0].place} and {source.place}",
                "rename one of the files",
            )
    roles = splits.shape_roles(
        [(name, category, hash_) for name, (_, category, hash_, _, _) in result.items()], job.split
    )
    requested = set(job.roles) or set(splits.SIDES)
    return [
        Shape(
            name=name,
            source=source,
            category=category,
            hash=hash_,
            segments=segments,
            side=splits.SIDES[roles[name]],
            role=roles[name],
            licence=source.licence,
            report=report,
        )
        for name, (source, category, hash_, segments, report) in result.items()
        if roles[name] in requested
    ]


def _materials(job: Job, catalogues: Sequence[str | Path]) -> list[Material]:
    chosen = chosen_entries(job.materials, catalogues)
    sides = splits.material_sides([(e.name, e.split, e.hash) for e in chosen])
    return [
        Material(
            name=e.name,
            hash=e.hash,
            side=sides[e.name],
            licence=e.licence,
            source=e.source,
            # a duplicate that is left out may have moved it to the test side
            entry=msgspec.structs.replace(e, split=sides[e.name]),
        )
        for e in chosen
    ]


def _lights(job: Job, folder: str | Path | None, library: str | None) -> dict[str, Light]:
    from factory.lights import load
    from factory.lights.files import is_light_path

    result = {}
    for name in dict.fromkeys(job.lights):
        source = str(local(name, folder, "job: lights")) if is_light_path(name) else name
        light = load(source, library)
        result[name] = Light(
            name=light.name,
            source=source,
            hash=light.hash,
            scale=light.scale,
            licence=light.licence,
            origin=light.source,
            L64=light.L64,
        )
    return result


def _without_duplicates(assets: Iterable[Asset], kind: str, notes: list[str]) -> list[Asset]:
    """Return each asset once by its hash. Raises InputError for two assets of one name."""
    by_hash: dict[str, Asset] = {}
    names: set[str] = set()
    for asset in assets:
        if asset.hash in by_hash:
            if asset.name != by_hash[asset.hash].name:
                notes.append(
                    f"{kind} '{asset.name}' is '{by_hash[asset.hash].name}' again, left out"
                )
            continue
        if asset.name in names:
            raise InputError(
                f"{kind} '{asset.name}'",
                "one thing under a name",
                "two that differ",
                "rename one of the files",
            )
        by_hash[asset.hash] = asset
        names.add(asset.name)
    return list(by_hash.values())
