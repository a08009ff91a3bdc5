"""The rows of a PLY file's elements, as text or as bytes."""

import struct
from abc import ABC, abstractmethod
from array import array
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from factory.shapes.ply_header import Element
from factory.shapes.raw import AGAIN, Polygons, glimpse, require_count, text_lines, whole_number
from manifests.errors import InputError
from manifests.wording import number_of

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
DOWNLOAD = "download or export it again"


class Rows(ABC):
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


class TextRows(Rows):
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


class BinaryRows(Rows):
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
                self.where,
                "the end, as its header says",
                f"{number_of(len(rest), 'byte', form=',')} more",
                DOWNLOAD,
            )
