"""The shapes that a job names, one by one: "chair:0-39" a range, "meshes/" a folder,
"stool.obj?up=z" a file with reading options.
"""

import re
from pathlib import Path

import msgspec

from manifests import splits
from manifests.errors import InputError

RANGE = re.compile(r"^(\w+):([0-9]{1,100})-([0-9]{1,100})$")
MARK = re.compile(r"[#?]")
OWN_LICENCE = "Apache-2.0"  # shapes that this program's families make
MOST_SHAPES = 1_000_000


class Source(msgspec.Struct, frozen=True):
    """Where a mesh is read from: what factory.shapes.catalogue.load takes; name and category: None,
    the mesh's own.
    """

    place: str
    name: str | None = None
    category: str | None = None
    licence: str = OWN_LICENCE


def load_mesh(source):
    """The Mesh of a Source."""
    from factory.shapes.catalogue import load

    return load(
        source.place,
        **{
            k: v for k, v in (("name", source.name), ("category", source.category)) if v is not None
        },
    )


def sources(job, folder):
    """The Source of every shape of a job; what a number alone rules out is not even named.

    folder  where relative paths start and end, None: paths may lead anywhere
    Raises  InputError: a range that is none, a path that leaves the folder or leads nowhere
    """
    for spec in job.shapes:
        if span := RANGE.match(spec):
            specs = _numbers(spec, span[1], int(span[2]), int(span[3]))
        elif not _is_family(spec) and any(mark in spec for mark in "/\\."):
            yield from _files(spec.removeprefix("file:"), folder)
            continue
        else:
            specs = [spec]  # of an unknown name the catalogue says which are near
        for one in specs:
            role = splits.numbered_role(one, job.split)
            if role is None or not job.roles or role in job.roles:
                yield Source(one)


def local(path, folder, where):
    """A path of a job file, within its folder. Raises InputError if it leaves it; folder None: any
    path.
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


def _lies_in(target, folder):
    """Whether a path leads into a folder, links followed; a name that no file can have, or links in
    a circle, lead nowhere.
    """
    try:
        return target.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        return False


def _numbers(spec, family, first, last):
    if not first <= last < first + MOST_SHAPES:
        raise InputError(
            f"job: shapes '{spec}'",
            "a range from low to high",
            f"{first} to {last}",
            f"write {family}:0-39",
        )
    return [f"{family}:{number}" for number in range(first, last + 1)]


def _is_family(spec):
    from factory.shapes.catalogue import FAMILIES, GENERAL, PRIMITIVES

    return spec.partition(":")[0] in (*FAMILIES, *GENERAL, *PRIMITIVES)


def _files(place, folder):
    """A mesh file, with its member and options if it has any; or all that lie in a folder or a
    library.
    """
    from factory.shapes.libraries import find

    target = local(place, folder, "job: shapes")
    # a '#' or '?' of an existing path stays in it
    rest = "" if target.exists() else place[len(MARK.split(place)[0]) :]
    target = local(place.removesuffix(rest), folder, "job: shapes")
    if target.is_dir() or (target.suffix.lower() == ".sh3f" and not rest.startswith("#")):
        for entry in find(target):
            yield Source(entry.place, entry.name, entry.category, entry.licence or "unstated")
    else:
        yield Source(f"{target}{rest}", licence="unstated")
