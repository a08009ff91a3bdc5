"""A data set's folder: what lies in it, and how its files and lines are read and written whole.

    dataset.json  materials.json   the jobs with their assets; the labels of the materials used
    images/ab/ID.exr  geometry/ab/ID.exr  lights/NAME-HASH.npz
    records/worker-NN.jsonl        one line per picture, appended after its files have been
                                   written; one writer per file
    views/worker-NN.jsonl          the same for geometry alone, one line per view of a shape, in
                                   jobs without pictures
    failures.jsonl                 what failed, and why (failures-SHARD.jsonl in job arrays)
    shape-facts/*.jsonl            what was read of shapes (factory.planning.facts); without it,
                                   they are read again
    shape-sources.jsonl            which source makes a mesh that several parts of a job array
                                   read (factory.execution.reservations)
    partial/                       unfinished files; what is there after a run can be deleted
    .lock*                         held by a run while it writes

On an object store the folder is the same, but records, views and facts are written as parts, one
after the other (factory.execution.uploads), and there are neither drafts nor locks.

A kill at any moment loses at most the current shot: a file is written under partial/ and renamed,
and readers ignore an unfinished last line, which the next writer cuts off.
"""

import hashlib
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from manifests import lock
from manifests.errors import InputError
from manifests.files import replacing
from manifests.line_files import REPAIR, Lines, encode, lines_of
from manifests.reading import decode, read
from manifests.schema import VERSION, Dataset, Failure, Record, View
from manifests.store_paths import (
    file_hash,
    inside,
    readable_hash,
)

LINES = {"records": Record, "views": View}  # folder: what its lines are


class _Id(msgspec.Struct, gc=False):
    id: str


class _Known(msgspec.Struct, gc=False):
    id: str
    geometry: str
    geometry_hash: str


class _Version(msgspec.Struct):
    version: int


class Store:
    """A data set on disk.

    Reading needs the folder alone. A worker writes files by `place` and lines by `Lines`.
    """

    def __init__(self, folder: str | os.PathLike):
        self.folder = Path(folder)

    @property
    def name(self) -> str:
        """What the user calls the data set: its folder, or its URL (manifests.cached_store)."""
        return str(self.folder)

    def fetch(self, relative: str) -> Path:
        """Return the path of a file that a manifest names, whether or not there is one.

        Raises  InputError for a path that leaves the folder
        """
        self.copy_here(relative)
        return inside(self.folder, relative)

    def copy_here(self, relative: str) -> None:
        """Copy a file into the folder; there is nothing to do unless it is elsewhere."""

    def copy_again(self, relative: str) -> bool:
        """Replace the copy of a file that has become another one since; return whether it has."""
        return False

    def unnamed_objects(self, named: Mapping[str, Collection[str]]) -> Iterable[str]:
        """Yield objects that nothing names and that have no copy in the folder: none here.

        named   {folder: paths of the files that may lie there}
        """
        return ()

    def dataset(self) -> Dataset:
        """Return dataset.json. Raises InputError: missing, damaged or of another schema version."""
        path = self.folder / "dataset.json"
        if not os.path.lexists(path):
            from manifests.object_store import is_url

            if is_url(self.folder):
                remedy = "copy the data set to a disk: this command reads folders only"
                raise InputError(self.folder, "the folder of a data set", "a URL", remedy)
            raise InputError(
                self.name,
                "a data set (dataset.json)",
                "none",
                "make one with: python -m factory render JOB --out DIR",
            )
        try:
            version = read(path, _Version).version
            if version == VERSION:
                return read(path, Dataset)
        except InputError as problem:
            remedy = (
                "restore it, or delete it and render each of the folder's jobs again: no picture is"
                " rendered twice"
            )
            raise InputError(problem.where, problem.expected, problem.found, remedy) from None
        raise InputError(
            path,
            f"schema version {VERSION}",
            str(version),
            "read it with the program version that wrote it",
        )

    def record_files(self, kind: str = "records") -> list[Path]:
        """Return the files of one kind of lines, one per worker, in order of name.

        Raises  InputError if their folder is no folder
        """
        folder = self.folder / kind
        try:
            names = os.listdir(folder)
        except FileNotFoundError:
            return []
        # a file, links in a circle, no permission: none of them is an empty folder
        except OSError as error:
            raise InputError(
                folder, f"a folder of {kind}", str(error.strerror or error).lower(), REPAIR
            ) from None
        return [folder / name for name in sorted(names) if name.endswith(".jsonl")]

    def records(self, keep: Callable[[Record], Any] | None = None) -> Iterator[Record]:
        """Yield each Record, file after file.

        keep    called with each Record; those for which it is false are left out
        Raises  InputError for a line that no writer leaves
        """
        return (
            filter(keep, self._decode_lines(Record, "records"))
            if keep
            else self._decode_lines(Record, "records")
        )

    def views(self, keep: Callable[[View], Any] | None = None) -> Iterator[View]:
        """Yield each View, as `records` yields each Record."""
        return (
            filter(keep, self._decode_lines(View, "views"))
            if keep
            else self._decode_lines(View, "views")
        )

    def ids(self, kind: str = "records") -> set[str]:
        """Return the ids of all lines of a kind, without decoding the rest of a line."""
        return {line.id for *_, line in self._lines_with_places(_Id, kind)}

    def known_ids(self, kind: str = "records") -> tuple[set[str], dict[str, str]]:
        """Return (ids, hashes): the ids of all lines of a kind, and the hashes of geometry files.

        hashes  {path: hash} of each file that a record or a view names; the first where lines
                disagree
        """
        ids: set[str] = set()
        hashes: dict[str, str] = {}
        for each in LINES:
            for *_, line in self._lines_with_places(_Known, each):
                hashes.setdefault(line.geometry, line.geometry_hash)
                if each == kind:
                    ids.add(line.id)
        return ids, hashes

    def failures(self) -> Iterator[Failure]:
        """Yield every Failure."""
        for path in sorted(self.folder.glob("failures*.jsonl")):
            for number, line in lines_of(path):
                if line.endswith(b"\n"):
                    yield _line(
                        line,
                        Failure,
                        f"{path}:{number}",
                        "delete this file: it only says what went wrong",
                    )

    def placed_lines(self, kind: str = "records") -> Iterator[tuple[Path, int, bytes, Any]]:
        """Yield (file, number of its byte with which the line begins, line, what it says) of lines.

        Raises  InputError for a line that no writer leaves
        """
        return self._lines_with_places(LINES[kind], kind)

    def _decode_lines(self, type_, kind):
        """Yield each line of a kind as a `type_`."""
        return (line for *_, line in self._lines_with_places(type_, kind))

    def _lines_with_places(self, type_, kind):
        """Yield (file, byte at which the line begins, line, the line as a `type_`) of lines."""
        decoder = msgspec.json.Decoder(type_)
        for path in self.record_files(kind):
            start = 0
            for number, line in lines_of(path):
                if not line.endswith(b"\n"):
                    break  # unfinished: its shot counts as not made
                try:
                    record = decoder.decode(line)
                except (msgspec.DecodeError, UnicodeDecodeError):
                    remedy = (
                        f"python -m factory verify {self.folder} --repair, then render the same"
                        " jobs again"
                    )
                    record = _line(line, type_, f"{path}:{number}", remedy)
                yield path, start, line, record
                start += len(line)

    def write_json(self, name: str, value: Any, worker: str = "main") -> None:
        """Write a small JSON file through partial/."""
        text = msgspec.json.format(encode(value, order="deterministic"), indent=1)
        self.place(name, text + b"\n", worker)

    def place(self, relative: str, data: bytes, worker: str, keep_first: bool = False) -> str:
        """Write a file whole, and return the sha256 of the file that is in place afterwards.

        relative    its path in the folder
        data        bytes of the whole file
        worker      who writes: temporary names of two workers differ
        keep_first  a file that exists is not replaced (two workers made the same geometry)
        Raises      OSError (full disk); the earlier file is then unchanged, and nothing is left
                    behind
        """
        target = self.folder / relative
        temporary = self.folder / "partial" / f"{worker}-{target.name}"
        temporary.parent.mkdir(parents=True, exist_ok=True)
        target.parent.mkdir(parents=True, exist_ok=True)
        if not keep_first:
            with replacing(target, draft=temporary) as file:
                file.write(data)
            return hashlib.sha256(data).hexdigest()
        whole = temporary.with_name(f"{temporary.name}.whole")
        try:
            try:
                with replacing(whole, draft=temporary) as file:
                    file.write(data)
                is_ours = _link(whole, target)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(target)) from None
            return hashlib.sha256(data).hexdigest() if is_ours else file_hash(target)
        finally:
            whole.unlink(missing_ok=True)

    def place_instead(self, relative: str, data: bytes, worker: str, damaged: str | None) -> str:
        """Replace a damaged file, and return the sha256 of the file that is in place afterwards.

        damaged  sha256 of the damaged file, None if it cannot be read. A file with another sha256
                 was written by another worker meanwhile, and stays.
        Raises   OSError as `place`
        """
        with lock.changing(self.folder):
            result = readable_hash(self.folder / relative)
            if result is not None and result != damaged:
                return result
            return self.place(relative, data, worker)

    def sweep(self, prefix: str = "", patience: float = 0.0) -> None:
        """Remove what killed runs left unfinished, files and lines.

        prefix    of workers' names, to clean up after one shard alone
        patience  seconds to wait for workers on other machines, which do not hold the folder's
                  lock, to end
        Raises    InputError if one of them still writes
        """
        end = time.monotonic() + patience
        partial = self.folder / "partial"
        for path in partial.glob(f"{prefix}*") if partial.is_dir() else ():
            path.unlink(missing_ok=True)
        for path in (path for kind in LINES for path in self.record_files(kind)):
            while path.name.startswith(prefix):
                try:
                    Lines(path).close()
                    break
                except InputError:
                    if time.monotonic() >= end:
                        raise
                    time.sleep(0.1)


def _line(line, type_, where, remedy):
    """Return a line as a `type_`. Raises InputError with the given remedy."""
    try:
        return decode(line, type_, where)
    except InputError as problem:
        raise InputError(problem.where, problem.expected, problem.found, remedy) from None


def _link(temporary, target):
    """Give the file its final name unless that exists; return whether it was given."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        return False
    except OSError:  # a file system without hard links
        if target.exists():
            return False
        os.replace(temporary, target)
    return True
