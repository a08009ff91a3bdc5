"""What a job has to know of a shape before it is rendered, remembered between runs.

Facts      name, category, hash, segments and report of a mesh: ids, splits and materials follow
           from them. To know them, the mesh must be read or made, which takes up to seconds.
memory     DIR/shape-facts/*.jsonl in the data set's folder: lines of key and facts, one file for
           each writer. Without it, or without one of its lines, the mesh is read again.
key        hash of the shape's name or path, the state of its file (size and times), and the
           version of the code that reads and makes meshes. A worker that reads a mesh compares its
           hash with the facts, so that a fact that is wrong alters no picture.
"""

import hashlib
import os
import platform
import threading
import time
from functools import cache
from importlib.metadata import version
from pathlib import Path

import msgspec

import factory.shapes
from factory.planning.shape_names import Source, load_mesh
from factory.shapes.mesh_import import split_place
from manifests.errors import InputError
from manifests.line_files import Lines, lines_of

FOLDER = "shape-facts"
# seconds: a file that changed so recently may change again within the same tick of its clock
RECENT = 2.0


class Facts(msgspec.Struct, frozen=True, kw_only=True):
    """What a job has to know of a shape; report: the line of its mesh's Report."""

    name: str
    category: str
    hash: str
    segments: int
    report: str


class _Remembered(msgspec.Struct, frozen=True):
    """A line of the memory."""

    key: str
    facts: Facts


def facts_of(source: Source) -> Facts:
    """Return the Facts of a source, whose mesh is read or made. Raises InputError; OSError."""
    mesh = load_mesh(source)
    return Facts(
        name=mesh.name,
        category=mesh.category,
        hash=mesh.hash,
        segments=mesh.segments,
        report=mesh.report.line(),
    )


class Memory:
    """The facts that earlier runs and other writers have left in a data set's folder.

    folder  the data set's folder, None: nothing is remembered
    writer  name of the file for new lines; two writers have different ones
    """

    def __init__(self, folder: str | os.PathLike | None, writer: str = "main"):
        self._path = None if folder is None else Path(folder) / FOLDER / f"{writer}.jsonl"
        self._lines: Lines | None = None
        self._lock = threading.Lock()
        self._facts = {} if self._path is None else _read(self._path.parent)

    def key(self, source: Source) -> str | None:
        """Return the key of a source as it is now, None if it cannot be remembered."""
        state = () if not source.is_file else _state(source)
        if self._path is None or state is None:
            return None
        try:
            text = msgspec.json.encode((code_version(), source, state))
        except UnicodeEncodeError:  # a file's name that is no text
            return None
        return hashlib.sha256(text).hexdigest()[:32]

    def recall(self, key: str | None) -> Facts | None:
        """Return the facts under a key, None if there are none."""
        return None if key is None else self._facts.get(key)

    def note(self, key: str | None, source: Source, facts: Facts) -> None:
        """Remember facts under the key that the source had before it was read.

        Nothing is remembered if the key is None or the file has changed meanwhile. Several threads
        may call this.

        Raises  OSError (full disk)
        """
        if self._path is None or key is None or self.key(source) != key:
            return
        with self._lock:
            self._lines = self._lines or Lines(self._path)
            self._lines.append(_Remembered(key, facts))

    def close(self) -> None:
        """Close the file."""
        if self._lines is not None:
            self._lines.close()


def _read(folder: Path) -> dict[str, Facts]:
    """Return {key: Facts} of a memory; what cannot be read is left out."""
    result: dict[str, Facts] = {}
    decoder = msgspec.json.Decoder(_Remembered)
    for path in sorted(folder.glob("*.jsonl")) if folder.is_dir() else ():
        try:
            for _, line in lines_of(path):
                try:
                    remembered = decoder.decode(line)
                except (msgspec.DecodeError, UnicodeDecodeError):
                    continue
                result[remembered.key] = remembered.facts
        except (InputError, OSError):
            continue
    return result


def _state(source: Source) -> tuple[int, ...] | None:
    """Return size, modification and change time of a source's file, None if they say nothing."""
    try:
        status = os.stat(split_place(source.place)[0])
    except (OSError, ValueError, InputError):
        return None
    # a time in the future is left by a clock that was set back, and says no less than another
    if abs(time.time() - max(status.st_mtime, status.st_ctime)) < RECENT:
        return None
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns


@cache
def code_version() -> str:
    """Return a hash of the code that reads and makes meshes, and of what it computes with."""
    digest = hashlib.sha256()
    for name in ("numpy", "scipy"):
        digest.update(f"{name} {version(name)}\n".encode())
    digest.update(f"{platform.python_version()} {platform.machine()}\n".encode())
    top = Path(factory.shapes.__path__[0])
    for path in sorted(top.rglob("*.py")):
        digest.update(f"{path.relative_to(top)}\n".encode() + path.read_bytes())
    return digest.hexdigest()
