"""Slices of a kernel's work on a few Python threads.

The kernels run outside Python's lock, so plain threads serve: OpenMP and numba's own threading
layers kill or hang a DataLoader's forked worker, or abort under two callers. A forked child has
none of its parent's threads: it starts its own.

A run of the kernels behind `auto` takes 0.1 to 5 ms, and waking a thread 0.05: what is shorter than
`WORTHWHILE` is not shared.
"""

from __future__ import annotations

import itertools
import os
import queue
import threading
from collections.abc import Callable, Sequence

WORTHWHILE = 3e-4  # seconds of work for each further thread
_lock = threading.Lock()
_tasks: queue.SimpleQueue[_Task] = queue.SimpleQueue()
_helpers: list[threading.Thread] = []


def _forget() -> None:
    global _lock, _tasks
    _lock, _tasks = threading.Lock(), queue.SimpleQueue()
    _helpers.clear()


os.register_at_fork(after_in_child=_forget)


def split(count: int, slices: int) -> list[tuple[int, int]]:
    """Bounds (first, last) of `slices` nearly equal parts of range(count), empty ones left out."""
    bounds = [count * i // slices for i in range(slices + 1)]
    return [(a, b) for a, b in itertools.pairwise(bounds) if a < b]


def worth(threads: int, seconds: float) -> int:
    """The number of threads, `threads` at most, that work of `seconds` on one thread deserves."""
    return max(1, min(threads, int(seconds / WORTHWHILE)))


class _Task:
    """Work offered to a helper until the caller withdraws it; keeps an exception for the caller."""

    def __init__(self, work: Callable[[], None]):
        self.work, self.offered, self.done = work, threading.Lock(), threading.Lock()
        self.error: BaseException | None = None
        self.done.acquire()

    def run(self) -> None:
        if self.offered.acquire(blocking=False):
            try:
                self.work()
            except BaseException as error:
                self.error = error
            self.done.release()

    def finish(self) -> None:
        """Return at once if no helper has begun, otherwise when it has ended."""
        if not self.offered.acquire(blocking=False):
            self.done.acquire()
        if self.error:
            raise self.error


def _help(tasks: queue.SimpleQueue[_Task]) -> None:
    while True:
        tasks.get().run()


def run(
    function: Callable[[int, int], object], bounds: Sequence[tuple[int, int]], threads: int
) -> None:
    """Call function(first, last) for each pair of bounds, on up to `threads` threads.

    The calling thread is one of them. Each thread takes the next slice when it is done with one: if
    a helper wakes late, the others do its share, and the caller waits only for slices that have
    been begun. The first exception is raised.
    """
    helpers = min(threads, len(bounds)) - 1
    if helpers <= 0:
        for first, last in bounds:
            function(first, last)
        return
    with _lock:
        while len(_helpers) < helpers:
            _helpers.append(
                threading.Thread(target=_help, args=(_tasks,), name="brdfactory", daemon=True)
            )
            _helpers[-1].start()
    following = iter(bounds).__next__  # one bytecode: two threads never get the same slice

    def work():
        try:
            while True:
                function(*following())
        except StopIteration:
            return

    offers = [_Task(work) for _ in range(helpers)]
    for offer in offers:
        _tasks.put(offer)
    try:
        work()
    finally:
        for offer in offers:
            offer.finish()
