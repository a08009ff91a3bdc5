"""Output of C libraries kept off the terminal.

C libraries bypass sys.stdout, so the file descriptors themselves are redirected.
"""

import contextlib
import ctypes
import functools
import os
import sys
import threading
from collections.abc import Iterator

# two threads that redirect one descriptor would restore each other's redirection
_REDIRECTING = {1: threading.Lock(), 2: threading.Lock()}


@functools.cache
def _c():
    return ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt


def _flush():
    """Write what Python and C have buffered to where it belongs."""
    sys.stdout.flush()
    _c().fflush(None)


@contextlib.contextmanager
def silenced(*descriptors: int) -> Iterator[None]:
    """Drop all that is written to file descriptors (1: stdout, 2: stderr) inside the block."""
    for descriptor in descriptors:
        _REDIRECTING[descriptor].acquire()
    _flush()
    originals = [os.dup(descriptor) for descriptor in descriptors]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for descriptor in descriptors:
            os.dup2(nowhere, descriptor)
        yield
    finally:
        _flush()
        for descriptor, copy in zip(descriptors, originals, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(nowhere)
        for descriptor in descriptors:
            _REDIRECTING[descriptor].release()
