"""The shapes, materials and lights that a job names, with their hashes, sides and licences.

Meshes and light maps are read to be hashed, and are not kept. What a job's shapes are can be known
before all of them are read (`resolve_unread`), so that a run begins with the first ones.

source  where a shape or a light is read from: a spec such as "chair:17", or a path
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from factory.planning.duplicates import without_duplicates
from factory.planning.facts import Facts
from factory.planning.job_shapes import Shape, no_shapes_error, shapes_of
from factory.planning.job_values import check
from factory.planning.material_names import choose_entries
from factory.planning.reading import Reading
from factory.planning.shape_names import Source, list_sources, resolve_path
from factory.shapes.files import require_mesh_file
from factory.shapes.mesh_import import split_place
from manifests import splits
from manifests.errors import InputError
from manifests.materials import Entry
from manifests.schema import Job, Side


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
    assets = resolve_unread(job, folder, library, catalogues)
    with closing(Reading(assets.unread, processes)) as reading:
        facts = (watch or _unwatched)(
            reading.each(), desc="reading shapes", unit="shape", total=reading.unread
        )
        return add_shapes(job, assets, facts)


def resolve_unread(
    job: Job,
    folder: str | Path | None = None,
    library: str | None = None,
    catalogues: Sequence[str | Path] = (),
) -> Assets:
    """Return the Assets of a job before any shape is read; the arguments are those of `resolve`.

    Raises  InputError as `resolve` does, but of the shapes it checks only names and paths
    """
    check(job)
    notes: list[str] = []
    materials = without_duplicates(_materials(job, catalogues), "material", notes)
    lights = _lights(job, folder, library)
    unread = tuple(dict.fromkeys(list_sources(job, folder)))
    if not unread:
        raise no_shapes_error(job)
    for source in unread:
        if source.is_file:  # a name that is mistyped is refused before anything is written
            require_mesh_file(split_place(source.place)[0])
    return Assets([], materials, lights, notes, unread)


def add_shapes(job: Job, assets: Assets, facts: Iterable[tuple[Source, Facts]]) -> Assets:
    """Return the Assets with all shapes.

    facts   what was read about each shape, in the job's order

    Raises  InputError: two meshes of one name, no shape with a role of the job
    """
    notes = list(assets.notes)
    shapes = without_duplicates(shapes_of(job, facts), "shape", notes)
    if not shapes:
        raise no_shapes_error(job)
    return replace(assets, shapes=shapes, notes=notes, unread=())


def _unwatched(items: Iterable, **_: Any) -> Iterable:
    return items


def _materials(job: Job, catalogues: Sequence[str | Path]) -> list[Material]:
    chosen = choose_entries(job.materials, catalogues)
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
        source = str(resolve_path(name, folder, "job: lights")) if is_light_path(name) else name
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
