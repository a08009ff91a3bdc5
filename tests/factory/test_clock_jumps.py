"""Runs whose wall clock jumps by hours, by a library that shifts it for their processes alone."""

import os
import shutil
import subprocess
import sys
import time

import msgspec
import pytest

from factory.execution import leases
from manifests import object_store
from manifests.store import Store
from manifests.verification import faults_of
from tests.support.jumping_clock import COMPILER, JumpingClock
from tests.support.tetrahedron import ROOT, lines

pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")

SHOWN = "import time; print(time.time(), time.monotonic(), flush=True); input(); time.sleep(0.1); "
SHOWN += "print(time.time(), time.monotonic(), flush=True)"


def test_the_wall_clock_jumps_and_the_monotonic_clock_does_not(tmp_path):
    clock = JumpingClock(tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", SHOWN],
        env=os.environ | clock.environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        wall, monotonic = map(float, process.stdout.readline().split())
        assert abs(wall - time.time()) < 60
        clock.jump(-36_000.5)
        later, after = map(float, process.communicate("\n")[0].split())
    assert 0.1 <= after - monotonic < 60
    assert later - wall == pytest.approx(after - monotonic - 36_000.5, abs=0.1)


def test_a_run_whose_clock_jumps_makes_what_another_does(small_job, catalogue, render, tmp_path):
    clock, folder = JumpingClock(tmp_path), tmp_path / "jumping"
    job = msgspec.structs.replace(small_job, views=tuple(range(8)))
    shutil.copy(job.lights[0], tmp_path / "lamp.exr")
    here = msgspec.structs.replace(job, lights=("lamp.exr",))
    (tmp_path / "job.json").write_bytes(msgspec.json.encode(here))
    words = [sys.executable, "-m", "tests.support.fake_command", "render", tmp_path / "job.json"]
    words += ["--catalogue", catalogue, "--workers", "2", "--out", folder]
    environment = {"PYTHONPATH": str(ROOT), "FAKE_STUDIO": "slow", **clock.environment}
    with subprocess.Popen(
        words, env=os.environ | environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        hours = 1
        while process.poll() is None:
            clock.jump(3600 * hours)
            hours = -hours - 1 if hours > 0 else -hours + 1
            time.sleep(0.05)
        said = process.stderr.read().decode()
    assert process.returncode == 0, said
    assert hours > 4 or hours < -4  # it did jump
    render(job, tmp_path / "whole")
    assert lines(folder, "records") == lines(tmp_path / "whole", "records")
    assert faults_of(Store(folder)) == []


def test_a_lease_is_held_against_a_run_whose_clock_is_hours_behind(tmp_path, monkeypatch):
    pytest.importorskip("fsspec", reason="fsspec is not installed (extra stores)")
    monkeypatch.setattr(leases, "RENEWED", 0.05)
    clock, url = JumpingClock(tmp_path), f"file://{tmp_path}/data"
    first = leases.Lease(object_store.ObjectFolder(url), None, str)
    clock.jump(-36_000.0)
    program = (
        "from factory.execution import leases; from manifests import object_store;"
        "leases.PAUSE = 0.05; leases.EXPIRED = 20;"
        f"leases.Lease(object_store.ObjectFolder('{url}'), None, str)"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | clock.environment
    second = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True
    )
    first.release()
    assert "found one in use" in second.stderr
