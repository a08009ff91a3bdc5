"""Result files, written whole or not at all.

Every writer of the project uses `replacing` or `write_bytes`. Libraries write into memory, or into
the plain stream that `replacing` yields, never to a path: OpenEXR, numpy and others ignore the
error of their last flush, so that a full disk would leave a short or empty file that looks
finished.

Unfinished files (drafts) are hidden beside their target, and their names say which process writes
them. The drafts of killed programs are removed by the next one that writes into the same folder.
"""

import contextlib
import io
import itertools
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

from manifests.errors import InputError
from manifests.inputs import kind_of

_DRAFT = itertools.count()  # two threads of one process never write one file's draft
_DRAFT_NAME = re.compile(r"\..*\.(?P<machine>\w+)-(?P<process>\d{1,9})-\d+\.part", re.DOTALL)
# folders in which this process has looked for the drafts of killed programs
_SWEPT: set[str] = set()


class _Waiting(NamedTuple):
    """A finished draft that is renamed when the block of `transaction` ends."""

    draft: Path
    target: Path


_TRANSACTION: ContextVar[list[_Waiting] | None] = ContextVar("together", default=None)


class _Draft(io.RawIOBase):
    """A stream that writes every byte, or raises OSError with the final file's name.

    It is no `io.FileIO`, so that numpy writes through it and not directly in C, where late errors
    are lost.
    """

    def __init__(self, descriptor: int, target: Path):
        self._descriptor, self._target = descriptor, target

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        written = 0
        with _name_target_in_errors(self._target):
            while written < len(view):
                written += os.write(self._descriptor, view[written:])
        return len(view)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return os.lseek(self._descriptor, offset, whence)

    def tell(self) -> int:
        return os.lseek(self._descriptor, 0, os.SEEK_CUR)

    def seekable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True


@contextmanager
def replacing(path: str | os.PathLike, draft: Path | None = None) -> Iterator[BinaryIO]:
    """Yield a stream whose content replaces the file at `path` if the block ends without an error.

    draft   where the unfinished file lies, on the same file system; None: beside `path`, under a
            hidden name
    Raises  OSError with the system's reason; InputError if a folder, a device or a pipe lies at
            `path`. The earlier file is then still there, and no draft is left behind.

    The bytes are on the disk before the name is (fsync, then rename). An empty file is refused: no
    format of this project has one, and libraries that ignore errors leave them.
    """
    path = Path(path)
    require_place_for_file(path)
    if draft is None:
        _remove_abandoned_drafts(path.parent)
        # a name has 255 bytes at most, of any kind
        name = os.fsdecode(os.fsencode(path.name)[:180])
        draft = path.with_name(f".{name}.{_machine()}-{os.getpid()}-{next(_DRAFT)}.part")
    with _name_target_in_errors(path):
        descriptor = os.open(
            draft, os.O_RDWR | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666
        )
    whole = False
    try:
        try:
            yield cast(BinaryIO, _Draft(descriptor, path))
            with _name_target_in_errors(path):
                if not os.fstat(descriptor).st_size:
                    raise ValueError(f"{path}: nothing was written; an empty file is never kept")
                os.fsync(descriptor)
        finally:
            with _name_target_in_errors(path):
                os.close(descriptor)
        whole = True
    finally:
        if whole and (waiting := _TRANSACTION.get()) is not None:
            waiting.append(_Waiting(draft, path))
        else:
            _finish(draft, path, whole)


@contextmanager
def transaction() -> Iterator[None]:
    """Rename the files that are written inside the block when it ends: all of them, or none.

    This is for results of several files, so that a full disk leaves neither half of them nor new
    ones beside old ones. Inside the block the new files cannot be read yet. An inner block belongs
    to the outer one.

    Raises  OSError for a file that cannot be renamed; the others have been
    """
    if _TRANSACTION.get() is not None:
        yield
        return
    waiting: list[_Waiting] = []
    token = _TRANSACTION.set(waiting)
    whole = False
    try:
        yield
        whole = True
    finally:
        _TRANSACTION.reset(token)
        with contextlib.ExitStack() as rest:  # each is finished, whatever happens to the others
            for each in reversed(waiting):
                rest.callback(_finish, *each, whole)


def drafts() -> dict[Path, Path]:
    """Return {target: draft} of the files that the transaction in progress has written so far."""
    return {each.target: each.draft for each in _TRANSACTION.get() or ()}


def _finish(draft: Path, target: Path, whole: bool) -> None:
    """Rename a draft to its target, or remove it if it is not whole."""
    try:
        if whole:
            with _name_target_in_errors(target):
                os.replace(draft, target)
    finally:
        if os.path.lexists(draft):
            os.unlink(draft)


@contextmanager
def _name_target_in_errors(path: Path) -> Iterator[None]:
    """Make OSErrors of the block name the file that is being written, not its draft."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _remove_abandoned_drafts(folder: Path) -> None:
    """Remove the drafts of killed programs on this machine, once per folder."""
    place = os.path.abspath(folder)
    if place in _SWEPT:
        return
    _SWEPT.add(place)
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for name in [entry.name for entry in entries if entry.name.endswith(".part")]:
            made_by = _DRAFT_NAME.fullmatch(name)
            if (
                made_by
                and made_by["machine"] == _machine()
                and not _is_alive(int(made_by["process"]))
            ):
                with contextlib.suppress(OSError):  # gone meanwhile
                    os.unlink(folder / name)


def _machine() -> str:
    """Return this machine's name, which is part of drafts' names: process ids are local to it."""
    return re.sub(r"[^A-Za-z0-9]+", "", os.uname().nodename)[:32] or "machine"


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's
        return True
    return True


def require_place_for_file(path: Path) -> None:
    """Raise InputError if something other than a file lies at `path`.

    A rename would replace a device.
    """
    try:
        result = kind_of(os.stat(path).st_mode)
    except OSError:  # nothing there; other errors occur again when the draft is opened
        return
    if result is not None:
        raise InputError(path, "a file, or a name for a new one", result, "give another name")


def write_bytes(path: str | os.PathLike, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all. Raises as `replacing`."""
    with replacing(path) as file:
        file.write(data)


def write_with(path: str | os.PathLike, save: Callable[[BinaryIO], Any]) -> None:
    """Write what `save(file)` writes to `path`, for libraries that ignore disk errors.

    Use `replacing` for what is too large for memory. Raises as `replacing`.
    """
    buffer = io.BytesIO()
    save(buffer)
    write_bytes(path, buffer.getvalue())


def write_image(
    path: str | os.PathLike, pixels: Any, format: str | None = None, **options: Any
) -> None:
    """Write display values as PNG or JPEG.

    pixels   (height, width[, 3 or 4]) uint8 array, or a Pillow image
    format   "PNG", "JPEG"; None: by the ending of `path`
    options  of Pillow's `save`
    """
    from PIL import Image

    image = pixels if isinstance(pixels, Image.Image) else Image.fromarray(pixels)
    if format is None:
        format = {".jpg": "JPEG", ".jpeg": "JPEG"}.get(Path(path).suffix.lower(), "PNG")
    write_with(path, lambda file: image.save(file, format=format, **options))


def write_figure(path: str | os.PathLike, figure: Any, **options: Any) -> None:
    """Write a matplotlib figure as PNG. options: of its `savefig`. Raises as `replacing`."""
    write_with(path, lambda file: figure.savefig(file, format="png", **options))


def npz_bytes(arrays: Mapping[str, Any]) -> bytes:
    """Return the bytes of a compressed .npz file of `arrays`, {name: array}."""
    import numpy as np

    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def write_lines(path: str | os.PathLike, lines: Iterable[bytes], draft: Path | None = None) -> None:
    """Write lines, each with its newline, to `path`; without lines, an existing file is removed.

    draft   as `replacing` takes it
    Raises  as `replacing`
    """
    data = b"".join(lines)
    if data:
        with replacing(path, draft) as file:
            file.write(data)
    else:
        Path(path).unlink(missing_ok=True)


def write_text(path: str | os.PathLike, text: str) -> None:
    """Write UTF-8 text, whole or not at all: a kill or a full disk leaves the earlier file.

    Bytes of file names that are not UTF-8 (surrogates in Python) are written as \\udcXX, which JSON
    reads back unchanged. Raises as `replacing`.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: str | os.PathLike, value: Any) -> None:
    """Write JSON as `write_text` does; null stands for NaN and infinity, which JSON lacks."""
    write_text(
        path, json.dumps(_finite(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    )


def _finite(value):
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
