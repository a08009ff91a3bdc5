"""PLY: elements with properties described by a header; vertices and faces are kept.

Files are text or binary of either byte order. Source: Greg Turk, "The PLY Polygon File Format",
1994. Lists may be of any length and of any integer type, polygons of different lengths may be
mixed; properties and elements that no mesh needs are ignored.
"""

from pathlib import Path
from typing import BinaryIO

from factory.shapes.ply_header import Element, read_header
from factory.shapes.ply_rows import DOWNLOAD, BinaryRows, Rows, TextRows
from factory.shapes.raw import AGAIN, NOTHING, Raw, from_polygons, require_count
from manifests.errors import InputError
from manifests.wording import number_of


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """Return the Raw of a PLY file. See factory.shapes.raw."""
    elements, order, start = read_header(file, where)
    vertex, face = (
        next((e for e in elements if e.name == name), None) for name in ("vertex", "face")
    )
    if vertex is None or face is None:
        raise InputError(where, "a PLY header with faces", "none", NOTHING)
    if face.count + vertex.count > size:  # each takes at least a byte
        expected = f"{face.count:,} faces and {vertex.count:,} vertices as its header says"
        raise InputError(where, expected, number_of(size, "byte", form=","), DOWNLOAD)
    require_count(max(face.count, vertex.count // 4) if face.count else 0, maximum, where, size)
    requested = _columns(vertex, face, where)
    rows: Rows = TextRows(file, where) if order is None else BinaryRows(file, start, where, order)
    for element in elements:
        single, listed = requested.get(element.name, ((), None))
        rows.take(element, single, listed, maximum)
    rows.end()
    return from_polygons(rows.vertices, rows.corners, rows.lengths, where)


def _columns(
    vertex: Element, face: Element, where: str | Path
) -> dict[str, tuple[tuple[int, ...], int | None]]:
    """Return {element: (indices of single values, index of a list)}."""
    try:
        xyz = tuple(vertex.place(name) for name in "xyz")
    except KeyError as missing:
        raise InputError(
            where, "vertices with x, y and z", f"no {missing.args[0]}", AGAIN
        ) from None
    lists = [p.name for p in face.properties if p.count]
    named = [name for name in lists if name in ("vertex_indices", "vertex_index")] or (
        lists if len(lists) == 1 else []
    )
    if not named or any(vertex.properties[k].count for k in xyz):
        raise InputError(
            where, "faces with a list vertex_indices", ", ".join(lists) or "no list", AGAIN
        )
    indices = face.place(named[0])
    if face.properties[indices].type[0] not in "iu":
        raise InputError(
            where, "whole numbers in vertex_indices", face.properties[indices].type, AGAIN
        )
    return {"vertex": (xyz, None), "face": ((), indices)}
