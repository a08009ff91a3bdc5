"""The cache of a data set's geometry: arrays mapped into memory, five bytes per pixel.

The cache is made on first use, and again when it is stale or damaged. Runs that need depth have a
third array, of two more bytes per pixel. V views, H, W picture:

packed/normals.npy   (V, H, W, 2) int16, n_x and n_y in units of 1/32767; n_z = √(1 − n_x² − n_y²),
                     for normals face the viewer. Packing turns a normal by .002° where it faces the
                     viewer and by .5° at most, at the rim
packed/segments.npy  (V, H, W) uint8, 1 … S, 0 in the background
packed/depth.npy     (V, H, W) int16, depth in units of 1/16384 radius
packed/skipped.json  hashes of files that were left out, and why
packed/sums.json     CRC-32 of the arrays' files, which reveals a damaged cache
packed/views.json    the geometry files' hashes, which reveal a stale cache; written last, removed
                     before anything else is changed
"""

import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from manifests.arrays import PACKED_DEPTH, PACKED_NORMALS, PACKED_SEGMENTS, PACKED_TYPES
from manifests.files import replacing, write_text
from manifests.inputs import require_file

LARGEST_JSON = 256 << 20  # bytes: 70 per view
ARRAYS = (PACKED_NORMALS, PACKED_SEGMENTS)
READ_BYTES = 1 << 18  # at once, for checksums

Rows = tuple[np.ndarray, ...]  # one for each array: of all views, or of one view its part


class GeometryCache:
    """The arrays of a data set's views, on the disk or in memory.

    folder  of the data set
    size    height and width of the pictures
    depth   whether there is an array of depth
    """

    def __init__(self, folder: Path, size: tuple[int, int], depth: bool):
        self._folder, self._size = folder / "packed", size
        self._names = (*ARRAYS, PACKED_DEPTH) if depth else ARRAYS

    def skipped(self) -> dict[str, str]:
        """Return {hash: what is wrong} of files that were left out when the cache was made."""
        known = self._read_small_file("skipped.json")
        return (
            known
            if isinstance(known, dict) and all(isinstance(text, str) for text in known.values())
            else {}
        )

    def read(self, hashes: Sequence[str]) -> Rows | None:
        """Return the arrays of the views with these hashes, mapped into memory.

        None where the cache was made of other files, is damaged, or is not there.
        """
        if self._read_small_file("views.json") != list(hashes):
            return None
        sums = self._read_small_file("sums.json")
        try:
            if not isinstance(sums, dict) or any(
                _checksum(self._at(name)) != sums.get(name) for name in self._names
            ):
                return None
            arrays = tuple(
                np.load(self._at(name), mmap_mode="r", allow_pickle=False) for name in self._names
            )
        except (OSError, ValueError, EOFError):
            return None
        shapes = tuple(array.shape for array in arrays)
        return arrays if shapes == self._shapes(len(hashes)) else None

    def write(
        self, views: Iterable[tuple[str, Rows]], most: int, skipped: Mapping[str, str]
    ) -> list[str]:
        """Write the rows of at most `most` views as they come, and return the views' hashes.

        skipped  {hash: what is wrong} of files that are left out, complete once all views came
        Raises   OSError with the system's reason
        """
        self._folder.mkdir(exist_ok=True)
        self._at("views.json").unlink(missing_ok=True)
        hashes: list[str] = []
        with ExitStack() as stack:
            files = [stack.enter_context(replacing(self._at(name))) for name in self._names]
            self._write_headers(files, most)
            for geometry_hash, rows in views:
                for file, name, values in zip(files, self._names, rows, strict=True):
                    file.write(np.ascontiguousarray(values, PACKED_TYPES[name]).tobytes())
                hashes.append(geometry_hash)
            if len(hashes) < most:  # NumPy leaves room for the first axis to change in place
                self._write_headers(files, len(hashes))
        sums = {name: _checksum(self._at(name)) for name in self._names}
        write_text(self._at("sums.json"), json.dumps(sums))
        write_text(self._at("skipped.json"), json.dumps(dict(skipped)))
        write_text(self._at("views.json"), json.dumps(hashes))
        return hashes

    def collect(self, views: Iterable[tuple[str, Rows]], most: int) -> Rows:
        """Return the arrays of at most `most` views, in memory."""
        arrays = [
            np.zeros(shape, PACKED_TYPES[name])
            for shape, name in zip(self._shapes(most), self._names, strict=True)
        ]
        count = 0
        for _, rows in views:
            for stored, values in zip(arrays, rows, strict=True):
                stored[count] = values
            count += 1
        return tuple(stored[:count] for stored in arrays)

    def _at(self, name: str) -> Path:
        return self._folder / name

    def _shapes(self, count: int) -> tuple[tuple[int, ...], ...]:
        """Return the arrays' shapes for `count` views."""
        frame = (count, *self._size)
        return ((*frame, 2), frame, frame)[: len(self._names)]

    def _write_headers(self, files: Sequence[BinaryIO], count: int) -> None:
        """Write the .npy headers for `count` views at the beginning of the arrays' files."""
        for file, name, shape in zip(files, self._names, self._shapes(count), strict=True):
            file.seek(0)
            header = {
                "descr": np.lib.format.dtype_to_descr(np.dtype(PACKED_TYPES[name])),
                "fortran_order": False,
                "shape": shape,
            }
            np.lib.format.write_array_header_1_0(file, header)

    def _read_small_file(self, name: str) -> Any:
        """Return the content of a small file of the cache; None if it is missing or damaged."""
        try:
            require_file(self._at(name), "a part of the cache", maximum_bytes=LARGEST_JSON)
            return json.loads(self._at(name).read_text())
        except (OSError, ValueError, RecursionError):
            return None


def _checksum(path: Path) -> int:
    """Return the CRC-32 of a file's bytes, at 2 GB per second."""
    result = 0
    require_file(path, "a part of the cache")
    with open(path, "rb") as file:
        while data := file.read(READ_BYTES):
            result = zlib.crc32(data, result)
    return result
