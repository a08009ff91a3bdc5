"""Freed memory kept for the next step instead of handed back to the system.

A training step frees and takes hundreds of megabytes. By default glibc returns each large block at once, and the system clears every page
of the next one: a third of a step where pages are dear, as in many virtual machines (docs/log.md, 2026-11-21).
"""

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4  # numbers of malloc.h
LARGEST_INT = 2**31 - 1


def keep_freed():
    """Ask glibc to keep what this process frees, large blocks too; True if it will. Elsewhere nothing changes."""
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    return mallopt is not None and bool(mallopt(M_MMAP_MAX, 0)) and bool(mallopt(M_TRIM_THRESHOLD, LARGEST_INT))
