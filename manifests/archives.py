"""Zip files from outside (.npz of numpy, furniture libraries) and their arrays, read within limits.

A zip's directory and an array's header state sizes before memory is allocated. Both may be wrong,
so the bytes that are read are counted, too. Whatever the zip library raises for a damaged,
encrypted or unknown member becomes an InputError.
"""

import lzma
import math
import os
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

import numpy as np

from manifests.errors import InputError
from manifests.inputs import require_file

# What zipfile and its decompressors raise, by version and by kind of damage: RuntimeError for
# encrypted members, NotImplementedError for unknown methods, ValueError for damaged names
# and headers
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    OSError,
    EOFError,
    ValueError,
    RuntimeError,
    NotImplementedError,
    OverflowError,
)
# what numpy's parser of headers raises besides ValueError
NO_HEADER = (SyntaxError, TypeError, MemoryError, RecursionError, tokenize.TokenError)
MOST_MEMBERS = 20_000


@contextmanager
def open_zip(
    path: str | os.PathLike, expected: str, remedy: str, most: int = MOST_MEMBERS
) -> Iterator[zipfile.ZipFile]:
    """Open a zip of at most `most` members; damage found inside the block is an InputError, too.

    expected, remedy  what should lie at `path`, with its article, and what to do otherwise
    Raises            InputError
    """
    require_file(path, expected, remedy)
    try:
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            if len(archive.infolist()) > most:
                raise InputError(
                    path,
                    f"at most {most:,} files in it",
                    f"{len(archive.infolist()):,}",
                    "split it into several",
                )
            yield archive
    except InputError:
        raise
    except DAMAGE as error:
        raise InputError(path, expected, _reason(error), remedy) from None


def _reason(error):
    """Return an error as one short line."""
    first = (str(error).splitlines() or [""])[0][:100]
    return f"'{first}'" if first else f"a damaged one ({type(error).__name__})"


class ArrayHeader:
    """The header of an .npy stream, which is left at the first value.

    shape    whole numbers ≥ 0
    dtype    of numbers alone: no objects, no records
    fortran  True: the first axis runs fastest
    Raises   ValueError
    """

    def __init__(self, stream: IO[bytes]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # headers of Python 2 are read, with a warning
            version = np.lib.format.read_magic(stream)
            if version not in ((1, 0), (2, 0), (3, 0)):
                raise ValueError(f"an array of version {version}")
            read = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            try:
                self.shape, self.fortran, self.dtype = read(stream)
            except NO_HEADER:
                raise ValueError("a damaged array header") from None
        if any(isinstance(n, bool) or n < 0 for n in self.shape):
            raise ValueError(f"an array of shape {self.shape}")
        if self.dtype.hasobject or self.dtype.fields or self.dtype.subdtype:
            raise ValueError(f"an array of {self.dtype}")

    @property
    def bytes(self) -> int:
        """Number of bytes that the values take."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_array(archive: zipfile.ZipFile, name: str, most_bytes: int) -> np.ndarray:
    """Return an array of an .npz without unpickling.

    Raises  KeyError if it is missing; ValueError if it is too large or damaged
    """
    with archive.open(name if name in archive.namelist() else f"{name}.npy") as stream:
        header = ArrayHeader(stream)
        if header.bytes > most_bytes:
            raise ValueError(
                f"{name}: expected at most {most_bytes:,} bytes, found {header.bytes:,}"
            )
        data = read_exactly(stream, header.bytes)
    return np.frombuffer(data, header.dtype).reshape(
        header.shape, order="F" if header.fortran else "C"
    )


def read_exactly(stream: IO[bytes], count: int) -> bytes:
    """Return the next `count` bytes. Raises EOFError if there are fewer."""
    pieces, left = [], count
    while left:
        piece = stream.read(min(left, 1 << 24))
        if not piece:
            raise EOFError(f"expected {count:,} bytes, found {count - left:,}")
        pieces.append(piece)
        left -= len(piece)
    return b"".join(pieces)
