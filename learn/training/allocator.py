"""An allocator that reuses freed memory for the next step instead of returning it to the system.

By default glibc returns each block above 32 MB at once, and the system clears every page of the
next one. A compact network's step at 256² (sixteen pictures) meets up to 130,000 such pages. They
take a sixth of its time in a virtual machine where pages are costly; at 128² blocks are smaller and
nothing changes (docs/log.md, 2026-11-21).
"""

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4  # numbers of malloc.h
LARGEST_INT = 2**31 - 1


def keep_freed() -> bool:
    """Ask glibc to keep all memory that this process frees; return whether it will.

    On systems without glibc nothing changes.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    return (
        mallopt is not None
        and bool(mallopt(M_MMAP_MAX, 0))
        and bool(mallopt(M_TRIM_THRESHOLD, LARGEST_INT))
    )
