"""Files of JSON lines: read line by line, and appended to so that a line is whole or not there."""

import contextlib
import errno
import fcntl
import os
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec

from manifests.errors import InputError
from manifests.inputs import require_file

REPAIR = "python -m factory verify DIR --repair takes it away"
# bytes; a record takes 1 KB, and 255 segments with names of 1,000 letters stay below
LONGEST_LINE = 1 << 20
# Keys that were added later are left out where they have no effect, so that lines stay what they
# were, and older programs, which refuse unknown keys, read them. Each pair is the text of such a
# key and what replaces it; in a JSON string the quotes would have backslashes. roll_deg is the
# last key of a camera, since without the bracket the text begins 0.05 as well.
LEFT_OUT = (
    (b',"roll_deg":0.0}', b"}"),
    (b',"camera_ranges":null', b""),
    (b',"error":null', b""),
    (b',"accuracy":null', b""),
    (b',"traced":null', b""),
)


def encode(value: Any, order: Literal["deterministic"] | None = None) -> bytes:
    """Return a value of manifests.schema as JSON, as data sets hold it."""
    text = msgspec.json.encode(value, order=order)
    for key, instead in LEFT_OUT:
        text = text.replace(key, instead)
    return text


def lines_of(path: str | os.PathLike) -> Iterator[tuple[int, bytes]]:
    """Yield each line of a file with its number from 1; an unfinished last line has no newline.

    Raises  InputError: no ordinary file, a line longer than any writer leaves; OSError if it cannot
            be read
    """
    for number, line in bounded_lines(path):
        if line is None:
            raise too_long(f"{path}:{number}")
        yield number, line


def bounded_lines(path: str | os.PathLike) -> Iterator[tuple[int, bytes | None]]:
    """Yield what `lines_of` does, but None for a line that is too long, and then those after it.

    No more than LONGEST_LINE bytes are in memory at once.
    Raises  InputError: no ordinary file; OSError if it cannot be read
    """
    with open(require_file(path, "a file of lines", REPAIR), "rb") as file:
        for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), 1):
            if len(line) < LONGEST_LINE or line.endswith(b"\n"):
                yield number, line
                continue
            yield number, None
            while (rest := file.readline(LONGEST_LINE)) and not rest.endswith(b"\n"):
                pass


def too_long(where: str) -> InputError:
    """Return the error of a line that is longer than any writer leaves."""
    rule = f"a line of at most {LONGEST_LINE} bytes"
    return InputError(where, rule, "a longer one", REPAIR)


class Lines:
    """An append-only file of JSON lines with one writer.

    Opening it cuts off an unfinished last line; a line is written whole or not at all.

    Raises  InputError if another process has the file open for writing
    """

    def __init__(self, path: str | os.PathLike):
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        self._closed = weakref.finalize(self, os.close, self._descriptor)
        self._own()
        self._torn = False  # whether a part of a line may follow the last whole one
        self._length = self._end_of_last_line()
        if self._length < os.fstat(self._descriptor).st_size:
            os.ftruncate(self._descriptor, self._length)

    def _own(self):
        try:
            # not flock, which a forked process would go on holding
            fcntl.lockf(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            self.close()
            remedy = "wait for it to end, or use another --out"
            raise InputError(
                self.path, "a file that no other run writes to", "one in use", remedy
            ) from None
        except OSError:  # a file system without locks
            pass

    def append(self, value: Any) -> None:
        """Write one value as a line.

        Raises  OSError (full disk), after which nothing of the line is left
        """
        self.append_line(encode(value) + b"\n")

    def append_line(self, line: bytes) -> None:
        """Write a line, given as bytes with its newline, as `append` does."""
        try:
            if self._torn:
                os.ftruncate(self._descriptor, self._length)
                self._torn = False
            written = os.write(self._descriptor, line)
            if written < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
        except OSError as error:
            self._torn = True
            # if this fails too, the next line or the next opening cuts the rest off
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._length)
                self._torn = False
            raise OSError(error.errno, error.strerror, str(self.path)) from None
        self._length += len(line)

    def sync(self) -> None:
        """Wait until what was appended is on the disk, or on the server of a network's file system.

        Raises  OSError: it could not be written. NFS says so here alone, for example after it has
                lost the file's lock, and throws away what `append` took
        """
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from None

    def read(self) -> bytes:
        """Return the whole lines. To open the file by its name would end this process's lock."""
        parts, place = [], 0
        while place < self._length:
            parts.append(os.pread(self._descriptor, min(1 << 24, self._length - place), place))
            place += len(parts[-1])
            if not parts[-1]:
                break
        return b"".join(parts)

    def close(self) -> None:
        """Close the file."""
        self._closed()

    def _end_of_last_line(self):
        """Return where the last whole line ends."""
        end = os.fstat(self._descriptor).st_size
        while end:
            start = max(0, end - 65536)
            newline = os.pread(self._descriptor, end - start, start).rfind(b"\n")
            if newline >= 0:
                return start + newline + 1
            end = start
        return 0
