"""The shapes that a job's names mean.

"chair:0-39" is a range, "meshes/" a folder, "stool.obj?up=z" a file with reading options.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from manifests import splits
from manifests.errors import InputError
from manifests.inputs import split_path
from manifests.schema import Job

if TYPE_CHECKING:
    from factory.shapes.mesh import Mesh

RANGE = re.compile(r"^(\w+):([0-9]{1,100})-([0-9]{1,100})$")
OWN_LICENCE = "Apache-2.0"  # shapes that this program's families make
MOST_SHAPES = 1_000_000


class Source(msgspec.Struct, frozen=True):
    """Where a mesh is read from.

    place           what factory.shapes.catalogue.load takes
    name, category  None: those of the mesh itself
    """

    place: str
    name: str | None = None
    category: str | None = None
    licence: str = OWN_LICENCE

    @property
    def is_file(self) -> bool:
        """Whether the mesh is read from a file, and not made from a name such as "chair:17"."""
        return any(mark in self.place for mark in "/\\.")


def load_mesh(source: Source) -> Mesh:
    """Return the Mesh of a Source."""
    from factory.shapes.catalogue import load

    options = {"name": source.name, "category": source.category}
    return load(source.place, **{k: v for k, v in options.items() if v is not None})


def list_sources(job: Job, folder: str | Path | None) -> Iterator[Source]:
    """Yield the Source of every shape of a job.

    Shapes whose number alone gives them a role that the job leaves out are not yielded.

    folder  where relative paths start, None: paths may lead anywhere
    Raises  InputError: a malformed range, a path that leaves the folder or does not exist
    """
    for spec in job.shapes:
        if span := RANGE.match(spec):
            specs = _numbers(spec, span[1], int(span[2]), int(span[3]))
        elif is_shape_path(spec):
            yield from _files(spec.removeprefix("file:"), folder)
            continue
        else:
            specs = [spec]  # for an unknown name the catalogue's error lists close ones
        for one in specs:
            role = splits.numbered_role(one, job.split)
            if role is None or not job.roles or role in job.roles:
                yield Source(one)


def is_shape_path(spec: str) -> bool:
    """Return whether a job's shape is a path of meshes rather than a name such as "chair:17"."""
    is_name = RANGE.match(spec) or _is_family(spec)
    return not is_name and any(mark in spec for mark in "/\\.")


def locate(path: str, folder: str | Path) -> str:
    """Return a path, or that path in a folder if something lies there and nothing where it leads.

    path  with a member ("#NAME") and reading options ("?up=z") if there are any
    """
    place = path.removeprefix("file:")
    if os.path.exists(split_path(place)[0]):
        return path
    inner = os.path.exists(Path(folder) / split_path(place, folder=folder)[0])
    return str(Path(folder) / place) if inner else path


def resolve_path(path: str, folder: str | Path | None, where: str) -> Path:
    """Return a path of a job file. Raises InputError if it leaves the folder.

    folder  None: any path is allowed
    where   the key of the job, for the error
    """
    if folder is None:
        return Path(path)
    target = Path(folder) / path
    if Path(path).is_absolute() or ".." in Path(path).parts or not _lies_in(target, Path(folder)):
        remedy = (
            "write it relative to the job file, or pass --assets FOLDER and write it relative to"
            " that"
        )
        raise InputError(
            f"{where} '{path}'", f"a path inside {folder}", "one that leaves it", remedy
        )
    return target


def _lies_in(target: Path, folder: Path) -> bool:
    """Return whether a path, with links followed, leads into a folder.

    A name that no file can have and links in a circle do not.
    """
    try:
        return target.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        return False


def _numbers(spec: str, family: str, first: int, last: int) -> list[str]:
    """Return the specs of a range. Raises InputError."""
    if not first <= last < first + MOST_SHAPES:
        raise InputError(
            f"job: shapes '{spec}'",
            "a range from low to high",
            f"{first} to {last}",
            f"write {family}:0-39",
        )
    return [f"{family}:{number}" for number in range(first, last + 1)]


def _is_family(spec: str) -> bool:
    from factory.shapes.catalogue import FAMILIES, GENERAL, PRIMITIVES

    return spec.partition(":")[0] in (*FAMILIES, *GENERAL, *PRIMITIVES)


def _files(place: str, folder: str | Path | None) -> Iterator[Source]:
    """Yield one mesh file, or every mesh of a folder or a library.

    place  a path, with a member ("#NAME") and reading options ("?up=z") if there are any
    """
    from factory.shapes.libraries import find
    from factory.shapes.library import note_of

    target = resolve_path(place, folder, "job: shapes")
    path, rest = split_path(place, folder=folder)
    target = resolve_path(path, folder, "job: shapes")
    if target.is_dir() or (target.suffix.lower() == ".sh3f" and not rest.startswith("#")):
        if rest.startswith("#"):
            raise InputError(
                f"job: shapes '{place}'",
                "a mesh of a .sh3f library after '#'",
                "a folder",
                "name the mesh's own file",
            )
        for entry in find(target):
            licence = entry.licence or "unstated"
            yield Source(f"{entry.place}{rest}", entry.name, entry.category, licence)
    else:
        note = None if rest.startswith("#") else note_of(target)
        category, licence = (note.category, note.licence) if note else (None, "")
        yield Source(f"{target}{rest}", category=category, licence=licence or "unstated")
