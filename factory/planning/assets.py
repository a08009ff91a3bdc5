"""The shapes, materials and lights that a job names, with their hashes, sides and licences.

Meshes and light maps are read to be hashed, and are not kept. What a job's shapes are can be known
before all of them are read (`opened`), so that a run begins with the first ones.

source     where a shape or a light is read from: a spec such as "chair:17", or a path
duplicate  the same mesh, fit or map under a second name. It is left out, because its pictures would
           be those of the first.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from factory.planning.facts import Facts
from factory.planning.material_names import chosen_entries
from factory.planning.reading import Reading
from factory.planning.shape_names import Source, local, sources
from factory.shapes.files import require_mesh_file
from factory.shapes.mesh_import import split_place
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
    unread  sources of shapes that are not among `shapes` yet; empty where all have been read
    """

    shapes: list[Shape]
    materials: list[Material]
    lights: dict[str, Light]
    notes: list[str] = field(default_factory=list)
    unread: tuple[Source, ...] = ()


Asset = TypeVar("Asset", Shape, Material)
Watch = Callable[..., Iterable]  # as tqdm: (items, desc=, unit=) → items


def resolve(
    job: Job,
    folder: str | Path | None = None,
    library: str | None = None,
    catalogues: Sequence[str | Path] = (),
    watch: Watch | None = None,
    processes: int = 0,
) -> Assets:
    """Return the Assets of a job, after all of its shapes have been read.

    folder      where the job's relative paths start; a path that leaves it is refused. None: paths
                may lead anywhere
    library     a folder of the user's light maps, or None
    catalogues  files of materials besides the built-in ones
    watch       wraps an iterable to show its progress, as tqdm does, or None
    processes   that read meshes, 0: this process reads them
    Raises      InputError: an unknown name, a broken file, a path that leaves the folder, a job
                without shapes
    """
    assets = opened(job, folder, library, catalogues)
    with closing(Reading(assets.unread, processes)) as reading:
        facts = (watch or _unwatched)(
            reading.each(), desc="reading shapes", unit="shape", total=reading.unread
        )
        return read_whole(job, assets, facts)


def opened(
    job: Job,
    folder: str | Path | None = None,
    library: str | None = None,
    catalogues: Sequence[str | Path] = (),
) -> Assets:
    """Return the Assets of a job, all of its shapes unread; the arguments are those of `resolve`.

    Raises  InputError as `resolve`, but for the shapes' names and paths alone
    """
    check(job)
    notes: list[str] = []
    materials = _without_duplicates(_materials(job, catalogues), "material", notes)
    lights = _lights(job, folder, library)
    unread = tuple(dict.fromkeys(sources(job, folder)))
    if not unread:
        raise without_shapes(job)
    for source in unread:
        if source.is_file:  # a name that is mistyped is refused before anything is written
            require_mesh_file(split_place(source.place)[0])
    return Assets([], materials, lights, notes, unread)


def read_whole(job: Job, assets: Assets, facts: Iterable[tuple[Source, Facts]]) -> Assets:
    """Return the Assets with all shapes, of which the facts are given in the job's order.

    Raises  InputError: two meshes of one name, no shape with a role of the job
    """
    notes = list(assets.notes)
    shapes = _without_duplicates(_shapes(job, facts), "shape", notes)
    if not shapes:
        raise without_shapes(job)
    return replace(assets, shapes=shapes, notes=notes, unread=())


def follows_alone(job: Job, unread: Iterable[Source]) -> bool:
    """Return whether each shape's role follows from the shape, whatever the others are.

    It does not where a rule has ranges and there are mesh files: these stand by the rank of their
    hashes, and a file may be a duplicate of a numbered shape.
    """
    return not splits.rules()[job.split]["shapes"] or not any(source.is_file for source in unread)


class Arrivals:
    """The shapes of a job whose roles follow from each alone, taken one by one in any order."""

    def __init__(self, job: Job):
        self._job = job
        self._by_name: dict[str, tuple[Source, str]] = {}
        self._by_hash: dict[str, tuple[str, Role]] = {}

    def take(self, source: Source, facts: Facts) -> Shape | None:
        """Return a source's shape, None if its role is none of the job's; duplicates come, too.

        Raises  InputError: two meshes of one name, a duplicate with another role
        """
        first, hash_ = self._by_name.setdefault(facts.name, (source, facts.hash))
        _require_same(facts, source, first, hash_)
        role = splits.shape_roles([(facts.name, facts.category, facts.hash)], self._job.split)
        shape = _shape(source, facts, role[facts.name])
        _require_same_role(shape, *self._by_hash.setdefault(facts.hash, (shape.name, shape.role)))
        return shape if shape.role in _requested(self._job) else None

    @property
    def is_empty(self) -> bool:
        """Whether no shape that was taken has a role of the job."""
        return not any(role in _requested(self._job) for _, role in self._by_hash.values())


def duplicate_note(shape: Shape, first: str, role: Role) -> str | None:
    """Return the line that says that a shape is left out, None for the same mesh and name.

    first, role  name and role of the shape that is kept
    Raises       InputError for another role
    """
    _require_same_role(shape, first, role)
    return None if shape.name == first else _left_out("shape", shape.name, first)


def _require_same_role(shape: Shape, first: str, role: Role) -> None:
    """Raise InputError for a duplicate whose role is not that of the first shape of its mesh."""
    if shape.role != role:
        raise InputError(
            f"shape '{shape.name}'",
            f"role {role}, as '{first}', which is the same mesh",
            shape.role,
            "leave one of them out of the job",
        )


def without_shapes(job: Job) -> InputError:
    """Return the error of a job none of whose shapes has a role of the job."""
    return InputError(
        "job: shapes",
        f"some with a role among {', '.join(job.roles)}",
        "none",
        "widen shapes or roles",
    )


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


def _shapes(job: Job, read: Iterable[tuple[Source, Facts]]) -> list[Shape]:
    """Return the shapes with a role of the job, each name once."""
    result: dict[str, tuple[Source, Facts]] = {}
    for source, facts in read:
        first, known = result.setdefault(facts.name, (source, facts))
        _require_same(facts, source, first, known.hash)
    roles = splits.shape_roles(
        [(name, facts.category, facts.hash) for name, (_, facts) in result.items()], job.split
    )
    return [
        _shape(source, facts, roles[name])
        for name, (source, facts) in result.items()
        if roles[name] in _requested(job)
    ]


def _requested(job: Job) -> Collection[Role]:
    """Return the roles that a job keeps."""
    return job.roles or splits.SIDES


def _require_same(facts: Facts, source: Source, first: Source, hash_: str) -> None:
    """Raise InputError if a shape's hash is not that of the first shape of its name."""
    if facts.hash != hash_:
        raise InputError(
            f"shape '{facts.name}'",
            "one mesh under a name",
            f"{first.place} and {source.place}",
            "rename one of the files",
        )


def _shape(source: Source, facts: Facts, role: Role) -> Shape:
    return Shape(
        name=facts.name,
        source=source,
        category=facts.category,
        hash=facts.hash,
        segments=facts.segments,
        side=splits.SIDES[role],
        role=role,
        licence=source.licence,
        report=facts.report,
    )


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
    """Return the lights by the job's names. Raises InputError for two maps of one name."""
    from factory.lights import load
    from factory.lights.files import is_light_path

    result: dict[str, Light] = {}
    by_name: dict[str, tuple[str, str]] = {}  # (the job's name, hash)
    for name in dict.fromkeys(job.lights):
        source = str(local(name, folder, "job: lights")) if is_light_path(name) else name
        light = load(source, library)
        first, hash_ = by_name.setdefault(light.name, (name, light.hash))
        if light.hash != hash_:  # records and entries know a light by its name
            raise InputError(
                f"light '{light.name}'",
                "one map under a name",
                f"{first} and {name}",
                "rename one of the files",
            )
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


def _left_out(kind: str, name: str, first: str) -> str:
    return f"{kind} '{name}' is '{first}' again, left out"


def _without_duplicates(assets: Iterable[Asset], kind: str, notes: list[str]) -> list[Asset]:
    """Return each asset once by its hash. Raises InputError for two assets of one name."""
    by_hash: dict[str, Asset] = {}
    names: set[str] = set()
    for asset in assets:
        if asset.hash in by_hash:
            if asset.name != by_hash[asset.hash].name:
                notes.append(_left_out(kind, asset.name, by_hash[asset.hash].name))
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
