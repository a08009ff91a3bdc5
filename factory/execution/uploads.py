"""Rendering into a folder on an object store.

Workers write into a local scratch folder, which begins as a copy of the store's records. A thread
of the run reads the lines that workers append, and writes to the store, in this order: labels and
lights, pictures and geometry, and then the lines as an object of their own, a part. A part is named
after its worker, the run and a number, so that a write that is tried again replaces itself.

What a run has not sent when it is killed is rendered again by the next one: the store's parts alone
say what is made.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from factory.execution.leases import Lease
from factory.execution.registration import require_no_foreign_files
from factory.execution.worker import Reply
from factory.planning import facts
from manifests.errors import InputError
from manifests.files import write_bytes
from manifests.line_files import encode
from manifests.object_store import THREADS, ObjectFolder
from manifests.schema import Record, View
from manifests.store import LINES, Store

SECONDS = 5.0  # between parts
MOST_WAITING = 1000  # pictures that were made and not sent; above, the run waits
LINES_PER_PART = 1000


@contextmanager
def uploading(
    url: str, shard: tuple[int, int] | None, note: Callable[[str], None], job: str = ""
) -> Iterator[Uploads]:
    """Yield the Uploads of a run. At the end of the block everything is sent.

    shard, note, job  as factory.execution.leases.Lease takes them
    Raises            InputError, Unreachable
    """
    remote = ObjectFolder(url)
    lease = Lease(remote, shard, note, job)
    with contextlib.ExitStack() as stack:
        stack.callback(lease.release)
        scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="brdfactory-"))
        try:
            uploads = Uploads(remote, Path(scratch))
            try:
                yield uploads
            finally:
                uploads.finish()
        except InputError as problem:
            where = problem.where.replace(scratch, remote.url)
            raise InputError(where, problem.expected, problem.found, problem.remedy) from None


class Uploads:
    """Sends what workers write into a scratch folder to an object store.

    remote  where it goes
    folder  the scratch folder; it holds the store's records, labels and lights at first
    """

    def __init__(self, remote: ObjectFolder, folder: Path):
        self.remote, self.folder = remote, folder
        self._run = uuid.uuid4().hex[:12]
        self._offsets: dict[Path, int] = {}  # bytes of each file of lines that were sent
        self._parts: dict[Path, int] = {}
        self._hashes: dict[str, str] = {}  # of files as they are on the store
        self._ids: dict[str, set[str]] = {}
        self._waiting = 0  # shots that were made and not sent
        self._replied: set[str] = set()  # ids that the run knows: their files are not read again
        self._sent: dict[str, Path] = {}  # {id: its picture}
        self._problem: InputError | None = None
        self._wake, self._changed = threading.Event(), threading.Condition()
        self._ended = False
        self._begin()
        self._thread = threading.Thread(target=self._work, name="uploads", daemon=True)
        self._thread.start()

    def count_reply(self, reply: Reply) -> None:
        """Count a shot that was made; wait while too many have not been sent.

        Raises  InputError if the store could not be written to
        """
        with self._changed:
            self._replied.add(reply.made)
            self._waiting += 1
            if self._waiting > MOST_WAITING:
                self._wake.set()
            while self._waiting > MOST_WAITING and self._problem is None:
                self._changed.wait()
            if self._problem is not None:
                raise self._problem

    def finish(self) -> None:
        """Send the rest. Raises InputError if the store could not be written to."""
        self._ended = True
        self._wake.set()
        self._thread.join()
        if self._problem is not None:
            raise self._problem

    def _begin(self) -> None:
        """Copy what the store holds of the data set, except pictures and geometry."""
        names: list[str] = []
        for kind in (*LINES, facts.FOLDER, "lights"):
            names += self.remote.names(kind)
        top = {"dataset.json", "materials.json"}
        names += [name for name in self.remote.names("") if name in top]
        for name, data in self.remote.read_all(names):
            if name.endswith(".jsonl"):
                data = self._whole_lines(name, data)
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if data:
                write_bytes(path, data)
            self._hashes[name] = hashlib.sha256(data).hexdigest()
            if name.endswith(".jsonl"):
                self._offsets[path] = len(data)
        require_no_foreign_files(Store(self.folder))  # before lines are read as records
        for kind in LINES:
            ids, hashes = Store(self.folder).known_ids(kind)
            self._ids[kind] = ids
            self._hashes |= hashes

    def _whole_lines(self, name: str, data: bytes) -> bytes:
        """Return the whole lines of a file on the store, and leave only them there.

        A folder that was copied to the store may hold a line of a killed run that is cut short.
        Workers cut it off here, and what they append would no longer lie where it is looked for.
        """
        whole = data[: data.rfind(b"\n") + 1]
        if whole:
            if len(whole) < len(data):
                self.remote.write(name, whole)
        elif data:
            self.remote.remove(name)
        return whole

    def _work(self) -> None:
        """Send until the run ends; the thread's function."""
        try:
            with ThreadPoolExecutor(THREADS, thread_name_prefix="upload") as threads:
                while True:
                    is_last = self._ended  # before sending: what was written until then is sent
                    self._send(threads.map)
                    if is_last:
                        return
                    self._wake.wait(SECONDS)
                    self._wake.clear()
        except InputError as problem:
            self._problem = problem
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            remedy = "run the same command again: what was written stays"
            self._problem = InputError(self.remote.url, "files that can be sent", text, remedy)
        finally:
            with self._changed:
                self._changed.notify_all()

    def _send(self, each: Callable[..., Any]) -> None:
        """Send all whole lines that were appended since the last time, and their files."""
        appended = [
            (kind, path, lines)
            for kind in (*LINES, facts.FOLDER)
            for path in sorted((self.folder / kind).glob("*.jsonl"))
            if (lines := self._new_lines(path))
        ]
        # labels and lights were written before the first of these lines
        self._send_whole(each)
        for kind, path, lines in appended:
            for first in range(0, len(lines), LINES_PER_PART):
                self._send_part(kind, path, lines[first : first + LINES_PER_PART], each)
        self._remove_pictures()

    def _new_lines(self, path: Path) -> list[bytes]:
        """Return the whole lines of a file that have not been sent."""
        with open(path, "rb") as file:
            file.seek(self._offsets.get(path, 0))
            data = file.read()
        return data[: data.rfind(b"\n") + 1].splitlines(keepends=True)

    def _send_whole(self, each: Callable[..., Any]) -> None:
        """Send the files that are replaced and not appended to, where they have changed."""
        names = [path.relative_to(self.folder).as_posix() for path in self.folder.glob("lights/*")]
        self._send_changed([*names, "materials.json"], each)
        self._send_changed(["dataset.json"], each)  # last: it names the others
        for path in self.folder.glob("failures*.jsonl"):
            self._send_file(path.name, f"{path.stem}-{self._run}.jsonl")

    def _send_changed(self, names: list[str], each: Callable[..., Any]) -> None:
        list(each(self._send_file, names))

    def _send_file(self, name: str, target: str | None = None) -> None:
        """Send a file under its name or another one, if the store has not the same bytes."""
        try:
            data = (self.folder / name).read_bytes()
        except FileNotFoundError:
            return
        target, digest = target or name, hashlib.sha256(data).hexdigest()
        if self._hashes.get(target) != digest:
            self.remote.write(target, data)
            self._hashes[target] = digest

    def _send_part(
        self, kind: str, path: Path, lines: list[bytes], each: Callable[..., Any]
    ) -> None:
        """Send lines of one file as a part, after the files that they name."""
        size = sum(map(len, lines))
        made = 0
        if kind in LINES:
            decoded = [msgspec.json.decode(line, type=LINES[kind]) for line in lines]
            made = len(decoded)
            known = self._ids[kind]
            new = {line.id: line for line in decoded if line.id not in known}
            geometries = {line.geometry for line in new.values()} - self._hashes.keys()
            list(each(self._send_geometry, sorted(geometries)))
            lines = [self._with_geometry(line) for line in new.values()]
            pictures = [line.image for line in new.values() if isinstance(line, Record)]
            list(each(self._send_picture, pictures))
            known |= new.keys()
            for line in new.values():
                if isinstance(line, Record):
                    self._sent[line.id] = self.folder / line.image
        if lines:
            number = self._parts[path] = self._parts.get(path, 0) + 1
            self.remote.write(f"{kind}/{path.stem}-{self._run}-{number:06d}.jsonl", b"".join(lines))
        self._offsets[path] = self._offsets.get(path, 0) + size
        with self._changed:
            self._waiting -= made
            self._changed.notify_all()

    def _send_picture(self, name: str) -> None:
        self.remote.write(name, (self.folder / name).read_bytes())

    def _send_geometry(self, name: str) -> None:
        """Send a geometry file unless the store holds it, from an earlier run or another part of
        a job array.
        """
        try:
            self._hashes[name] = hashlib.sha256(self.remote.read(name)).hexdigest()
        except FileNotFoundError:
            self._send_file(name)

    def _with_geometry(self, line: Record | View) -> bytes:
        """Return a line as bytes, with the hash of the geometry file that the store holds."""
        if (there := self._hashes[line.geometry]) != line.geometry_hash:
            line = msgspec.structs.replace(line, geometry_hash=there)
        return encode(line) + b"\n"

    def _remove_pictures(self) -> None:
        """Remove pictures from the scratch folder that were sent and are not read again."""
        with self._changed:
            ready = self._sent.keys() & self._replied
            self._replied -= ready
        for id_ in ready:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self._sent.pop(id_))
