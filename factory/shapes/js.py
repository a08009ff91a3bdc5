"""JavaScript modules of npm packages that hold a mesh as two arrays, `positions` and `cells`.

exports.positions = [[x, y, z], …]   or  export const positions = …, or "positions": … in JSON
exports.cells = [[a, b, c], …]       polygons, as indices from 0

Nothing is ever run: the two arrays are taken from the text where they are JSON, and all else is
ignored.
"""

import re
from pathlib import Path
from typing import Annotated, BinaryIO, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from factory.shapes.raw import AGAIN, Raw, from_polygons, glimpse, require_count
from manifests.errors import InputError

T = TypeVar("T")
START = r"\b{name}[\"']?\s*[:=]\s*(?=\[\s*\[)"
END = re.compile(r"\]\s*\]")
Position = Annotated[list[float], Meta(min_length=3, max_length=3)]
Cell = Annotated[list[Annotated[int, Meta(ge=0, lt=1 << 31)]], Meta(min_length=1)]
RULE = "a module that exports positions and cells"


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """Return the Raw of a module. See factory.shapes.raw."""
    require_count(1, maximum, where, size)
    data = file.read(size)
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise InputError(where, RULE, f"'{glimpse(data)}'", "check the file's ending") from None
    cells = _array(text, "cells", where)
    # a polygon of k corners becomes k − 2 triangles; one cell or more is there
    require_count(max(1, cells.count(",") + 1 - 2 * (cells.count("[") - 1)), maximum, where)
    positions = _decode(_array(text, "positions", where), list[Position], "positions", where)
    polygons = _decode(cells, list[Cell], "cells", where)
    corners = np.array([corner for cell in polygons for corner in cell], np.int64)
    lengths = np.array([len(cell) for cell in polygons], np.int64)
    # cells of one or two corners, which are no triangles, had lowered the estimate
    require_count(int(np.maximum(lengths - 2, 0).sum()), maximum, where)
    vertices = np.array(positions, np.float64)
    return from_polygons(vertices, corners, lengths, where)


def _array(text: str, name: str, where: str | Path) -> str:
    """Return the text of an array of arrays of numbers, which follows its name."""
    begin = re.search(START.format(name=name), text)
    end = END.search(text, begin.end()) if begin else None
    if begin is None or end is None:
        raise InputError(f"{where}: {name}", RULE, "none", "give a module with both arrays")
    return text[begin.end() : end.end()]


def _decode(text: str, type_: type[T], name: str, where: str | Path) -> T:
    try:
        return msgspec.json.decode(text, type=type_)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise InputError(f"{where}: {name}", RULE, f"'{error}'"[:160], AGAIN) from None
