"""Files that results are kept in: written whole or not at all, and continued only by the settings
that made them.

Every writer of the project goes through `replacing` or `write_bytes`. Libraries write into memory,
or into the plain stream that `replacing` yields, never to a path: OpenEXR, numpy and others pass
over the error of their last flush, so that a full disk would leave a short or empty file which
looks finished.

Unfinished files (drafts) are hidden beside their target, and their names say which process writes
them. What a killed program left, the next one that writes into the same folder removes.
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
from typing import Any, BinaryIO, NamedTuple

from manifests.errors import InputError
from manifests.inputs import kind_of, require_file

MOST_LINE_BYTES = 256 << 20  # of a file of result lines: a thousand edits take 4 MB

_DRAFT = itertools.count()  # two threads of one process never write one file's draft
_DRAFT_NAME = re.compile(r"\..*\.(?P<machine>\w+)-(?P<process>\d{1,9})-\d+\.part", re.DOTALL)
_SWEPT = set()  # folders in which this process has looked for the drafts of killed programs


class _Waiting(NamedTuple):
    """A whole draft that takes its place when the block of `together` ends."""

    draft: Path
    target: Path


_TRANSACTION: ContextVar[list[_Waiting] | None] = ContextVar("together", default=None)


class _Draft(io.RawIOBase):
    """A stream that writes every byte it is given or raises OSError with the final file's name.

    It is no `io.FileIO`, so numpy writes through it and not past it by C, whose late errors are
    lost.
    """

    def __init__(self, descriptor: int, target: Path):
        self._descriptor, self._target = descriptor, target

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        written = 0
        with _named(self._target):
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
    """A binary stream whose content takes the place of the file at `path` when the block ends
    without an error.

    draft   where the unfinished file lies, on the same file system; None: beside `path`, under a
    hidden name
    Raises  OSError with the system's reason; InputError if a folder, a device or a pipe lies at
    `path`. The earlier
            file is then still there, and no draft is left behind

    The bytes are on the disk before the name is (fsync, then rename). An empty file is refused: no
    format of this project has one, and writers that swallow errors leave them.
    """
    path = Path(path)
    require_place_for_file(path)
    if draft is None:
        _remove_abandoned_drafts(path.parent)
        # a name has 255 bytes at most, of any kind
        name = os.fsdecode(os.fsencode(path.name)[:180])
        draft = path.with_name(f".{name}.{_machine()}-{os.getpid()}-{next(_DRAFT)}.part")
    with _named(path):
        descriptor = os.open(
            draft, os.O_RDWR | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666
        )
    whole = False
    try:
        try:
            yield _Draft(descriptor, path)
            with _named(path):
                if not os.fstat(descriptor).st_size:
                    raise ValueError(f"{path}: nothing was written; an empty file is never kept")
                os.fsync(descriptor)
        finally:
            with _named(path):
                os.close(descriptor)
        whole = True
    finally:
        if whole and (waiting := _TRANSACTION.get()) is not None:
            waiting.append(_Waiting(draft, path))
        else:
            _finish(draft, path, whole)


@contextmanager
def transaction() -> Iterator[None]:
    """A block whose files take their places when it ends without an error: all of them, or none.

    For results of several files, so that a full disk leaves neither half of them nor new ones
    beside old ones. Within the block the new files cannot be read yet. An inner block belongs to
    the outer one.

    Raises  OSError of a file that cannot take its place; the others have taken theirs
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


def _finish(draft: Path, target: Path, whole: bool) -> None:
    """Give a draft its place, or remove it if it is not whole."""
    try:
        if whole:
            with _named(target):
                os.replace(draft, target)
    finally:
        if os.path.lexists(draft):
            os.unlink(draft)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """OSErrors of the block name the file that was to be written, not its draft."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _remove_abandoned_drafts(folder: Path) -> None:
    """Remove what killed programs of this machine left unfinished. Looks once into each folder."""
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
    """This machine's name as drafts carry it: what a process's number means elsewhere, nobody knows
    here.
    """
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
    """Raises InputError if something lies at `path` that is no file: a rename would take a device's
    place.
    """
    try:
        result = kind_of(os.stat(path).st_mode)
    except OSError:  # nothing there; whatever else is wrong shows when the draft is opened
        return
    if result is not None:
        raise InputError(path, "a file, or a name for a new one", result, "give another name")


def write_bytes(path: str | os.PathLike, data: bytes) -> None:
    """Put `data` at `path`, whole or not at all. Raises as `replacing`."""
    with replacing(path) as file:
        file.write(data)


def write_with(path: str | os.PathLike, save: Callable[[BinaryIO], Any]) -> None:
    """Put at `path` what `save(file)` writes, by way of memory: for libraries that lose the errors
    of a disk.

    Use `replacing` for what is too large to be held in memory. Raises as `replacing`.
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


def npz_bytes(arrays: Mapping[str, Any], compressed: bool = True) -> bytes:
    """The bytes of an .npz file of `arrays`, {name: array}."""
    import numpy as np

    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, **arrays)
    return buffer.getvalue()


def write_npz(path: str | os.PathLike, arrays: Mapping[str, Any], compressed: bool = True) -> None:
    """Write an .npz file of `arrays`, {name: array}. Raises as `replacing`."""
    write_bytes(path, npz_bytes(arrays, compressed))


def write_lines(path: str | os.PathLike, lines: Iterable[bytes], draft: Path | None = None) -> None:
    """Write lines, each with its newline, to `path`; none at all give no file, and an earlier one
    goes.

    draft   as `replacing` takes it. Raises as `replacing`
    """
    data = b"".join(lines)
    if data:
        with replacing(path, draft) as file:
            file.write(data)
    else:
        Path(path).unlink(missing_ok=True)


def reserve_outputs(
    folder: Path,
    names: Iterable[str],
    overwrite: bool,
    inputs: Iterable[str | os.PathLike | None] = (),
) -> None:
    """Raises InputError if one of the files is there and may not be replaced, or is one of the
    inputs, which never may.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(
            folder, "a folder, or a name for a new one", "a file", "give another --out"
        )
    there = [folder / name for name in names if (folder / name).exists()]
    read = [Path(path) for path in inputs if path is not None and os.path.isfile(path)]
    for path in there:
        if any(path.samefile(each) for each in read):
            raise InputError(
                path,
                "a folder for results that does not hold what they are made of",
                "this input",
                "give another --out",
            )
    if there and not overwrite:
        raise InputError(there[0], "no earlier result", "one", "give another --out, or --overwrite")


def write_text(path: str | os.PathLike, text: str) -> None:
    """UTF-8 text, whole or not at all: a kill or a full disk leaves the earlier file. Raises as
    `replacing`.

    Bytes of file names that are no UTF-8 (surrogates in Python) are written as \\udcXX, which JSON
    reads back as they were.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: str | os.PathLike, value: Any) -> None:
    """As `write_text`; null stands for what JSON has no number for: NaN, infinity."""
    write_text(
        path, json.dumps(_finite(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    )


def _finite(value):
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_lines(path: str | os.PathLike, line_type: Any = dict[str, Any]) -> list[dict[str, Any]]:
    """The whole lines of a JSONL file as dictionaries; a torn last one is passed over; none if
    there is no file.

    line_type  what msgspec checks each line against; keys that it does not know are kept
    Raises     InputError for a damaged line, for what is no ordinary file, and for one above
    MOST_LINE_BYTES
    """
    import msgspec

    from manifests.reading import decode

    if not os.path.lexists(path):
        return []
    require_file(path, "lines of JSON", "give another --out", MOST_LINE_BYTES)
    lines = []
    for number, line in enumerate(Path(path).read_bytes().split(b"\n")[:-1], 1):
        try:
            decode(line, line_type, f"{path}:{number}")
        except InputError as problem:
            remedy = "remove the line: what it holds is made again"
            raise InputError(problem.where, problem.expected, problem.found, remedy) from None
        lines.append(msgspec.json.decode(line))
    return lines


def pin_settings(path: Path, requested: Mapping[str, Any]) -> None:
    """Write down what the figures beside `path` depend on, or check that it is what is there.
    Raises InputError.

    wanted  {name: value} that JSON can hold; a tuple is a list there
    """
    from manifests.reading import read
    from manifests.renamed_keys import with_current_names

    requested = with_current_names(json.loads(json.dumps(requested)), path)
    if not os.path.lexists(path):
        write_json(path, requested)
        return
    try:
        there = with_current_names(read(path, dict[str, Any]), path)
    except InputError as problem:
        raise InputError(
            problem.where, "settings as JSON", problem.found, "give another --out"
        ) from None
    other = [key for key in requested if there.get(key) != requested[key]]
    if other:
        raise InputError(
            path.parent,
            "results of the same settings",
            f"other {', '.join(other)}",
            "give another --out",
        )
