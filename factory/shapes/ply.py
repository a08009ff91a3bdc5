"""PLY: elements with properties described by a header; vertices and faces are kept.

Files are text or binary of either byte order. Source: Greg Turk, "The PLY Polygon File Format",
1994. Lists may be of any length and of any integer type, polygons of different lengths may be
mixed; properties and elements that no mesh needs are ignored.
"""

import re
import struct
from abc import ABC, abstractmethod
from array import array
from codecs import BOM_UTF8
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from factory.shapes.raw import (
    AGAIN,
    NOTHING,
    Polygons,
    Raw,
    from_polygons,
    glimpse,
    require_count,
    text_lines,
    whole_number,
)
from manifests.errors import InputError

TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
}
TYPES |= {
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
}
TYPES |= {"float16": "f2", "float32": "f4", "float64": "f8"}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": None}
HEADER = 1 << 16  # bytes; real ones have some hundred
DOWNLOAD = "download or export it again"


@dataclass
class Property:
    """A property of an element.

    type   of each value; count: of a list's length, None for a single value. Both are numpy's names
           without byte order.
    """

    name: str
    type: str
    count: str | None = None


@dataclass
class Element:
    """One kind of rows in the header: vertices, faces, edges."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def place(self, name: str) -> int:
        """Return the index of a property. Raises KeyError."""
        for place, each in enumerate(self.properties):
            if each.name == name:
                return place
        raise KeyError(name)


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """Return the Raw of a PLY file. See factory.shapes.raw."""
    elements, order, start = _header(file, where)
    vertex, face = (
        next((e for e in elements if e.name == name), None) for name in ("vertex", "face")
    )
    if vertex is None or face is None:
        raise InputError(where, "a PLY header with faces", "none", NOTHING)
    if face.count + vertex.count > size:  # each takes at least a byte
        expected = f"{face.count:,} faces and {vertex.count:,} vertices as its header says"
        raise InputError(where, expected, f"{size:,} bytes", DOWNLOAD)
    require_count(max(face.count, vertex.count // 4) if face.count else 0, maximum, where, size)
    requested = _columns(vertex, face, where)
    rows: _Rows = _Text(file, where) if order is None else _Binary(file, start, where, order)
    for element in elements:
        single, listed = requested.get(element.name, ((), None))
        rows.take(element, single, listed, maximum)
    rows.end()
    return from_polygons(rows.vertices, rows.corners, rows.lengths, where)


def _header(file, where):
    """Return elements, byte order (None: text) and the offset of the data."""
    head = file.read(HEADER)
    start = len(BOM_UTF8) if head.startswith(BOM_UTF8) else 0
    first = re.search(rb"\r?\n|\r", head)
    newline = b"\r" if first and first[0] == b"\r" else b"\n"
    lines = head[start:].split(newline)
    end = next((k for k, line in enumerate(lines[:-1]) if line.strip() == b"end_header"), None)
    if end is None or lines[0].strip() != b"ply":
        raise InputError(
            where,
            "a PLY header with faces",
            f"'{glimpse(head)}'",
            "check the file's ending, or that it holds more than points",
        )
    elements: list[Element] = []
    order: str | None = "none"
    for place, line in enumerate(lines[1:end], 2):
        words = line.decode("latin-1").split()
        try:
            match words:
                case ["format", name, _]:
                    order = ORDERS[name]
                case ["element", name, count] if (
                    count.isascii() and count.isdigit() and len(count) < 19
                ):
                    elements.append(Element(name, int(count)))
                case ["property", "list", count, type_, name] if TYPES[count][0] in "iu":
                    elements[-1].properties.append(Property(name, TYPES[type_], TYPES[count]))
                case ["property", type_, name]:
                    elements[-1].properties.append(Property(name, TYPES[type_]))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise KeyError
        except (KeyError, IndexError):
            raise InputError(
                f"{where}: line {place}", "a line of a PLY header", f"'{glimpse(line)}'", AGAIN
            ) from None
    if order == "none":
        raise InputError(where, "a PLY header with its format", "none", AGAIN)
    return elements, order, start + sum(len(line) + 1 for line in lines[: end + 1])


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


class _Rows(ABC):
    """Values read so far: vertices (V, 3) float64, polygons as corners (C,) and lengths (P,)."""

    vertices = np.zeros((0, 3))
    corners = lengths = np.zeros(0, np.int64)

    def __init__(self, where: str | Path) -> None:
        self.where = where

    @abstractmethod
    def take(
        self, element: Element, single: tuple[int, ...], listed: int | None, maximum: int
    ) -> None:
        """Read an element's rows; keep the values at indices `single` and the list at `listed`."""

    @abstractmethod
    def end(self) -> None:
        """Raise InputError if there is more than the header says."""

    def _keep(self, element, maximum, values=None, corners=None, lengths=None):
        if element.name == "vertex":
            self.vertices = values
        elif element.name == "face":
            require_count(int(np.maximum(lengths - 2, 0).sum()), maximum, self.where)
            self.corners, self.lengths = corners, lengths

    def _short(self, element):
        return InputError(
            self.where,
            f"{element.count:,} rows of '{element.name}' as its header says",
            "the end of the file",
            DOWNLOAD,
        )


class _Text(_Rows):
    """Rows of numbers, one per line."""

    def __init__(self, file: BinaryIO, where: str | Path) -> None:
        super().__init__(where)
        every = enumerate(text_lines(file, where, "a PLY file's text"), 1)
        self.lines = ((line, text.split()) for line, text in every if text.strip())
        for _, words in self.lines:
            if words == [b"end_header"]:
                break

    def take(
        self, element: Element, single: tuple[int, ...], listed: int | None, maximum: int
    ) -> None:
        """Read an element's rows; keep the values at indices `single` and the list at `listed`."""
        if not element.properties:
            return
        polygons = Polygons()
        plain = not any(p.count for p in element.properties)
        seen = 0
        for line, words in islice(self.lines, element.count):
            seen += 1
            try:
                if plain and len(words) < len(element.properties):
                    raise IndexError
                starts = range(len(words)) if plain else self._offsets(element, words)
                if single:
                    polygons.add_vertex([words[starts[k]] for k in single])
                if listed is not None:
                    first = starts[listed] + 1
                    count = whole_number(words[first - 1])
                    polygons.add_polygon([whole_number(w) for w in words[first : first + count]])
                    polygons.require_count(maximum, self.where)
            except InputError:
                raise
            except (ValueError, IndexError, OverflowError):
                text = glimpse(b" ".join(words))
                raise InputError(
                    f"{self.where}: line {line}", f"a row of '{element.name}'", f"'{text}'", AGAIN
                ) from None
        if seen < element.count:
            raise self._short(element)
        self._keep(element, maximum, *polygons.arrays())

    @staticmethod
    def _offsets(element, words):
        """Return where each property begins in a row. Raises ValueError, IndexError."""
        starts, place = [], 0
        for each in element.properties:
            starts.append(place)
            count = whole_number(words[place]) if each.count else 0
            if count < 0:
                raise ValueError
            place += 1 + count
        if place > len(words):
            raise IndexError
        return starts

    def end(self) -> None:
        """Raise InputError if there is more than the header says."""
        for line, words in self.lines:
            text = glimpse(b" ".join(words))
            raise InputError(
                f"{self.where}: line {line}", "the end, as its header says", f"'{text}'", DOWNLOAD
            )


class _Binary(_Rows):
    """Rows of bytes."""

    def __init__(self, file: BinaryIO, start: int, where: str | Path, order: str) -> None:
        super().__init__(where)
        file.seek(start)
        self.data, self.place, self.order = file.read(), 0, order

    def take(
        self, element: Element, single: tuple[int, ...], listed: int | None, maximum: int
    ) -> None:
        """Read an element's rows; keep the values at indices `single` and the list at `listed`."""
        if not element.properties or not element.count:
            return
        lengths = [
            self._first_length(element, k) if p.count else None
            for k, p in enumerate(element.properties)
        ]
        table = self._table(element, lengths) if all(n is None or n >= 0 for n in lengths) else None
        if table is None:
            self._by_row(element, single, listed, maximum)
            return
        self.place += table.nbytes
        values = (
            np.stack([table[f"p{k}"].astype(float) for k in single], axis=1) if single else None
        )
        corners = counts = None
        if listed is not None:
            length = lengths[listed] or 0
            require_count(len(table) * max(length - 2, 0) or -1, maximum, self.where)
            corners = (
                table[f"p{listed}"].astype(np.int64).reshape(-1)
                if length
                else np.zeros(0, np.int64)
            )
            counts = np.full(len(table), length, np.int64)
        self._keep(element, maximum, values, corners, counts)

    def _first_length(self, element, place):
        """Return the length of a list in the first row; -1 if the data end before it."""
        before = self.place
        for each in element.properties[: place + 1]:
            type_ = np.dtype(self.order + (each.count or each.type))
            if before + type_.itemsize > len(self.data):
                return -1
            if each.count:
                length = int(np.frombuffer(self.data, type_, 1, before)[0])
                before += max(length, 0) * np.dtype(each.type).itemsize
            before += type_.itemsize
        return length

    def _table(self, element, lengths):
        """Return all rows, or None unless each list has the same length in every row.

        Raises  InputError if there are too few data
        """
        fields: list[tuple] = []
        for k, (each, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if each.count:
                fields.append((f"n{k}", self.order + each.count))
            if length != 0:
                fields.append(
                    (f"p{k}", self.order + each.type, () if length is None else (length,))
                )
        if (
            sum(np.dtype(f[1]).itemsize * (f[2][0] if f[2:] and f[2] else 1) for f in fields)
            * element.count
            > len(self.data) - self.place
        ):
            if any(n is not None for n in lengths):  # the first list may be the longest
                return None
            raise self._short(element)
        table = np.frombuffer(self.data, np.dtype(fields), element.count, self.place)
        alike = all(
            (table[f"n{k}"] == length).all()
            for k, length in enumerate(lengths)
            if length is not None
        )
        return table if alike else None

    def _by_row(self, element, single, listed, maximum):
        """Read an element's rows as `take` does, where lists are of different lengths."""
        steps = [
            (
                struct.Struct(self.order + CODES[p.count or p.type]),
                np.dtype(p.type).itemsize,
                p.count,
            )
            for p in element.properties
        ]
        data, place, end = self.data, self.place, len(self.data)
        values, starts, lengths = array("d"), array("q"), array("q")
        triangles = 0
        try:
            for _ in range(element.count):
                for k, (step, bytes_, is_list) in enumerate(steps):
                    (value,) = step.unpack_from(data, place)
                    place += step.size
                    if is_list:
                        if not 0 <= value * bytes_ <= end - place:
                            raise struct.error
                        if k == listed:
                            starts.append(place)
                            lengths.append(value)
                            triangles += max(value - 2, 0)
                        place += value * bytes_
                    elif k in single:
                        values.append(value)
                if triangles > maximum:
                    require_count(triangles, maximum, self.where)
        except struct.error:
            raise self._short(element) from None
        self.place = place
        corners = None
        if listed is not None:
            type_ = np.dtype(self.order + element.properties[listed].type)
            counts = np.array(lengths, np.int64)
            from_byte = np.repeat(
                np.array(starts, np.int64) - (np.cumsum(counts) - counts) * type_.itemsize, counts
            )
            byte = from_byte + np.arange(counts.sum()) * type_.itemsize
            raw = np.frombuffer(data, np.uint8)[byte[:, None] + np.arange(type_.itemsize)]
            corners = np.ascontiguousarray(raw).view(type_).reshape(-1).astype(np.int64)
        order = np.argsort(single)  # values stand in the order of the properties
        xyz = (
            np.array(values, float).reshape(-1, max(len(single), 1))[:, np.argsort(order)]
            if single
            else None
        )
        self._keep(element, maximum, xyz, corners, np.array(lengths, np.int64))

    def end(self) -> None:
        """Raise InputError if there is more than the header says."""
        rest = self.data[self.place :]
        if rest.strip():
            raise InputError(
                self.where, "the end, as its header says", f"{len(rest):,} bytes more", DOWNLOAD
            )


CODES = {
    "i1": "b",
    "u1": "B",
    "i2": "h",
    "u2": "H",
    "i4": "i",
    "u4": "I",
    "i8": "q",
    "u8": "Q",
    "f2": "e",
    "f4": "f",
    "f8": "d",
}
