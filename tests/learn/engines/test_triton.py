"""Runs interpreted_triton.py in a process where triton interprets its kernels on the CPU."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


def test_the_cuda_kernels_equal_the_cpu_engine(root):
    pytest.importorskip("triton", reason="triton is not installed (extra cuda)")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(Path(__file__).with_name("interpreted_triton.py"))]
    done = subprocess.run(command, env=os.environ | {"TRITON_INTERPRET": "1"}, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "skipped" not in done.stdout, done.stdout
