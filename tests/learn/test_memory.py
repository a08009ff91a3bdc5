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


def printed(program, root):
    """The number that a program prints, in a process of its own."""
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, cwd=root, capture_output=True, text=True)
    if done.returncode == 3:
        pytest.skip("this system's allocator takes no advice")
    return int(done.stdout)


def test_large_blocks_taken_again_cost_no_page_faults_once_freed_memory_is_kept(request):
    root = request.config.rootpath
    faults = {keep: printed(TAKES_AND_FREES.format(keep=keep), root) for keep in (True, False)}
    assert faults[True] * 10 < faults[False]


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


def test_large_blocks_leave_no_holes_between_small_ones_once_they_are_returned(request):
    root = request.config.rootpath
    # megabytes that a process keeps after it has freed large blocks among small ones
    assert printed(HOLES.format(returned=False), root) > 100
    assert printed(HOLES.format(returned=True), root) < 20
