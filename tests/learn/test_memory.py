"""Freed memory is kept."""

import subprocess
import sys

import pytest

TAKES_AND_FREES = """
import resource, numpy as np
from learn.training.allocator import keep_freed
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
