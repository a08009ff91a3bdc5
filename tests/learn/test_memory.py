"""Freed memory is kept for training, and returned by whoever renders."""

import subprocess
import sys

import pytest

TAKES_AND_FREES = """
import resource, numpy as np
from manifests.allocator import keep_freed
if {keep} and not keep_freed():
    raise SystemExit(3)
for turn in range(4):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for size in (40, 50, 60):
        np.ones(size * 2**20, np.uint8)
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
print(faults)
"""


def page_faults(keep, root):
    done = subprocess.run(
        [sys.executable, "-c", TAKES_AND_FREES.format(keep=keep)],
        cwd=root,
        capture_output=True,
        text=True,
    )
    if done.returncode == 3:
        pytest.skip("this system's allocator takes no advice")
    return int(done.stdout)


def test_large_blocks_taken_again_cost_no_page_faults_once_freed_memory_is_kept(request):
    root = request.config.rootpath
    assert page_faults(True, root) * 10 < page_faults(False, root)


HOLES = """
import os, numpy as np
from manifests.allocator import return_large_blocks
if {returned} and not return_large_blocks():
    raise SystemExit(3)

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") >> 20

np.ones(30 << 20, np.uint8)  # freed at once, which raises glibc's threshold
before, kept = resident(), []
large = []
for _ in range(20):
    large.append(np.ones(8 << 20, np.uint8))
    kept.append(np.ones(100_000, np.uint8))  # above each large block
large.clear()
print(resident() - before)
"""


def left_over(returned, root):
    """Megabytes that a process keeps after it has freed large blocks among small ones."""
    done = subprocess.run(
        [sys.executable, "-c", HOLES.format(returned=returned)],
        cwd=root,
        capture_output=True,
        text=True,
    )
    if done.returncode == 3:
        pytest.skip("this system's allocator takes no advice")
    return int(done.stdout)


def test_large_blocks_leave_no_holes_between_small_ones_once_they_are_returned(request):
    root = request.config.rootpath
    assert left_over(False, root) > 100
    assert left_over(True, root) < 20
