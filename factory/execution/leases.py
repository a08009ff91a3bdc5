"""A run's lease of a data set on an object store, where there are no locks.

Each run writes an object of its own, running/RUN.json, and rewrites it as long as it lives. A run
that finds another's object looks whether it changes: then the other run is alive, and this one is
refused; if it has not changed for EXPIRED seconds, the other run was killed, and its object is
removed. No clocks of two machines are compared, and what an object says does not matter.

A run writes its object before it looks for others. Of two runs that begin together at least one
therefore sees the other; it may be that both are refused.
"""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections.abc import Callable

import msgspec

from manifests.errors import InputError
from manifests.object_store import ObjectFolder

FOLDER = "running"
RENEWED = 10.0  # seconds after which a run rewrites its object
EXPIRED = 60.0  # seconds without a change after which a run counts as killed
PAUSE = 1.0  # seconds between two looks at another run's object


class _Running(msgspec.Struct):
    """The object of a run: part `part` of `parts` of its job, and how often it was written.

    job  a digest of the job
    """

    part: int = 1
    parts: int = 1
    written: int = 0
    job: str = ""

    def conflicts_with(self, other: _Running) -> bool:
        """Return whether both may make the same shots, or write other entries into one file.

        Parts of one division of one job do neither. Runs of different jobs would each write a
        dataset.json and a materials.json without what the other one enters.
        """
        return self.job != other.job or self.parts != other.parts or self.part == other.part


class Lease:
    """Held from its creation until `release`.

    remote  the data set
    shard   None, or (i, n): part i of n, 1 ≤ i ≤ n
    note    called with a line for the user before it waits
    job     a digest of the job, the same for all parts of it
    Raises  InputError if another run makes the same shots, or makes another job; Unreachable
    """

    def __init__(
        self,
        remote: ObjectFolder,
        shard: tuple[int, int] | None,
        note: Callable[[str], None],
        job: str = "",
    ):
        self._remote, self._running = remote, _Running(*(shard or (1, 1)), job=job)
        self._name = f"{FOLDER}/{uuid.uuid4().hex[:12]}.json"
        self._ended = threading.Event()
        self._write()
        self._thread = threading.Thread(target=self._renew, name="lease", daemon=True)
        self._thread.start()
        try:
            self._refuse_if_taken(note)
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Remove the run's object; where the store does not answer, it is left to expire."""
        self._ended.set()
        self._thread.join()
        with contextlib.suppress(InputError):
            self._remote.remove(self._name)

    def _write(self) -> None:
        self._running.written += 1
        self._remote.write(self._name, msgspec.json.encode(self._running))

    def _renew(self) -> None:
        """Rewrite the object until the run ends; the thread's function."""
        while not self._ended.wait(RENEWED):
            with contextlib.suppress(InputError):  # whoever sends the pictures says so
                self._write()

    def _refuse_if_taken(self, note: Callable[[str], None]) -> None:
        others = {name: self._read(name) for name in self._remote.names(FOLDER)}
        others.pop(self._name, None)
        waiting = {name: data for name, data in others.items() if data and self._conflicts(data)}
        if waiting:
            note(
                f"{self._remote.url}: another run was killed or is still running; waiting up to"
                f" {EXPIRED:g} s to see which"
            )
        end = time.monotonic() + EXPIRED
        while waiting and time.monotonic() < end:
            self._ended.wait(PAUSE)
            for name, data in list(waiting.items()):
                now = self._read(name)
                if now is None:  # it has ended
                    del waiting[name]
                elif now != data:
                    remedy = "wait for it to end, or use another --out"
                    raise InputError(
                        self._remote.url,
                        "a folder that no other run writes to",
                        "one in use",
                        remedy,
                    )
        for name in waiting:
            self._remote.remove(name)

    def _read(self, name: str) -> bytes | None:
        """Return an object's bytes, None where it is there no more."""
        try:
            return self._remote.read(name)
        except FileNotFoundError:
            return None

    def _conflicts(self, data: bytes) -> bool:
        """Return whether a run, by its object, may make the same shots; a torn one may."""
        try:
            return self._running.conflicts_with(msgspec.json.decode(data, type=_Running))
        except msgspec.DecodeError:
            return True
