"""Runs that stop, continue, share their work and meet bad shots; with a studio that needs no
Blender.
"""

import glob
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from factory.commands.render import outcome_line
from factory.execution.forecast import probe
from factory.execution.run import RunOptions
from manifests import lock
from manifests.errors import InputError
from manifests.store import Store
from manifests.verification import faults_of
from tests.support.mesh_files import Glb, obj_text
from tests.support.tetrahedron import FAKE, ROOT

SLOW = {"FAKE_STUDIO": "slow", "PYTHONPATH": str(ROOT)}


def faults(folder):
    store = Store(folder)
    return [f.text for f in faults_of(store)]


def ids(folder):
    return [record.id for record in Store(folder).records()]


def test_a_run_makes_every_shot_once_and_its_folder_verifies(render, small_job, tmp_path):
    outcome = render(small_job, tmp_path)
    assert (outcome.made, outcome.failed, outcome.already_there) == (12, 0, 0)
    assert len(ids(tmp_path)) == len(set(ids(tmp_path))) == 12
    assert faults(tmp_path) == []


def test_a_folder_whose_name_is_no_text_is_refused_before_a_worker_starts(
    render, small_job, tmp_path
):
    with pytest.raises(
        InputError, match=r"out\\udcff': expected a name of a file or a folder in UTF-8"
    ):
        render(small_job, tmp_path / "out\udcff")


@pytest.mark.parametrize(
    "name", ["materials.json", "partial/thesis.txt", "records/mine.jsonl", "dataset.json"]
)
def test_files_of_something_else_are_not_overwritten(name, render, small_job, tmp_path):
    mine = tmp_path / "project" / name
    mine.parent.mkdir(parents=True)
    mine.write_text("mine, without a line break at its end")
    with pytest.raises(InputError, match=r"project.*give another --out|dataset\.json"):
        render(small_job, tmp_path / "project")
    assert mine.read_text() == "mine, without a line break at its end"
    assert [path for path in (tmp_path / "project").rglob("*") if path.is_file()] == [mine]


def test_other_files_of_a_folder_stay_and_one_line_says_so(render, small_job, tmp_path):
    for name in ("notes.txt", "photograph.jpg"):
        (tmp_path / name).write_text("mine")
    notes = []

    def watch(event, value):
        if event == "note":
            notes.append(value)

    assert render(small_job, tmp_path, watch=watch).made == 12
    assert render(small_job, tmp_path, watch=watch).made == 0
    assert notes == [f"{tmp_path}: notes.txt and 1 other in this folder will stay as they are"]
    assert {path.read_text() for path in tmp_path.glob("*.*g")} == {"mine"}


@pytest.mark.parametrize("kind", ["obj", "glb"])
def test_a_line_says_once_that_the_materials_of_files_are_replaced(
    kind, render, stream, small_job, tmp_path
):
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    for number in (1, 2):
        corners = np.float32([[0, 0, 0], [number, 0, 0], [0, 1, 0], [0, 0, 1]])
        if kind == "obj":
            data = f"mtllib oak.mtl\nusemtl oak\n{obj_text(corners, faces)}".encode()
        else:
            made = Glb()
            places, indices = made.accessor(corners), made.accessor(np.uint16(faces).ravel())
            made.node(mesh=made.mesh({"attributes": {"POSITION": places}, "indices": indices}))
            data = made.bytes(materials=[{"name": "oak"}, {}])
        (tmp_path / f"{number}.{kind}").write_bytes(data)
    shapes = tuple(str(tmp_path / f"{number}.{kind}") for number in (1, 2))
    job = msgspec.structs.replace(small_job, shapes=shapes)
    for run in (render, stream):
        notes = []

        def watch(event, value, notes=notes):
            if event == "note":
                notes.append(value)

        run(job, tmp_path / run.__qualname__.split(".")[0], watch=watch)
        assert len(notes) == 1
        assert re.fullmatch(
            "[12]( and 1 other shape)? ha(s|ve) materials of (its|their) own, which are not read;"
            " those of the job replace them",
            notes[0],
        )
    notes.clear()
    plain = msgspec.structs.replace(small_job, shapes=("cube",))
    render(plain, tmp_path / "plain", watch=watch)
    assert notes == []


def test_a_second_run_makes_nothing_and_a_larger_job_adds_only_what_is_new(
    render, small_job, tmp_path
):
    render(small_job, tmp_path)
    assert render(small_job, tmp_path).made == 0
    outcome = render(msgspec.structs.replace(small_job, views=(0, 6, 12)), tmp_path)
    assert (outcome.made, outcome.already_there) == (6, 12)
    assert len(Store(tmp_path).dataset().orders) == 2
    assert faults(tmp_path) == []


def test_limit_stops_early_and_the_same_command_goes_on(render, small_job, tmp_path):
    assert render(small_job, tmp_path, limit=5).made == 5
    assert render(small_job, tmp_path, limit=5).made == 5
    assert render(small_job, tmp_path).made == 2
    assert faults(tmp_path) == []


def test_shards_divide_the_shots_without_gap_or_overlap(render, small_job, tmp_path):
    outcomes = [render(small_job, tmp_path, shard=(i, 5)) for i in range(1, 6)]
    made = [outcome.made for outcome in outcomes]
    assert sum(made) == 12 and max(made) - min(made) <= 1
    assert not any(outcome.already_there for outcome in outcomes)
    assert len(set(ids(tmp_path))) == 12
    assert render(small_job, tmp_path).already_there == 12
    assert faults(tmp_path) == []


def test_two_workers_write_two_files_and_one_dataset(render, small_job, tmp_path, monkeypatch):
    monkeypatch.setattr("factory.execution.pool.CHUNK", 2)
    monkeypatch.setenv("FAKE_STUDIO", "slow")
    render(small_job, tmp_path, workers=2)
    assert len(Store(tmp_path).record_files()) == 2
    assert len(set(ids(tmp_path))) == 12
    assert faults(tmp_path) == []


def test_a_shot_that_stays_bad_goes_to_failures_and_the_others_are_made(
    render, small_job, tmp_path, monkeypatch
):
    monkeypatch.setenv("FAKE_STUDIO", "nan:disc")
    outcome = render(small_job, tmp_path)
    assert (outcome.made, outcome.failed) == (6, 6)
    failures = list(Store(tmp_path).failures())
    assert {f.shape for f in failures} == {"disc"}
    assert all("finite radiance" in f.reason for f in failures)
    monkeypatch.setenv("FAKE_STUDIO", "")
    assert render(small_job, tmp_path).made == 6  # failures are tried again
    assert faults(tmp_path) == []


@pytest.mark.parametrize("shard", [None, (2, 3)])
def test_the_last_line_of_a_run_names_the_file_of_its_failures(
    render, small_job, tmp_path, monkeypatch, shard
):
    monkeypatch.setenv("FAKE_STUDIO", "nan:disc")
    outcome = render(small_job, tmp_path, shard=shard)
    line = outcome_line(outcome, str(tmp_path))
    (file,) = tmp_path.glob("failures*")
    named = re.search(r"FAILED, see (.*?);", line)[1]
    assert glob.glob(named) == [str(file)]


def test_a_crashing_worker_is_replaced_and_its_shot_tried_again(
    render, small_job, tmp_path, monkeypatch
):
    monkeypatch.setenv("FAKE_STUDIO", "once:disc")
    monkeypatch.setenv("FAKE_STUDIO_MARK", str(tmp_path / "mark"))
    outcome = render(small_job, tmp_path / "data")
    assert (outcome.made, outcome.failed) == (12, 0)
    assert faults(tmp_path / "data") == []


def test_a_shot_that_always_crashes_is_given_up_with_the_signal_named(
    render, small_job, tmp_path, monkeypatch
):
    monkeypatch.setenv("FAKE_STUDIO", "crash:disc")
    job = msgspec.structs.replace(small_job, materials=("small/matte",), views=(0,))
    outcome = render(job, tmp_path)
    assert (outcome.made, outcome.failed) == (1, 1)
    assert "signal 11" in next(iter(Store(tmp_path).failures())).reason


def test_a_worker_that_ends_in_the_middle_of_a_file_leaves_no_draft(render, small_job, tmp_path):
    partial = tmp_path / "partial"

    def watch(event, value):
        if event == "made":
            (partial / "worker-00-half-written.exr").touch()
            (partial / "worker-000-of-another.exr").touch()

    render(small_job, tmp_path, watch, workers=2)
    assert [path.name for path in partial.iterdir()] == ["worker-000-of-another.exr"]


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs Linux's account of a process")
def test_records_that_a_file_system_throws_away_end_the_run(
    render, small_job, tmp_path, monkeypatch
):
    monkeypatch.setenv("FAKE_STUDIO", "lost")
    with pytest.raises(
        InputError, match=r"worker-00\.jsonl: expected a disk .* Input/output error"
    ):
        render(small_job, tmp_path)
    assert ids(tmp_path) == []
    monkeypatch.setenv("FAKE_STUDIO", "")
    assert render(small_job, tmp_path).made == 12
    assert faults(tmp_path) == []


def test_two_runs_into_one_folder_do_not_meet(render, small_job, tmp_path):
    with (
        lock.writing(tmp_path),
        pytest.raises(InputError, match="no other run writes to"),
        lock.writing(tmp_path, patience=0),
    ):
        pass
    with lock.writing(tmp_path, (1, 4)), lock.writing(tmp_path, (2, 4)):
        with (
            pytest.raises(InputError, match="no other run"),
            lock.writing(tmp_path, (2, 4), patience=0),
        ):
            pass
        with (
            pytest.raises(InputError, match="parts of 3"),
            lock.writing(tmp_path, (1, 3), patience=0),
        ):
            pass
        with pytest.raises(InputError, match="no other run"), lock.writing(tmp_path, patience=0):
            pass


def test_a_name_keeps_meaning_one_thing_in_a_folder(render, plan_of, small_job, tmp_path):
    render(msgspec.structs.replace(small_job, shapes=("cube",)), tmp_path)
    dataset = Store(tmp_path).dataset()
    altered = {"cube": msgspec.structs.replace(dataset.shapes["cube"], hash="0" * 64)}
    Store(tmp_path).write_json("dataset.json", msgspec.structs.replace(dataset, shapes=altered))
    with pytest.raises(InputError, match=r"shape 'cube'.*rename the new one"):
        render(small_job, tmp_path)


@pytest.mark.parametrize("seed", [0, 1])
def test_kills_at_random_moments_lose_nothing_and_repeat_nothing(
    render, small_job, tmp_path, catalogue, seed
):
    """Four kills here, each of a run that has written records; tests/endurance/kill_and_resume.py
    does twenty with Cycles.
    """
    from tests.endurance.kill_and_resume import compared, disturbed

    job = msgspec.structs.replace(
        small_job, views=tuple(range(24)), shapes=("cube", "disc", "torus")
    )
    (tmp_path / "job.json").write_bytes(
        msgspec.json.encode(msgspec.structs.replace(job, lights=("lamp.exr",)))
    )
    (tmp_path / "lamp.exr").write_bytes(Path(job.lights[0]).read_bytes())
    command = [
        sys.executable,
        "-m",
        "tests.support.fake_render",
        str(tmp_path / "job.json"),
        str(tmp_path / "killed"),
        str(catalogue),
    ]
    kills = disturbed(
        command,
        tmp_path / "killed",
        kills=4,
        window=(0.0, 0.2),
        seed=seed,
        environment=SLOW,
        working=True,
    )
    # 216 pictures take two workers 2.2 s; each kill comes .2 s at most after the run's first record
    assert kills == 4
    render(job, tmp_path / "whole")
    assert compared(tmp_path / "whole", tmp_path / "killed") == []
    assert faults(tmp_path / "killed") == []


def test_a_worker_whose_run_was_killed_ends_and_nobody_starts_before_it_has(
    small_job, tmp_path, catalogue, light_file
):
    (tmp_path / "job.json").write_bytes(
        msgspec.json.encode(
            msgspec.structs.replace(small_job, views=tuple(range(24)), lights=("lamp.exr",))
        )
    )
    (tmp_path / "lamp.exr").write_bytes(light_file.read_bytes())
    command = [
        sys.executable,
        "-m",
        "tests.support.fake_render",
        str(tmp_path / "job.json"),
        str(tmp_path / "data"),
        str(catalogue),
    ]
    process = subprocess.Popen(
        command, env={**os.environ, **SLOW}, start_new_session=True, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 60
    while (
        not any(path.stat().st_size for path in Store(tmp_path / "data").record_files())
        and time.monotonic() < deadline
    ):
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)  # the parent alone; its worker lives on
    process.wait()
    with lock.writing(tmp_path / "data"):  # waits until the worker has noticed
        count = len(ids(tmp_path / "data"))
        time.sleep(0.3)
        assert len(ids(tmp_path / "data")) == count < 144


def test_a_forecast_whose_trial_shot_fails_says_so_in_a_line(plan_of, small_job, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("FAKE_STUDIO", "nan:cube")
    with pytest.raises(
        InputError,
        match="cube, view 0: expected a shot that can be made, found expected finite radiance",
    ):
        probe(plan_of(small_job), RunOptions(studio=FAKE))
