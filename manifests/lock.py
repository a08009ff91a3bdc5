"""Locks of a data set's folder: one run may write, or any number of parts of one job array.

A lock is the kernel's (flock): it ends with the processes that hold it, however they end, so that
nothing stays locked. A run passes its lock on to its workers: while one of them still finishes its
shot after the run was killed, no other run starts.
"""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from manifests.errors import InputError


@contextmanager
def writing(
    folder: str | os.PathLike, shard: tuple[int, int] | None = None, patience: float = 20.0
) -> Iterator[list[int]]:
    """Hold the right to write; yield the descriptors to pass on to workers.

    shard     None, or (i, n): part i of n, 1 ≤ i ≤ n; parts run side by side
    patience  seconds to wait for the last worker of a killed run
    Raises    InputError if another run holds the lock

    A folder in which nothing can be written (a read-only file system, another user's) is locked as
    far as its lock files exist, which suffices for a reader.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    requested = [(".lock", fcntl.LOCK_EX if shard is None else fcntl.LOCK_SH)]
    if shard is not None:  # parts of different divisions overlap: i/n excludes i/m
        requested += [
            (f".lock-of-{shard[1]}", fcntl.LOCK_SH),
            (f".lock-{shard[0]}-of-{shard[1]}", fcntl.LOCK_EX),
        ]
        _refuse_other_divisions(folder, shard[1])
    held = []
    try:
        for name, kind in requested:
            held += _lock_file(folder / name, kind, folder, patience)
        yield held
    finally:
        for descriptor in held:
            os.close(descriptor)


@contextmanager
def changing(folder: str | os.PathLike) -> Iterator[None]:
    """Hold dataset.json while it is read, changed and written: parts of a job array take turns."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    descriptor = os.open(Path(folder) / ".lock-dataset", os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _lock_file(path, kind, folder, patience):
    """Return [descriptor of the lock], or [] if the folder is read-only and no lock file exists."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        if os.access(folder, os.W_OK):
            raise
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except OSError:
            return []
    end = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
            return [descriptor]
        except BlockingIOError:
            if time.monotonic() >= end:
                os.close(descriptor)
                remedy = "wait for it to end, or use another --out"
                raise InputError(
                    folder, "a folder that no other run writes to", "one in use", remedy
                ) from None
            time.sleep(0.1)
        except OSError:
            if os.access(folder, os.W_OK):
                os.close(descriptor)
                raise
            return [descriptor]  # a file system that locks only what can be written


def _refuse_other_divisions(folder, parts):
    for path in folder.glob(".lock-of-*"):
        if path.name == f".lock-of-{parts}":
            continue
        descriptor = os.open(path, os.O_RDWR)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            result = f"one of {path.name.removeprefix('.lock-of-')} running"
            raise InputError(
                folder,
                f"parts of {parts}, like this one",
                result,
                "divide the job the same way everywhere",
            ) from None
        finally:
            os.close(descriptor)
