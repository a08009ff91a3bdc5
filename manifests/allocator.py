"""What glibc does with freed memory: keep it for the next step, or return it to the system.

By default glibc takes blocks above a threshold from the system and returns them when they are
freed. The threshold begins at 128 KB and rises with each such block, up to 32 MB. Both ends are
costly for somebody:

training   takes the same large blocks in each step, and the system clears every page of them. A
           compact network's step at 256² (sixteen pictures) meets up to 130,000 such pages. They
           take a sixth of its time in a virtual machine where pages are costly; at 128² blocks are
           smaller and nothing changes (docs/log.md, 2026-11-21)
rendering  takes other blocks for each mesh. Once the threshold has risen they come from the heap,
           where holes remain: after 42 meshes a worker had 90 MB more than the last one needed.
           A fixed threshold of 4 MB leaves none, at the same speed; at 1 MB pictures of 64² took a
           fifth longer (docs/log.md, 2026-11-24)

On systems without glibc nothing changes.
"""

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_MMAP_MAX = -1, -3, -4  # numbers of malloc.h
LARGEST_INT = 2**31 - 1
LARGE = 4 << 20  # bytes


def keep_freed() -> bool:
    """Ask glibc to keep all memory that this process frees; return whether it will."""
    return _set(M_MMAP_MAX, 0) and _set(M_TRIM_THRESHOLD, LARGEST_INT)


def return_large_blocks() -> bool:
    """Ask glibc to return each block above LARGE when it is freed; return whether it will."""
    return _set(M_MMAP_THRESHOLD, LARGE)


def _set(parameter: int, value: int) -> bool:
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    return mallopt is not None and bool(mallopt(parameter, value))
