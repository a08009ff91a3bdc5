"""Rendering on a Ray cluster: each shot once, whatever is killed; with a studio without Blender."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from factory.execution.ray_pool import RayPool, _Lost, _Worker
from factory.execution.ray_worker import RayWorker, lines_path
from factory.execution.registration import register_job
from factory.execution.run import (
    RunOptions,
    carry_out,
    make_assignment,
    make_plan,
    shape_sources,
    worker_config,
)
from factory.execution.worker import Chunk, Reply
from factory.planning.assets import resolve_unread
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.ray_cluster import MOST_LOSSES, _require_answer, connected
from manifests.store import Store
from manifests.verification import faults_of
from tests.support.tetrahedron import FAKE, ROOT, TETRAHEDRON

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


@pytest.fixture
def pool(plan_of, small_job, tmp_path):
    """A RayPool whose cluster is not asked, its shots, and a function that loses a worker of it."""
    plan = plan_of(small_job)
    store = Store(tmp_path / "data")
    notes = []

    def config(number):
        return worker_config(store, f"worker-ray-{number:02d}", make_assignment(plan), RunOptions())

    made = RayPool(config, shape_sources(plan.assets.shapes), 1, notes.append)
    shots = list(plan)

    def lose(number, pending, there):
        path = lines_path(config(number))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"".join(b'{"id":"%s"}\n' % shot.id.encode() for shot in there))
        made._lost.append(_Lost(config(number), pending, time.monotonic()))
        return path

    yield made, shots, lose
    for fence in made._fences:
        fence.close()


def test_what_a_lost_worker_had_recorded_counts_and_the_rest_is_given_out_again(pool):
    made, shots, lose = pool
    path = lose(0, shots[:4], there=shots[:2])
    partial = path.parents[1] / "partial"
    partial.mkdir()
    for name in ("worker-ray-00-x.exr", "worker-ray-01-x.exr"):
        (partial / name).write_bytes(b"half")
    yielded = list(made._give_out_lost_shots())
    assert [each.name for each in partial.iterdir()] == ["worker-ray-01-x.exr"]
    assert [shot.id for shot, _ in yielded] == [shot.id for shot in shots[:2]]
    assert all(reply.made == shot.id for shot, reply in yielded)
    assert [shot.id for shot in made._next_unit(iter(()))] == [shot.id for shot in shots[2:4]]
    assert not made._lost


def test_a_lost_worker_that_still_writes_is_waited_for_and_then_kept_out(pool):
    made, shots, lose = pool
    path = lose(0, shots[:4], there=[])
    other = holder(path)
    other.stdout.readline()
    assert list(made._give_out_lost_shots()) == [] and made._lost and not made._units
    other.stdin.close()
    other.wait()
    other.stdout.close()
    assert list(made._give_out_lost_shots()) == [] and not made._lost and len(made._units[0]) == 4
    late = holder(path)  # ends with an error instead of a line
    assert late.stdout.readline() == b"" and late.wait() != 0
    late.stdin.close()
    late.stdout.close()


def test_a_shot_whose_worker_is_lost_again_and_again_is_given_up(pool):
    made, shots, lose = pool
    for number in range(MOST_LOSSES):
        lose(number, shots[:2], there=[])
        given_up = list(made._give_out_lost_shots())
        last = made._units.popleft()
    ((shot, reply),) = given_up
    assert shot.id == shots[0].id and reply.bad and "lost 5 times" in reply.reason
    assert [shot.id for shot in last] == [shots[1].id]


def test_a_unit_is_a_shape_and_an_idle_worker_takes_half_of_another_s(pool):
    made, shots, _ = pool
    stream = iter([*shots, None])
    units = [made._next_unit(stream), made._next_unit(stream)]
    assert [{shot.shape for shot in unit} for unit in units] == [{"cube"}, {"disc"}]
    assert [len(unit) for unit in units] == [6, 6]
    assert not made._next_unit(stream) and made._waiting and not made._ended
    made._waiting = False  # asked again later
    assert not made._next_unit(stream) and made._ended
    made._workers = [_Worker(None, None, None, [], unit=deque(shots[:6]))]
    half = made._half_of_another()
    assert [shot.id for shot in half] == [shot.id for shot in shots[3:6]]
    assert len(made._workers[0].unit) == 3
    made._workers.clear()


def test_a_shot_that_fails_is_tried_once_more_and_the_rest_of_its_slice_goes_on(pool):
    made, shots, _ = pool
    worker = _Worker(None, None, None, list(shots[:3]), unit=deque(shots[3:5]))
    replies = [Reply(made=shots[0].id), Reply(bad=shots[1].id, reason="no")]
    lines = [msgspec.json.encode(reply) for reply in replies]
    assert [shot.id for shot, _ in made._receive(worker, lines)] == [shots[0].id]
    assert [shot.id for shot in worker.unit] == [shot.id for shot in shots[2:5]]
    assert [shot.id for shot in made._retries] == [shots[1].id]
    worker.pending = [made._retries.popleft()]
    ((shot, reply),) = made._receive(worker, lines[1:])
    assert shot.id == shots[1].id and reply.bad


def test_an_actor_s_process_that_dies_answers_for_the_shot_in_hand(
    plan_of, small_job, tmp_path, monkeypatch
):
    """The second shape's pictures kill the process; before that, all goes well."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("FAKE_STUDIO", "crash:disc")
    plan = plan_of(small_job)
    store, shots = Store(tmp_path), list(plan)
    register_job(store, plan, len(plan))
    options = RunOptions(studio=FAKE, ray="auto")
    actor = RayWorker(
        msgspec.json.encode(worker_config(store, "w", make_assignment(plan), options))
    )
    chunk = Chunk(shots[4:8], shape_sources(plan.assets.shapes))
    replies = [
        msgspec.json.decode(line, type=Reply) for line in actor.make(msgspec.json.encode(chunk))
    ]
    assert [reply.made for reply in replies] == [shots[4].id, shots[5].id, ""]
    assert replies[2].bad == shots[6].id and "by signal 11" in replies[2].reason
    monkeypatch.setenv("FAKE_STUDIO", "")
    replies = actor.make(msgspec.json.encode(Chunk(shots[6:8], chunk.shapes)), is_retry=True)
    assert len(replies) == 2 and len(lines(tmp_path)) == 4
    actor._end()
    actor._errors.close()


def test_an_actor_s_chunk_ends_with_a_shot_that_fails(plan_of, small_job, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("FAKE_STUDIO", "nan:disc")
    plan = plan_of(small_job)
    store, shots = Store(tmp_path), list(plan)
    register_job(store, plan, len(plan))
    options = RunOptions(studio=FAKE, ray="auto")
    actor = RayWorker(
        msgspec.json.encode(worker_config(store, "w", make_assignment(plan), options))
    )
    chunk = msgspec.json.encode(Chunk(shots[5:9], shape_sources(plan.assets.shapes)))
    first, second = (msgspec.json.decode(line, type=Reply) for line in actor.make(chunk))
    assert first.made == shots[5].id
    assert second.bad == shots[6].id and "finite radiance" in second.reason
    actor._end()
    actor._errors.close()


def holder(path):
    """A process that holds a file of records until its input ends."""
    hold = (
        "import sys; from manifests.line_files import Lines;"
        " x = Lines(sys.argv[1]); print(flush=True)"
    )
    return subprocess.Popen(
        [sys.executable, "-c", f"{hold}; sys.stdin.read()", path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=ROOT,
    )


def test_without_ray_or_an_answer_the_command_says_what_to_do(
    plan_of, small_job, tmp_path, monkeypatch, capsys
):
    from brdfactory.command_line import run

    words = ["render", "smallest", "--out", str(tmp_path / "a"), "--ray", "auto"]
    for more in (["--shard", "1/2"], ["--workers", "2"]):
        assert run([*words, *more]) == 1
        assert "expected neither --shard nor --workers" in capsys.readouterr().err
    for address, problem in (
        ("127.0.0.1:1", "expected a Ray cluster at '127.0.0.1:1'"),
        ("here", "expected auto or HOST:PORT, found 'here'"),
        ("here:99999", "expected auto or HOST:PORT"),
    ):
        with pytest.raises(InputError, match=problem):
            _require_answer(address)
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(InputError, match="expected the package ray"):
        carry_out(plan_of(small_job), tmp_path / "b", RunOptions(studio=FAKE, ray="auto"))


@pytest.mark.parametrize("is_there", [True, False])
def test_a_cluster_that_was_killed_is_not_waited_for(tmp_path, monkeypatch, is_there):
    begun = []
    stand_in = SimpleNamespace(
        is_initialized=lambda: False,
        init=lambda address, **_: begun.append(address),
        shutdown=lambda: None,
        exceptions=SimpleNamespace(RayError=RuntimeError),
    )
    monkeypatch.setitem(sys.modules, "ray", stand_in)
    monkeypatch.setitem(sys.modules, "ray.exceptions", stand_in.exceptions)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    (tmp_path / "ray").mkdir()
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        if not is_there:
            server.close()
        (tmp_path / "ray" / "ray_current_cluster").write_text(address)
        with connected("auto"):
            assert begun == ["auto" if is_there else "local"]


def test_a_run_waits_for_a_worker_on_another_machine(render, small_job, tmp_path):
    render(small_job, tmp_path)
    path = Store(tmp_path).record_files()[0]
    hold = (
        "import sys; from manifests.line_files import Lines;"
        " x = Lines(sys.argv[1]); print(flush=True)"
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
    hold = "import sys; from manifests.line_files import Lines; Lines(sys.argv[1])"
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


def test_workers_in_another_folder_find_meshes_and_lights_of_relative_paths(
    small_job, catalogue, light_file, tmp_path, monkeypatch
):
    """A cluster's workers run where it was started, and not where `render` is typed."""
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here / "lights", there):
        folder.mkdir(parents=True)
    (here / "a.ply").write_bytes(TETRAHEDRON)
    (here / "lamp.exr").write_bytes(light_file.read_bytes())
    (here / "lights" / "own.exr").write_bytes(light_file.read_bytes())
    monkeypatch.chdir(here)

    class Pool:
        def __init__(self, config, shapes, threads, note):
            self.worker, self.shapes = RayWorker(msgspec.json.encode(config(0))), shapes

        def run(self, shots):
            for shot in shots:
                if shot is not None:
                    chunk = Chunk([shot], {shot.shape: self.shapes[shot.shape]})
                    with contextlib.chdir(there):
                        (reply,) = self.worker.make(msgspec.json.encode(chunk))
                    yield shot, msgspec.json.decode(reply, type=Reply)
            self.worker._end()
            self.worker._errors.close()

    monkeypatch.setattr("factory.execution.ray_pool.RayPool", Pool)
    monkeypatch.setattr("manifests.ray_cluster.connected", lambda address: contextlib.nullcontext())
    job = msgspec.structs.replace(
        small_job, shapes=("a.ply?up=+y", "cube"), lights=("lamp.exr", "own"), views=(0,)
    )
    plan = make_plan(job, resolve_unread(job, None, "lights", [catalogue]))
    outcome = carry_out(plan, "data", RunOptions(studio=FAKE, ray="auto", library="lights"))
    assert outcome.failed == 0 and outcome.made == len(list(Store(here / "data").records())) > 0
