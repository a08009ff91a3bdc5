"""Wavefront OBJ: vertices, polygons and the names of materials; no second file is opened.

Source: Wavefront, "Advanced Visualizer Manual", appendix B1. A line that ends in a backslash
continues in the next one. Indices count from 1, or backwards from the last vertex so far, which is
-1. Normals and texture coordinates are ignored.
"""

from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from factory.shapes.raw import (
    AGAIN,
    LONGEST_LINE,
    Polygons,
    Raw,
    from_polygons,
    glimpse,
    require_count,
    text_lines,
)
from manifests.errors import InputError
from manifests.wording import number_of

TEXT = "an OBJ file's text"
# a name may end in a backslash
NAMING = frozenset(b"usemtl mtllib o g usemap maplib shadow_obj trace_obj call csh".split())
KNOWN = NAMING | frozenset(b"v vt vn vp f fo s l p lod bevel c_interp d_interp".split())


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """Return the Raw of an OBJ file. See factory.shapes.raw."""
    require_count(1, maximum, where, size)  # there is no header, and counting reads all of it
    require_count(_count(file, where), maximum, where)
    polygons, material, current = Polygons(), array("q"), 0
    names: dict[str, int] = {}
    unknown: Counter[bytes] = Counter()
    for line, key, words in _statements(file, where):
        try:
            if key == b"v":
                polygons.add_vertex(words)
            elif key in (b"f", b"fo"):
                polygons.add_polygon(_polygon(words, polygons.vertices))
                material.append(current)
            elif key == b"usemtl":
                current = names.setdefault(
                    b" ".join(words).decode("utf-8", "replace"), len(names) + 1
                )
            elif key not in KNOWN:
                unknown[key] += 1
        except (ValueError, IndexError):
            text = glimpse(b" ".join((key, *words)))
            raise InputError(
                f"{where}: line {line}", "a vertex or face", f"'{text}'", AGAIN
            ) from None
    return from_polygons(
        *polygons.arrays(),
        where,
        ("", *names),
        np.array(material, np.int64),
        _passed_over(unknown),
    )


def _passed_over(unknown):
    """Return a note on lines whose first word is unknown.

    Such are free-form surfaces, capital letters, misspellings.
    """
    if not unknown:
        return ()
    (word, _), *_ = unknown.most_common(1)
    return (
        f"{number_of(unknown.total(), 'line')} of unknown kind passed over, most of them"
        f" '{glimpse(word)}'",
    )


def _polygon(words, vertices):
    """Return indices from 0 of a face's corners; faces may come before their vertices.

    Raises  ValueError for any other words
    """
    polygon = [int(word.split(b"/", 1)[0]) for word in words]
    if 0 in polygon or b"_" in b"".join(words):
        raise ValueError
    polygon = [index - 1 if index > 0 else vertices + index for index in polygon]
    if polygon and (min(polygon) < 0 or max(polygon) >= 1 << 31):
        raise ValueError
    return polygon


def _count(file, where):
    """Return the triangles of all faces, or a quarter of the vertices if that is more.

    A file of vertices without faces is a cloud of points and has no triangles.
    """
    triangles, vertices = 0, 0
    for _, key, words in _statements(file, where):
        if key in (b"f", b"fo"):
            triangles += max(len(words) - 2, 0)
        elif key == b"v":
            vertices += 1
    if vertices == 0:
        raise InputError(where, "an OBJ file with 'v' and 'f' lines", "no 'v' line", AGAIN)
    return max(triangles, vertices // 4) if triangles else 0


def _statements(file, where) -> Iterator[tuple[int, bytes, list[bytes]]]:
    """Yield (number of the last line, first word, other words) of each statement but comments."""
    held: list[bytes] = []  # pieces of a statement that continues
    size = 0
    for line, text in enumerate(text_lines(file, where, TEXT), 1):
        words = text.split()
        if not held and (not words or words[0].startswith(b"#")):
            continue
        if words and words[-1].endswith(b"\\") and (held or words[0] not in NAMING):
            held.append(text.rstrip()[:-1])
            size += len(text)
            if size > LONGEST_LINE:
                raise InputError(
                    where,
                    f"{TEXT} in lines of at most {LONGEST_LINE >> 20} MiB",
                    "a longer one",
                    AGAIN,
                )
            continue
        if held:
            text, held, size = b" ".join([*held, text]), [], 0
            words = text.split()
        if b"#" in text and words[0] not in NAMING:
            words = text.partition(b"#")[0].split()
        if words:
            yield line, words[0], words[1:]
    if words := b" ".join(held).split():
        yield line, words[0], words[1:]
