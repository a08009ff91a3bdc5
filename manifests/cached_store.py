"""Data sets on object stores, read through a local folder of bounded size.

The local folder is laid out as a data set's. Records, labels and lights are copied when it is
opened; a picture or a geometry file when it is first asked for. Files that were used longest ago
make room for others.
"""

import contextlib
import hashlib
import math
import os
import tempfile
import threading
import time
import uuid
import weakref
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from manifests.errors import InputError
from manifests.files import replacing, write_json
from manifests.object_store import ObjectFolder, is_url
from manifests.reading import read
from manifests.store import LINES, Store
from manifests.store_paths import inside

FOLDER_VARIABLE = "BRDFACTORY_STORE_CACHE"  # where the copies lie, instead of the user's cache
LIMIT_VARIABLE = "BRDFACTORY_STORE_CACHE_GIB"  # of pictures and geometry of one data set
LIMIT_GIB = 20.0
BOUNDED = ("images", "geometry")  # the folders that the limit counts
RECENT = 60.0  # seconds: a file that was asked for so recently may be about to be read
SHARE_KEPT = 0.9  # of the limit, when room is made


def open_store(folder: str | os.PathLike, fresh: bool = False) -> Store:
    """Return the Store of a folder, or of a URL of a folder on an object store.

    fresh   read everything from the object store: nothing that was copied earlier is used
    Raises  InputError, Unreachable
    """
    return CachedStore(str(folder), fresh) if is_url(folder) else Store(folder)


class CachedStore(Store):
    """A data set on an object store. Its `folder` is the local copy."""

    def __init__(self, url: str, fresh: bool = False, limit_bytes: int | None = None):
        self.remote = ObjectFolder(url)
        if fresh:
            temporary = tempfile.TemporaryDirectory(prefix="brdfactory-")
            self._removed = weakref.finalize(self, temporary.cleanup)
            super().__init__(temporary.name)
        else:
            super().__init__(_cache() / hashlib.sha256(self.remote.url.encode()).hexdigest()[:24])
        # beside the folder, which holds nothing but copies
        self._states = None if fresh else self.folder.with_suffix(".json")
        self._limit = _limit_bytes() if limit_bytes is None else limit_bytes
        self._lock = threading.Lock()
        # {copy: time.monotonic of its last use here}, of the last RECENT seconds, oldest first
        self._recent: OrderedDict[Path, float] = OrderedDict()
        self._held = self._size()
        self._copy_lines()

    @property
    def name(self) -> str:
        """What the user calls the data set."""
        return self.remote.url

    def copy_here(self, relative: str) -> None:
        """Copy a file into the folder if the object exists and its copy does not.

        Raises  InputError for a path that leaves the folder; Unreachable
        """
        path = inside(self.folder, relative)
        self._note_use(path)
        try:
            os.utime(path)  # it was used last, now
        except FileNotFoundError:
            with contextlib.suppress(FileNotFoundError):
                data = self.remote.read(relative)
                self._make_room(len(data))
                self._write(path, data)

    def copy_again(self, relative: str) -> bool:
        """Replace the copy of an object that has other bytes by now; return whether it has.

        Its name stays when a picture is rendered again. Raises as `copy_here`
        """
        path = inside(self.folder, relative)
        try:
            data, held = self.remote.read(relative), path.read_bytes()
        except FileNotFoundError:
            return False
        if data == held:
            return False
        self._make_room(len(data) - len(held))
        self._write(path, data)
        return True

    def unnamed_objects(self, named: Mapping[str, Collection[str]]) -> Iterable[str]:
        """Yield the objects in folders of files that nothing names; see Store."""
        for kind, known in named.items():
            yield from sorted(self.remote.names(kind, deep=True).keys() - set(known))

    def _copy_lines(self) -> None:
        """Let dataset.json, materials.json, records, views, failures and lights be as there."""
        top = self.remote.states("")
        expected = {n: state for n, state in top.items() if n.endswith((".json", ".jsonl"))}
        changing = set(expected)
        for kind in (*LINES, "lights"):
            expected |= self.remote.states(kind)
        held = self._held_states()
        missing = []
        for name, state in expected.items():
            path = inside(self.folder, name)
            if name in changing or not path.is_file() or held.get(name) != state:
                missing.append(name)
        for name, data in self.remote.read_all(missing):
            self._write(inside(self.folder, name), data)
        for kind in ("", *LINES, "lights"):
            folder = self.folder / kind
            for path in list(folder.iterdir()) if folder.is_dir() else []:
                is_copy = path.is_file() and not path.name.startswith(".lock")
                if is_copy and path.relative_to(self.folder).as_posix() not in expected:
                    path.unlink(missing_ok=True)

        if missing and self._states is not None:
            write_json(self._states, expected)

    def _held_states(self) -> dict[str, list[str]]:
        """Return the states that objects had when they were copied; {} where none are known."""
        if self._states is None or not self._states.is_file():
            return {}
        try:
            return read(self._states, dict[str, list[str]])
        except InputError:  # damaged: all are copied again
            return {}

    def _write(self, path: Path, data: bytes) -> None:
        """Write a copy; another process may write the same one. An empty object has none."""
        if not data:
            path.unlink(missing_ok=True)
            return
        draft = self.folder / "partial" / uuid.uuid4().hex
        for each in (draft, path):
            each.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, draft) as file:
            file.write(data)

    def _note_use(self, path: Path) -> None:
        """Note that a copy is about to be read here."""
        now = time.monotonic()
        with self._lock:
            self._recent[path] = now
            self._recent.move_to_end(path)
            while now - next(iter(self._recent.values())) > RECENT:
                self._recent.popitem(last=False)

    def _size(self) -> int:
        return sum(size for _, size, _ in self._copies())

    def _copies(self) -> list[tuple[float, int, Path]]:
        """Return (time of last use, bytes, path) of the copies that the limit counts."""
        result = []
        for kind in BOUNDED:
            for path in (self.folder / kind).rglob("*"):
                with contextlib.suppress(FileNotFoundError):
                    status = path.stat()
                    if path.is_file():
                        result.append((status.st_mtime, status.st_size, path))
        return result

    def _make_room(self, size: int) -> None:
        """Remove the copies used longest ago if `size` more bytes would exceed the limit.

        This process's own uses are known by the monotonic clock, and those of others by file times.
        A file time that is far in the future is left by a clock that was set back, or by one that
        was wrong, and does not keep a copy.
        """
        with self._lock:
            self._held += size
            if self._held <= self._limit:
                return
            copies = sorted(self._copies())
            self._held = sum(held for _, held, _ in copies) + size
            now, here = time.time(), time.monotonic()
            for used, held, path in copies:
                if self._held <= SHARE_KEPT * self._limit:
                    break
                if abs(now - used) < RECENT or here - self._recent.get(path, -math.inf) < RECENT:
                    continue
                path.unlink(missing_ok=True)
                self._held -= held


def _cache() -> Path:
    """Return the folder of all copies."""
    if chosen := os.environ.get(FOLDER_VARIABLE):
        return Path(chosen)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "brdfactory" / "stores"


def _limit_bytes() -> int:
    text = os.environ.get(LIMIT_VARIABLE, str(LIMIT_GIB))
    try:
        return int(float(text) * (1 << 30))
    except (ValueError, OverflowError):
        raise InputError(
            LIMIT_VARIABLE, "a number of GiB", f"'{text}'", f"export {LIMIT_VARIABLE}=20"
        ) from None
