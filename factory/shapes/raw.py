"""Triangles as they stand in a mesh file, and the readers' shared tools: bounds, lines, polygons.

Each reader is a function `read(file, size, where, maximum)` of an open binary file of `size` bytes,
whose name in errors is `where`. It returns a Raw, or raises InputError before it takes memory for
more than `maximum` triangles.
"""

import codecs
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from factory.shapes.ears import TooLarge
from factory.shapes.fans import fans
from factory.shapes.polygons import triangulate
from manifests.errors import InputError
from manifests.wording import number_of

MAXIMUM_TRIANGLES = 2_000_000
# more than any format spends on one, OBJ with normals and texture coordinates included
BYTES_A_TRIANGLE = 250
LONGEST_LINE = 4 << 20  # bytes; a polygon of 300,000 corners
# of the mesh's size: vertices nearer than this are one, and a polygon's notch less deep than this
# is none
WELD = 1e-6
MORE = (
    "reduce the mesh, with Blender's Decimate modifier for instance (the limit is fixed but for"
    " `factory shapes`: --max-triangles)"
)
AGAIN = "export it again"
NOTHING = "check that the file holds a surface, not points or curves"


@dataclass(frozen=True)
class Raw:
    """vertices (V, 3) and faces (F, 3) of a file; material (F,) indexes the OBJ's materials.

    own_materials  number of materials of a file in which they are not read, not even their names
    """

    vertices: np.ndarray
    faces: np.ndarray
    materials: tuple[str, ...] = ()
    material: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    own_materials: int = 0


def require_count(count: int, maximum: int, where: str | Path, size: int = 0) -> None:
    """Raise InputError for a mesh of no triangles, or of more than `maximum`, or of too many bytes.

    size  bytes, refused if they are more than `maximum` triangles can take
    """
    rule = f"at most {number_of(maximum, 'triangle', form=',')}"
    if count > maximum:
        raise InputError(where, rule, f"{count:,}", MORE)
    if size > maximum * BYTES_A_TRIANGLE:  # few triangles among much else: textures, points
        raise InputError(where, rule, f"{size:,} bytes", MORE)
    if count <= 0:
        raise InputError(where, "a mesh with triangles", "none", NOTHING)


def from_polygons(
    vertices: np.ndarray,
    corners: np.ndarray,
    lengths: np.ndarray,
    where: str | Path,
    materials: tuple[str, ...] = (),
    material: np.ndarray | None = None,
    notes: tuple[str, ...] = (),
) -> Raw:
    """Return the Raw of polygons.

    vertices   (V, 3)
    corners    (C,) indices into vertices, polygon after polygon
    lengths    (P,) corners of each polygon
    materials  names; material (P,): which of them each polygon has, or None
    Raises     InputError: an index outside of the vertices, polygons too large to be cut into
               triangles
    """
    whole = lengths >= 3
    if not whole.all():  # points and lines, which some exporters write so
        notes = (*notes, f"{int((~whole).sum())} faces of fewer than three corners dropped")
        corners, material = (
            corners[np.repeat(whole, lengths)],
            (None if material is None else material[whole]),
        )
        lengths = lengths[whole]
    outside = corners[(corners < 0) | (corners >= len(vertices))]
    if len(outside):
        result = f"vertex {outside[0] + 1}"
        raise InputError(
            where,
            f"faces among its {len(vertices)} vertices",
            result,
            "download or export it again",
        )
    if not len(lengths):
        raise InputError(where, "a mesh with triangles", "none", NOTHING)
    faces, owner, crossing = _cut(vertices, corners, lengths, where)
    if crossing:
        notes = (*notes, f"{crossing} polygons that cross themselves cut as they come")
    return Raw(vertices, faces, materials, None if material is None else material[owner], notes)


def _cut(vertices, corners, lengths, where):
    low, high = vertices[corners].min(axis=0), vertices[corners].max(axis=0)
    with np.errstate(all="ignore"):
        size = float((high - low).max())
    # without extent, or not finite: refused later, by name
    if (lengths == 3).all() or not 1e-150 < size < 1e150:
        return *fans(corners, lengths), 0
    try:
        return triangulate((vertices - low) / size, corners, lengths, WELD)
    except TooLarge as error:
        raise InputError(
            where,
            "polygons that are soon cut into triangles",
            f"one of {error.corners:,} corners",
            "triangulate it before the export",
        ) from None


class Polygons:
    """Vertices and polygons of a text file while it is read."""

    def __init__(self) -> None:
        self._xyz, self._corners, self._lengths = array("d"), array("q"), array("q")

    @property
    def vertices(self) -> int:
        """How many vertices there are so far."""
        return len(self._xyz) // 3

    @property
    def polygons(self) -> int:
        """How many polygons there are so far."""
        return len(self._lengths)

    def add_vertex(self, words: Sequence[bytes]) -> None:
        """Add a vertex of three words. Raises ValueError, IndexError."""
        self._xyz.extend((number(words[0]), number(words[1]), number(words[2])))

    def add_polygon(self, corners: Sequence[int]) -> None:
        """Add a polygon of indices."""
        self._corners.extend(corners)
        self._lengths.append(len(corners))

    def require_count(self, maximum: int, where: str | Path) -> None:
        """Raise InputError as soon as the polygons make more than `maximum` triangles."""
        if (triangles := len(self._corners) - 2 * len(self._lengths)) > maximum:
            require_count(triangles, maximum, where)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return vertices (V, 3), corners (C,) and lengths (P,)."""
        return (
            np.array(self._xyz, float).reshape(-1, 3),
            np.array(self._corners, np.int64),
            np.array(self._lengths, np.int64),
        )


def text_lines(file: BinaryIO, where: str | Path, what: str) -> Iterator[bytes]:
    """Yield the lines of a text file from its start, each with its end: Unix, Windows or old Mac.

    Byte-order marks are left out.

    what    the expected text: "an OBJ file's text"
    Raises  InputError for binary data, and for lines that only binary data has
    """
    file.seek(0)
    rest = b""
    while chunk := file.read(1 << 20):
        if b"\0" in chunk:
            raise InputError(
                where, what, "binary data", "check the file's ending; text must be UTF-8 or ASCII"
            )
        block = rest + chunk
        lines = block.splitlines(keepends=True)
        rest = b"" if block.endswith(b"\n") else lines.pop()  # after a "\r" a "\n" may come
        if len(rest) > LONGEST_LINE:
            raise InputError(
                where,
                f"{what} in lines of at most {LONGEST_LINE >> 20} MiB",
                "a longer one",
                "check the file's ending",
            )
        for line in lines:
            yield line.removeprefix(codecs.BOM_UTF8)
    if rest:
        yield rest.removeprefix(codecs.BOM_UTF8)


def number(word: bytes) -> float:
    """Return a coordinate. Raises ValueError for any other word, even 1_000."""
    if b"_" in word:
        raise ValueError(word)
    return float(word)


def whole_number(word: bytes) -> int:
    """Return an index or a count; 3.0 is 3. Raises ValueError, OverflowError."""
    if b"_" in word:
        raise ValueError(word)
    try:
        value = int(word)
    except ValueError:
        value = int(float(word))
        if value != float(word):
            raise
    if abs(value) >= 1 << 62:
        raise ValueError(word)
    return value


def glimpse(data: bytes) -> str:
    """Return the first characters of some bytes, printable in one line."""
    text = data[:24].decode("ascii", "replace")
    return "".join(c if c.isprintable() else " " for c in text).strip()
