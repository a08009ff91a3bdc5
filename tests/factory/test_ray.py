"""Rendering on a Ray cluster: each shot once, whatever is killed; with a studio without Blender."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import msgspec
import pytest

from factory.execution.run import RunOptions, carry_out
from manifests.errors import InputError
from manifests.store import Lines, Store
from manifests.verification import faults_of
from tests.support.tetrahedron import FAKE, ROOT

REASON = "ray is not installed (extra ray)"


@pytest.fixture
def cluster(monkeypatch):
    """A head without CPUs and two nodes of one CPU each on this machine; this process uses it."""
    ray = pytest.importorskip("ray", reason=REASON)
    from tests.support.ray_cluster import started

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("FAKE_STUDIO", os.environ.get("FAKE_STUDIO", "slow"))
    with started(ray, nodes=2) as (made, nodes):
        yield made, nodes


@pytest.fixture
def larger_job(small_job):
    """Two shapes, 144 shots of 20 ms."""
    return msgspec.structs.replace(small_job, views=tuple(range(24)))


def lines(folder):
    """{id: record without its seconds} of a folder; each id is there once."""
    records = list(Store(folder).records())
    result = {r.id: msgspec.structs.replace(r, seconds=0.0) for r in records}
    assert len(result) == len(records)
    return result


@pytest.mark.long
def test_a_cluster_makes_what_one_machine_makes_though_a_node_is_killed(
    cluster, plan_of, larger_job, tmp_path, render
):
    made, nodes = cluster
    plan = plan_of(larger_job)
    undisturbed = render(larger_job, tmp_path / "alone")
    counts = {"made": 0}

    def watch(event, value):
        if event == "made":
            counts["made"] += 1
            if counts["made"] == 10:
                made.remove_node(nodes[0], allow_graceful=False)

    outcome = carry_out(plan, tmp_path / "data", RunOptions(studio=FAKE, ray="auto"), watch)
    assert (outcome.made, outcome.failed) == (undisturbed.made, 0) == (len(plan), 0)
    assert lines(tmp_path / "data") == lines(tmp_path / "alone")
    assert [fault.text for fault in faults_of(Store(tmp_path / "data"))] == []
    again = carry_out(plan, tmp_path / "data", RunOptions(studio=FAKE, ray="auto"))
    assert (again.made, again.already_there) == (0, len(plan))


@pytest.mark.long
def test_a_killed_worker_process_and_a_stopped_run_lose_nothing(
    cluster, plan_of, larger_job, tmp_path
):
    plan = plan_of(larger_job)
    counts = {"made": 0}

    def watch(event, value):
        if event != "made":
            return
        counts["made"] += 1
        if counts["made"] == 5:
            for process in workers_of(tmp_path / "data")[:1]:
                os.kill(process, signal.SIGKILL)
        if counts["made"] == 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        carry_out(plan, tmp_path / "data", RunOptions(studio=FAKE, ray="auto"), watch)
    there = len(lines(tmp_path / "data"))
    assert 40 <= there < len(plan)
    outcome = carry_out(plan, tmp_path / "data", RunOptions(studio=FAKE, ray="auto"))
    assert (outcome.made, outcome.already_there) == (len(plan) - there, there)
    assert set(lines(tmp_path / "data")) == {shot.id for shot in plan}
    assert [fault.text for fault in faults_of(Store(tmp_path / "data"))] == []


def workers_of(folder):
    """Ids of the processes that have a file of records of the folder open."""
    result = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            open_files = [os.readlink(each) for each in (path / "fd").iterdir()]
        except OSError:
            continue
        if any(each.startswith(f"{folder}/records/worker-ray") for each in open_files):
            result.append(int(path.name))
    return result


def test_without_ray_or_an_answer_the_command_says_what_to_do(
    plan_of, small_job, tmp_path, monkeypatch, capsys
):
    from brdfactory.command_line import run

    words = ["render", "smallest", "--out", str(tmp_path / "a"), "--ray", "auto"]
    for more in (["--shard", "1/2"], ["--workers", "2"]):
        assert run([*words, *more]) == 1
        assert "expected neither --shard nor --workers" in capsys.readouterr().err
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(InputError, match="expected the package ray"):
        carry_out(plan_of(small_job), tmp_path / "b", RunOptions(studio=FAKE, ray="auto"))


def test_a_run_waits_for_a_worker_on_another_machine(render, small_job, tmp_path):
    render(small_job, tmp_path)
    path = Store(tmp_path).record_files()[0]
    hold = (
        "import sys; from manifests.store import Lines; x = Lines(sys.argv[1]); print(flush=True)"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", f"{hold}; sys.stdin.read()", path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=ROOT,
    )
    other.stdout.readline()
    with pytest.raises(InputError, match="no other run writes to"):
        Store(tmp_path).sweep(patience=0.3)
    threading.Timer(0.5, other.stdin.close).start()
    Store(tmp_path).sweep(patience=20.0)
    other.wait()
    other.stdout.close()


def test_a_lock_that_is_held_lasts_while_its_lines_are_read(render, small_job, tmp_path):
    render(small_job, tmp_path)
    path = Store(tmp_path).record_files()[0]
    mine = Lines(path)
    assert mine.read() == path.read_bytes()
    mine.close()
    with Path(path).open("ab") as file:
        file.write(b'{"id"')  # torn: cut off when the file is opened
    mine = Lines(path)
    assert mine.read().endswith(b"\n") and mine.read().count(b"\n") == 12
    hold = "import sys; from manifests.store import Lines; Lines(sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-c", hold, path], cwd=ROOT, capture_output=True, check=False
    )
    assert b"no other run writes to" in done.stderr
    mine.close()


def test_a_worker_whose_parent_is_gone_begins_no_shot(plan_of, small_job, tmp_path, monkeypatch):
    from factory.execution.worker import PARENT

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv(PARENT, "1")
    begun = time.monotonic()
    with pytest.raises(OSError, match="workers in a row made nothing"):
        carry_out(plan_of(small_job), tmp_path, RunOptions(studio=FAKE))
    assert not list(Store(tmp_path).records()) and time.monotonic() - begun < 300
