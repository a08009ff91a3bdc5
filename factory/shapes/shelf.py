"""A user's own library: cleaned meshes written as OBJ with a note beside each, by `shapes add`.

LIBRARY/chair/mine.obj    y up, front +z, as other programs expect; a material "segment-1", "segment-2", … for each region
LIBRARY/chair/mine.json   name, category, hash, source, licence, report
"""

import json
import os
import re
from pathlib import Path

from manifests.problems import Problem

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")


def add(mesh, library, *, source, licence):
    """Write a Mesh and its note into a library folder; the path of the OBJ. The note comes last: without it a mesh is not yet there.

    Raises  Problem: a name that is no file name, or one that a different mesh has already
    """
    for what, text in (("name", mesh.name), ("category", mesh.category)):
        if not NAME.fullmatch(text):
            raise Problem(f"{what} '{text}'", "letters, digits, '.', '_' and '-', 80 at most", f"'{text}'", f"pass --{what}")
    folder = Path(library) / mesh.category
    folder.mkdir(parents=True, exist_ok=True)
    path, note = folder / f"{mesh.name}.obj", folder / f"{mesh.name}.json"
    if note.exists():
        held = json.loads(note.read_text("utf-8")).get("hash")
        if held != mesh.hash:
            raise Problem(note, "a name that is free", "another mesh of that name", "pass a different --name")
        return path
    _write(path, _obj(mesh, licence))
    words = {"name": mesh.name, "category": mesh.category, "hash": mesh.hash, "segments": mesh.segments}
    words |= {"source": str(source), "licence": licence, "report": mesh.report.line()}
    _write(note, json.dumps(words, indent=1, ensure_ascii=False) + "\n")
    return path


def _write(path, text):
    """The whole file or none: written aside, then renamed."""
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(aside, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def _obj(mesh, licence):
    """OBJ text: every digit kept, so that the mesh that is read back has the same hash."""
    lines = [f"# {mesh.category} {mesh.name}", f"# licence: {' '.join(licence.split())}"]
    lines += [f"v {float(y)!r} {float(z)!r} {float(x)!r}" for x, y, z in mesh.vertices]
    for segment in range(1, mesh.segments + 1):
        lines.append(f"usemtl segment-{segment:03d}")
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces[mesh.segment == segment] + 1).tolist()]
    return "\n".join(lines) + "\n"
