"""The lines of a data set in the order of their ids, without holding them: where each one lies.

A line takes 20 bytes of memory here, and two to three times that while the lines are sorted. As an
object it takes 1.7 KB. It is read from its file again whenever it is asked for, and its checksum
must be what it was.
"""

import zlib
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, overload

import msgspec
import numpy as np

from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.line_files import REPAIR
from manifests.schema import Record, View
from manifests.store import LINES, Store

BATCH = 1024  # lines that are in memory at once: about 1 MB
PLACE = np.dtype([("file", "<u4"), ("start", "<u8"), ("length", "<u4"), ("check", "<u4")])


class PlacedLines(Sequence[Record | View]):
    """Records or views of a data set, in the order of their ids and each read when asked for.

    A slice and `select` give PlacedLines too. Lines that are appended later are not among them.

    store   the data set
    kind    "records" or "views"
    keep    called with each line; those for which it is false are left out
    watch   called with each line that is kept, in the order of the files
    Raises  InputError for a line that no writer leaves; when a line is asked for that has changed
            since or is gone
    """

    def __init__(
        self,
        store: Store,
        kind: str = "records",
        keep: Callable[[Any], Any] | None = None,
        watch: Callable[[Any], Any] | None = None,
    ):
        self._decoder = msgspec.json.Decoder(LINES[kind])
        self._paths: list[Path] = []
        ids, places = bytearray(), bytearray()
        for path, start, text, line in store.placed_lines(kind):
            if keep and not keep(line):
                continue
            if not self._paths or self._paths[-1] != path:
                self._paths.append(path)
            ids += line.id.encode()
            place = (len(self._paths) - 1, start, len(text), zlib.crc32(text))
            places += np.array(place, PLACE).tobytes()
            if watch:
                watch(line)
        # ids have 24 hexadecimal digits; equal ones stay in the order of the files
        of_all = np.frombuffer(ids, "S24")
        order = np.argsort(of_all, kind="stable")
        of_all = of_all[order]
        repeated = np.flatnonzero(of_all[1:] == of_all[:-1])
        self._repeated = of_all[repeated[0]].decode() if len(repeated) else ""
        self._folder, self._kind = store.folder, kind
        del ids, of_all
        self._places = np.frombuffer(places, PLACE)[order]

    def require_each_once(self) -> "PlacedLines":
        """Return the lines. Raises InputError if two of them have one id."""
        if self._repeated:
            rule, result = f"each of the {self._kind} once", f"{self._repeated} twice"
            remedy = f"python -m factory verify {self._folder} --repair takes the copies away"
            raise InputError(self._folder, rule, result, remedy)
        return self

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> Record | View: ...

    @overload
    def __getitem__(self, index: slice) -> "PlacedLines": ...

    def __getitem__(self, index: int | slice) -> "Record | View | PlacedLines":
        """Return a line, or the lines of a slice."""
        if isinstance(index, slice):
            return self.select(index)
        (line,) = self._read(self._places[[index]])
        return line

    def __iter__(self) -> Iterator[Record | View]:
        """Yield each line, in the order of their ids."""
        for first in range(0, len(self), BATCH):
            yield from self._read(self._places[first : first + BATCH])

    def select(self, which: slice | np.ndarray) -> "PlacedLines":
        """Return some of the lines in the same order: those of a slice, or (n,) truth values."""
        result = object.__new__(PlacedLines)
        result._decoder, result._paths = self._decoder, self._paths
        result._repeated, result._folder, result._kind = self._repeated, self._folder, self._kind
        result._places = self._places[which]
        return result

    def _read(self, places: np.ndarray) -> Iterator[Record | View]:
        """Yield the lines at some places; each file is opened once."""
        texts: list[bytes] = [b""] * len(places)
        order = np.lexsort((places["start"], places["file"])).tolist()
        rows = places.tolist()
        for number, of_file in groupby(order, key=lambda k: rows[k][0]):
            path = self._paths[number]
            with open(require_file(path, "a file of lines", REPAIR), "rb") as file:
                for k in of_file:
                    _, start, length, check = rows[k]
                    file.seek(start)
                    texts[k] = file.read(length)
                    if zlib.crc32(texts[k]) != check:
                        raise InputError(
                            path,
                            "the lines that it had a moment ago",
                            "others",
                            "run this command again once nothing else changes the data set",
                        )
        yield from map(self._decoder.decode, texts)
