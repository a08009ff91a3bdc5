"""A user's own library: cleaned meshes as OBJ, each with metadata beside it, from `shapes add`.

LIBRARY/chair/mine.obj    y up, front +z, as other programs expect; a material "segment-1",
                          "segment-2", … for each region
LIBRARY/chair/mine.json   name, category, hash, source, licence, report; jobs take category and
                          licence from it
"""

import json
import re
from pathlib import Path

import msgspec

from factory.shapes.mesh import Mesh
from manifests.errors import InputError
from manifests.files import write_bytes, write_text
from manifests.inputs import require_file

LARGEST_NOTE = 1 << 20  # bytes; a note has some hundreds
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")


class Note(msgspec.Struct, frozen=True):
    """What the metadata beside a mesh say of it; hash: of the mesh when it was added."""

    name: str
    category: str
    hash: str
    licence: str


def note_of(path: str | Path) -> Note | None:
    """Return what `add` noted of a mesh's file; None if no note of its name lies beside it."""
    beside = Path(path).with_suffix(".json")
    try:
        if not beside.is_file() or beside.stat().st_size > LARGEST_NOTE:
            return None
        note = msgspec.json.decode(beside.read_bytes(), type=Note)
    except (OSError, ValueError, RecursionError):  # another program's file
        return None
    return note if note.name == beside.stem and NAME.fullmatch(note.category) else None


def add(mesh: Mesh, library: str | Path, *, source: str | Path, licence: str) -> Path:
    """Write a Mesh and its metadata into a library folder; return the path of the OBJ.

    The metadata are written last: without them a mesh does not count as added.

    Raises  InputError: a name that is no file name, or one that a different mesh has already
    """
    for what, text in (("name", mesh.name), ("category", mesh.category)):
        if not NAME.fullmatch(text):
            raise InputError(
                f"{what} '{text}'",
                "letters, digits, '.', '_' and '-', 80 at most",
                f"'{text}'",
                f"pass --{what}",
            )
    folder = Path(library) / mesh.category
    folder.mkdir(parents=True, exist_ok=True)
    path, note = folder / f"{mesh.name}.obj", folder / f"{mesh.name}.json"
    if note.exists() and _hash_of_metadata(note) != mesh.hash:
        raise InputError(
            note, "a name that is free", "another mesh of that name", "pass a different --name"
        )
    text = _obj(mesh, licence).encode()
    if note.exists() and _holds(path, text):
        return path
    write_bytes(path, text)
    words = {
        "name": mesh.name,
        "category": mesh.category,
        "hash": mesh.hash,
        "segments": mesh.segments,
    }
    words |= {"source": str(source), "licence": licence, "report": mesh.report.line()}
    write_text(note, json.dumps(words, indent=1, ensure_ascii=False) + "\n")
    return path


def _hash_of_metadata(note):
    """Return the hash of the mesh from its metadata. Raises InputError for a damaged file."""
    remedy = (
        f"delete it, and {note.stem}.obj beside it unless that is this mesh; or pass a different"
        " --name"
    )
    require_file(note, "a mesh's note as JSON", remedy, LARGEST_NOTE)
    try:
        return json.loads(note.read_bytes()).get("hash")
    except (ValueError, AttributeError, RecursionError) as error:
        raise InputError(note, "a mesh's note as JSON", str(error)[:100], remedy) from None


def _holds(path, data):
    """Return whether a file holds these bytes; a damaged mesh of a library is written again."""
    try:
        return path.stat().st_size == len(data) and path.read_bytes() == data
    except OSError:
        return False


def _obj(mesh, licence):
    """Return OBJ text with every digit, so that the mesh has the same hash when it is read."""
    lines = [f"# {mesh.category} {mesh.name}", f"# licence: {' '.join(licence.split())}"]
    lines += [f"v {float(y)!r} {float(z)!r} {float(x)!r}" for x, y, z in mesh.vertices]
    for segment in range(1, mesh.segments + 1):
        lines.append(f"usemtl segment-{segment:03d}")
        lines += [
            f"f {a} {b} {c}" for a, b, c in (mesh.faces[mesh.segment == segment] + 1).tolist()
        ]
    return "\n".join(lines) + "\n"
