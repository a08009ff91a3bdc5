"""Mesh files read into raw triangles, with a reader for each format.

Their size is bounded before memory is taken, and no texture, library or second file is ever
followed. The readers are our own because the polygons of OBJ, PLY and OFF must be cut into
triangles with care (factory.shapes.polygons), and because each count and offset in a file is
checked before it is used. `trimesh`, which cuts every polygon as a fan and ignores a GLB's sparse
positions, is the reader with which tests compare them.
"""

import io
from importlib import import_module
from pathlib import Path
from typing import BinaryIO

from factory.shapes.raw import AGAIN, MAXIMUM_TRIANGLES, Raw
from manifests.errors import InputError, closest
from manifests.inputs import require_file

FORMATS = (".obj", ".ply", ".glb", ".stl", ".off")
MODULE = ".js"  # a module with a mesh is read where it is named; folders are full of other modules


def require_mesh_file(path: str | Path) -> None:
    """Raise InputError unless there is a file, and a readable one, at the path of a mesh."""
    require_file(path, "a mesh file", lambda: _remedy(Path(path)))


def read(path: str | Path, maximum: int = MAXIMUM_TRIANGLES) -> Raw:
    """Return the Raw triangles of a file.

    Raises  InputError: missing, not a mesh, truncated, or more than `maximum` triangles
    """
    path = Path(path)
    require_mesh_file(path)
    kind = path.suffix.lower()
    check_format(path, kind)
    with open(path, "rb") as file:
        return parse(file, kind, path.stat().st_size, path, maximum)


def _remedy(path):
    """Return a remedy for a missing file: similar names, if there are any."""
    try:
        near = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
    except (OSError, ValueError):  # a folder that may not be read, a name that no file can have
        near = []
    return closest(path.name, near) if near else "check the path"


def check_format(where: str | Path, kind: str) -> None:
    """Raise InputError for a file whose ending has no reader."""
    if kind not in (*FORMATS, MODULE):
        remedy = (
            "export it as binary glTF (.glb)" if kind == ".gltf" else "convert it to one of these"
        )
        raise InputError(where, f"one of {', '.join(FORMATS)}", f"'{kind or 'no ending'}'", remedy)


def parse(
    file: BinaryIO, kind: str, size: int, where: str | Path, maximum: int = MAXIMUM_TRIANGLES
) -> Raw:
    """Return the Raw triangles of an open binary file of `size` bytes, called `where` in errors."""
    if size == 0:
        raise InputError(where, "a mesh", "an empty file", AGAIN)
    return import_module(f"factory.shapes.{kind[1:]}").read(file, size, where, maximum)


def from_bytes(data: bytes, kind: str, where: str | Path, maximum: int = MAXIMUM_TRIANGLES) -> Raw:
    """Return the Raw triangles of a file in memory, as `read` does."""
    return parse(io.BytesIO(data), kind, len(data), where, maximum)
