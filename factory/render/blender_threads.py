"""Blender on few threads, in which no other thread waits for work.

Blender starts a thread for each further core. Once Cycles has been limited to one thread, one of
them gives its turn away again and again for as long as the process lives (TBB's worker, in
`sched_yield`). It takes a whole core that is idle, and where none is idle some of the others' time
(docs/log/rendering.md, "A thread that waits"). A process that has as few cores as threads when
Blender is imported starts no such threads, and keeps it so with all cores.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence


@contextlib.contextmanager
def importing_blender(threads: int | None) -> Iterator[None]:
    """Let Blender be imported for the first time inside the block, for so many threads.

    Does nothing where Blender has been imported before, and where processes have no affinity to
    cores (macOS and Windows).

    threads  that Blender is given; None: all
    """
    if threads is None or "bpy" in sys.modules or not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores_of(os.getpid(), sorted(cores), threads))
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def cores_of(process: int, cores: Sequence[int], threads: int) -> set[int]:
    """Return so many of the cores, others for the next process: workers are started together."""
    first = process * threads
    return {cores[(first + k) % len(cores)] for k in range(threads)}
