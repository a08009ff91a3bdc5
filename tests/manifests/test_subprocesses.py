"""Processes of a pool end when the process that started them was killed."""

import os
import signal
import subprocess
import sys
import time

import pytest

from manifests.subprocesses import environment

OWNER = """
import concurrent.futures, multiprocessing, os, time
from manifests.subprocesses import end_with_parent

if __name__ == "__main__":
    context = multiprocessing.get_context("METHOD")
    with concurrent.futures.ProcessPoolExecutor(1, context, end_with_parent) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(60)
"""
PATIENCE = 20.0  # seconds


def lives(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="processes are looked up in /proc")
@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_a_worker_ends_when_the_owner_of_its_pool_is_killed(tmp_path, method):
    script = tmp_path / "owner.py"
    script.write_text(OWNER.replace("METHOD", method))
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, env=environment()
    ) as owner:
        worker = int(owner.stdout.readline())
        assert lives(worker)
        owner.send_signal(signal.SIGKILL)
    end = time.monotonic() + PATIENCE
    while lives(worker) and time.monotonic() < end:
        time.sleep(0.05)
    left = lives(worker)
    if left:
        os.kill(worker, signal.SIGKILL)
    assert not left
