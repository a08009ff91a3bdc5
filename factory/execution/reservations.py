"""Decides which source of a job makes a mesh that several of its sources hold.

Parts of a job that read their own shapes alone do not see that another part reads the same mesh
from another source. The first source that is registered keeps the mesh for the job, and the others
are left out: DIR/shape-sources.jsonl says which, a line for each mesh. It is read and added to
while dataset.json is held (manifests.lock.changing). The file matters only while parts run:
without it, another source may come first in the next run, which makes the shots that are missing.
"""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

import msgspec

from factory.planning.shape_names import Source
from manifests.inputs import require_file
from manifests.line_files import LONGEST_LINE, Lines, encode
from manifests.schema import Job

FILE = "shape-sources.jsonl"
REMEDY = "remove it while no part of the job runs"


class Reservation(msgspec.Struct, frozen=True):
    """A line: a mesh of a job, the source that makes it, and its number of shots.

    job, mesh, source  hashes; a source's is not its path, which is the user's own matter
    """

    job: str
    mesh: str
    source: str
    shots: int


class Reservations:
    """The meshes of one job, and which of its sources makes each.

    folder   the data set's folder
    sources  all sources of the job: a mesh that a source of another job holds is free
    shared   whether parts of the job run side by side, which are shown what is reserved here
    """

    def __init__(self, folder: Path, job: Job, sources: Iterable[Source], shared: bool):
        self._path, self._shared = folder / FILE, shared
        self._job = _hash(encode(msgspec.structs.replace(job, name="", about="")))
        self._sources = {_hash_of(source) for source in sources}
        self._by_mesh: dict[str, Reservation] = {}
        self._new: list[Reservation] = []
        self._offset = 0  # bytes of the file that have been read

    @property
    def shots(self) -> int:
        """Number of shots of all meshes that are reserved."""
        return sum(reservation.shots for reservation in self._by_mesh.values())

    def refresh(self) -> None:
        """Read what parts of the job have reserved since the last time; damaged lines are left out.

        Raises  InputError if there is something else than a file; OSError
        """
        if not os.path.lexists(self._path):
            return
        with open(require_file(self._path, "a file of lines", REMEDY), "rb") as file:
            file.seek(self._offset)
            for line in iter(lambda: file.readline(LONGEST_LINE), b""):
                if not line.endswith(b"\n") and len(line) < LONGEST_LINE:
                    return  # unfinished
                self._offset += len(line)
                try:
                    reservation = msgspec.json.decode(line, type=Reservation)
                except (msgspec.DecodeError, UnicodeDecodeError):
                    continue
                if reservation.job == self._job and reservation.source in self._sources:
                    self._by_mesh.setdefault(reservation.mesh, reservation)

    def reserve(self, mesh: str, source: Source, shots: int) -> bool:
        """Return whether a source makes a mesh: it does if no other source has reserved it.

        mesh   its hash
        shots  number of shots of the whole mesh
        """
        own = Reservation(self._job, mesh, _hash_of(source), shots)
        first = self._by_mesh.setdefault(mesh, own)
        if first is own:
            self._new.append(own)
        return first.source == own.source

    def write(self) -> None:
        """Add what was reserved since the last time to the file, if parts run side by side.

        Raises  OSError (full disk); InputError
        """
        if self._shared and self._new:
            lines = Lines(self._path)
            try:
                for reservation in self._new:
                    lines.append(reservation)
            finally:
                lines.close()
        self._new.clear()


def _hash_of(source: Source) -> str:
    # a file's name may hold bytes that are no text
    return _hash(repr(source).encode(errors="surrogateescape"))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]
