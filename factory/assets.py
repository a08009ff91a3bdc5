"""What a job names, found: shapes, materials and lights with their hashes, sides and licences. Meshes and maps are read, then let go.

source  what factory.shapes.load or factory.lights.load takes: a spec such as "chair:17", or a path
twin    the same mesh, fit or map under a second name: left out, since its pictures would be the first one's again
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from manifests import splits
from manifests.materials import Entry
from manifests.problems import Problem, closest
from manifests.schema import Draw, Role, Side

RANGE = re.compile(r"^(\w+):(\d+)-(\d+)$")  # "chair:0-39"
MESHES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
OWN_LICENCE = "Apache-2.0"  # shapes that this program's families make
SETS = {"materials": "merl", "materials-rgl": "rgl"}  # what a catalogue's file is called in a job; others go by their stem
PARTS = ("train", "test", "paper-train")  # of a set: "merl/test"
MOST_SHAPES = 1_000_000


class Shape(msgspec.Struct, frozen=True, kw_only=True):
    """A shape of a job; segments: how many regions get a material of their own; named: its name is ours, not the mesh's."""

    name: str
    source: str
    named: bool
    category: str
    hash: str
    segments: int
    side: Side
    role: Role
    licence: str
    report: str


class Material(msgspec.Struct, frozen=True, kw_only=True):
    """A material of a job; entry: its line of the catalogue, which the dataset's materials.json repeats."""

    name: str
    hash: str
    side: Side
    licence: str
    source: str
    entry: Entry


@dataclass(frozen=True, eq=False)
class Light:
    """A light of a job; origin: where it comes from, for credits; L64 (64, 128, 3): the map that the dataset keeps."""

    name: str
    source: str
    hash: str
    scale: float
    licence: str
    origin: str
    L64: object


@dataclass(frozen=True)
class Assets:
    """Everything a job names; lights by the name the job uses. notes: what was left out, and why, one line each."""

    shapes: list
    materials: list
    lights: dict
    notes: list = field(default_factory=list)


def resolve(job, folder=None, library=None, catalogues=(), watch=None):
    """The Assets of a job.

    folder      where the job's relative paths start and end: a path that leaves it is refused; None: paths may lead anywhere
    library     a folder of the user's light maps, or None
    catalogues  files of materials besides the built-in ones
    watch       wraps an iterable to show its progress, tqdm-like, or None
    Raises      Problem: an unknown name, a broken file, a path that leaves the folder, a job that leaves nothing to render
    """
    check(job)
    notes = []
    materials = _without_twins(_materials(job, catalogues), "material", notes)
    lights = _lights(job, folder, library)
    shapes = _without_twins(_shapes(job, folder, watch or _unwatched), "shape", notes)
    if not shapes:
        raise Problem("job: shapes", f"some with a role among {', '.join(job.roles)}", "none", "widen shapes or roles")
    return Assets(shapes, materials, lights, notes)


def check(job):
    """What types cannot say: raises Problem for values that repeat, and for draws of more than there are."""
    for key, most in (("views", 24), ("rotations", 128)):
        value = getattr(job, key)
        if isinstance(value, Draw):
            if value.random > most:
                raise Problem(f"job: {key}.random", f"at most {most}", str(value.random), f"there are {most} different ones")
        elif len(set(value)) < len(value):
            raise Problem(f"job: {key}", "each number once", f"{sorted({v for v in value if value.count(v) > 1})} twice", "drop the second")
    for key in ("tiers", "light_resolutions"):
        value = getattr(job, key)
        if len(set(value)) < len(value):
            raise Problem(f"job: {key}", "each name once", ", ".join(value), "drop what repeats")


def local(path, folder, where):
    """A path of a job file, within its folder. Raises Problem if it leaves it; folder None: any path."""
    if folder is None:
        return Path(path)
    target = Path(folder) / path
    if Path(path).is_absolute() or ".." in Path(path).parts or not target.resolve().is_relative_to(Path(folder).resolve()):
        remedy = "write it relative to the job file, or pass --assets FOLDER and write it relative to that"
        raise Problem(f"{where} '{path}'", f"a path inside {folder}", "one that leaves it", remedy)
    return target


def _unwatched(items, **_):
    return items


def _shapes(job, folder, watch):
    sources = list(dict.fromkeys(_sources(job, folder)))
    found = []
    for name, source in watch(sources, desc="reading shapes", unit="shape"):
        mesh = _mesh(name, source)
        found.append((name, source, mesh.name, mesh.category, mesh.hash, mesh.segments, mesh.report.line()))
    roles = splits.shape_roles([(name or own, category, hash_) for name, _, own, category, hash_, _, _ in found], job.split)
    wanted = set(job.roles) or set(splits.SIDES)
    return [
        Shape(
            name=name or own,
            source=source,
            named=name is not None,
            category=category,
            hash=hash_,
            segments=segments,
            side=splits.SIDES[roles[name or own]],
            role=roles[name or own],
            licence=OWN_LICENCE if _is_family(source) else "unstated",
            report=report,
        )
        for name, source, own, category, hash_, segments, report in found
        if roles[name or own] in wanted
    ]


def _mesh(name, source):
    from factory.shapes.catalogue import load

    return load(source) if name is None else load(source, name=name)


def _is_family(source):
    from factory.shapes.catalogue import FAMILIES, PRIMITIVES

    return source.partition(":")[0] in FAMILIES + PRIMITIVES


def _sources(job, folder):
    """(name or None, source) of every shape; what a number alone rules out is not even read."""
    for spec in job.shapes:
        if span := RANGE.match(spec):
            first, last = int(span[2]), int(span[3])
            if not first <= last < first + MOST_SHAPES:
                raise Problem(f"job: shapes '{spec}'", "a range from low to high", f"{first} to {last}", f"write {span[1]}:0-39")
            specs = [f"{span[1]}:{number}" for number in range(first, last + 1)]
        elif _is_family(spec):
            specs = [spec]
        elif any(mark in spec for mark in "/\\."):
            yield from _files(local(spec.removeprefix("file:"), folder, "job: shapes"))
            continue
        else:
            specs = [spec]  # an unknown name: the catalogue says which are near
        for one in specs:
            role = splits.numbered_role(one, job.split)
            if role is None or not job.roles or role in job.roles:
                yield None, one


def _files(path):
    """(name, path) of a mesh file, or of every one in a folder, named by where they lie in it."""
    if not path.is_dir():
        yield path.stem, str(path)
        return
    files = sorted(f for f in path.rglob("*") if f.suffix.lower() in MESHES)
    if not files:
        raise Problem(path, f"mesh files ({', '.join(MESHES)})", "none in the folder or below it", "name another folder")
    for file in files:
        yield str(file.relative_to(path).with_suffix("")).replace("\\", "/"), str(file)


def _materials(job, catalogues):
    """The materials a job names, in its order, sets spread out in the catalogue's."""
    from manifests.materials import BUILT_IN

    sets = {SETS.get(Path(path).stem, Path(path).stem): path for path in (*BUILT_IN, *catalogues) if Path(path).exists()}
    entries = {name: _entries(path) for name, path in sets.items()}
    known = {entry.name: entry for found in entries.values() for entry in found}
    chosen = {}
    for name in job.materials:
        found = _set(name, entries) if name.partition("/")[0] in entries else [known[name]] if name in known else None
        if not found:
            names = [*known, *entries, *(f"{s}/{part}" for s in entries for part in PARTS)]
            raise Problem(
                f"job: materials '{name}'",
                "a material or a set",
                "an unknown name" if found is None else "none in it",
                closest(name, names),
            )
        chosen |= {entry.name: entry for entry in found}
    sides = splits.material_sides([(e.name, e.split, e.hash) for e in chosen.values()])
    return [Material(name=e.name, hash=e.hash, side=sides[e.name], licence=e.licence, source=e.source, entry=e) for e in chosen.values()]


def _entries(path):
    from manifests.materials import read_catalogue

    return read_catalogue(path).materials


def _set(name, entries):
    """The materials of "merl", "merl/train" or "merl/brass"."""
    set_, _, part = name.partition("/")
    if part == "paper-train":
        chosen = splits.paper_training([entry.name for entry in entries[set_] if entry.split == "train"])
        return [entry for entry in entries[set_] if entry.name in chosen]
    if part in PARTS:
        return [entry for entry in entries[set_] if entry.split == part]
    return [entry for entry in entries[set_] if part in ("", entry.name)]


def _lights(job, folder, library):
    from factory.lights import load
    from factory.lights.files import is_light_path

    found = {}
    for name in dict.fromkeys(job.lights):
        source = str(local(name, folder, "job: lights")) if is_light_path(name) else name
        light = load(source, library)
        found[name] = Light(
            name=light.name,
            source=source,
            hash=light.hash,
            scale=light.scale,
            licence=light.licence,
            origin=light.source,
            L64=light.L64,
        )
    return found


def _without_twins(assets, kind, notes):
    """Each hash once, each name once. Raises Problem for two different things under one name."""
    by_hash, by_name = {}, {}
    for asset in assets:
        if asset.hash in by_hash:
            if asset.name != by_hash[asset.hash].name:
                notes.append(f"{kind} '{asset.name}' is '{by_hash[asset.hash].name}' again, left out")
            continue
        if asset.name in by_name:
            raise Problem(f"{kind} '{asset.name}'", "one thing under a name", "two that differ", "rename one of the files")
        by_hash[asset.hash] = by_name[asset.name] = asset
    return list(by_hash.values())
