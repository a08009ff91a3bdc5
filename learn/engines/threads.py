"""Slices of a kernel's work on a pool of Python threads.

The kernels run outside Python's lock, so plain threads serve: OpenMP and numba's own threading layers kill or hang a DataLoader's
forked worker, or abort under two callers. A forked child has none of its parent's threads: it starts its own pool.
"""

import itertools
import os
import threading
from concurrent.futures import ThreadPoolExecutor

_lock = threading.Lock()
_pools = {}  # number of threads → pool


def _forget():
    global _lock
    _lock = threading.Lock()
    _pools.clear()


os.register_at_fork(after_in_child=_forget)


def split(count, slices):
    """Bounds (first, last) of `slices` nearly equal parts of range(count), empty ones left out."""
    bounds = [count * i // slices for i in range(slices + 1)]
    return [(a, b) for a, b in itertools.pairwise(bounds) if a < b]


def run(function, bounds, threads):
    """function(first, last) for each pair of bounds, on up to `threads` threads, this one among them; the first exception is raised.

    Each thread takes the next slice when it is done with one: a helper that wakes late leaves the others its share, and the caller waits
    only for slices that somebody is at.
    """
    helpers = min(threads, len(bounds)) - 1
    if helpers <= 0:
        for first, last in bounds:
            function(first, last)
        return
    with _lock:
        pool = _pools.setdefault(threads, None) or ThreadPoolExecutor(threads, thread_name_prefix="brdfactory")
        _pools[threads] = pool
    following = iter(bounds).__next__  # one bytecode: two threads never get the same slice

    def work():
        try:
            while True:
                function(*following())
        except StopIteration:
            return

    others = [pool.submit(work) for _ in range(helpers)]
    work()
    for other in others:
        if not other.cancel():
            other.result()
