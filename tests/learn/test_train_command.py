"""`learn train` as a user runs it: events and skipped records when asked for, and the same samples
for one process as for two.
"""

import json
import os
import subprocess
import sys

import pytest

from tests.support.tiny_run import RUN, train, two_sided
from tests.support.two_materials import damage, first

# Each step's samples and the weights after it, by process: PROGRAM FOLDER train …
PROGRAM = """
import hashlib, itertools, json, os, sys, time
from pathlib import Path
from types import SimpleNamespace
import torch
from learn.training import clock, loop
from manifests.cli import main

step = loop.Training._make_step

def watched(self, batch):
    record = step(self, batch)
    samples = [hashlib.sha256(image.numpy().tobytes()).hexdigest() for image in batch.image]
    parameters = b"".join(p.detach().numpy().tobytes() for p in self.network.parameters())
    weights = hashlib.sha256(parameters).hexdigest()
    with open(Path(sys.argv[1]) / f"{self.world}-{self.rank}.jsonl", "a") as file:
        file.write(json.dumps({"samples": samples, "weights": weights}) + "\\n")
    return record

loop.Training._make_step = watched
if os.environ.get("UNEQUAL_CLOCKS"):  # a step takes each process longer than the one before it
    readings = (0.1 * k * (1 + int(os.environ["RANK"])) for k in itertools.count())
    unequal = SimpleNamespace(process_time=lambda: next(readings), monotonic=time.monotonic)
    clock.time = loop.time = unequal
sys.exit(main("learn", "", ("train",), sys.argv[2:]))
"""


@pytest.fixture
def store(tmp_path):
    """A dataset with a shape for each side, four pictures of each."""
    return two_sided(tmp_path / "data")


@pytest.mark.filterwarnings("ignore")  # of TensorBoard's own imports
def test_tensorboard_when_asked_has_each_steps_loss_the_validation_and_the_sheet(store, tmp_path):
    pytest.importorskip("tensorboard")
    assert train(store, tmp_path / "out", "--tensorboard", "--sheet-every", "2") == 0
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "out" / "tensorboard")).Reload()
    logged = [
        json.loads(line) for line in (tmp_path / "out" / "log.jsonl").read_text().splitlines()
    ]
    assert [(e.step, e.value) for e in events.Scalars("train/loss")] == [
        (r["step"], pytest.approx(r["loss"])) for r in logged
    ]
    assert [e.step for e in events.Scalars("validation/cosine")] == [1]
    assert [e.step for e in events.Images("sheet")] == [1]


def test_a_run_says_what_made_it_and_from_what_and_writes_no_events_unasked(store, tmp_path):
    assert train(store, tmp_path / "out") == 0
    assert not (tmp_path / "out" / "tensorboard").exists()
    report = json.loads((tmp_path / "out" / "made.json").read_text())
    assert {"command", "commit", "date", "machine", "versions"} <= set(report["made_by"])
    assert {
        side: (of["shapes"], of.get("pictures", 0)) for side, of in report["sides"].items()
    } == {
        "train": (1, 4),
        "validation": (1, 4),
        "test": (1, 0),  # in training materials
    }
    last = json.loads((tmp_path / "out" / "log.jsonl").read_text().splitlines()[-1])
    assert (report["step"], report["validation"]) == (2, last["validation"])


def test_a_bad_record_stops_the_command_before_training_or_is_left_out_and_counted_when_asked(
    store, tmp_path, capsys
):
    path = damage(store, "not finite")
    assert train(store, tmp_path / "out") == 1
    report = [
        line
        for line in capsys.readouterr().err.replace("\r", "\n").splitlines()
        if line.startswith("learn:")
    ]
    assert len(report) == 1
    assert path.name in report[0] and "--skip-bad" in report[0]
    assert not (tmp_path / "out" / "weights.safetensors").exists()
    assert train(store, tmp_path / "out", "--skip-bad") == 0
    error = capsys.readouterr().err
    # records of one image file, each left out
    naming = sum(r.image == first(store).image for r in store.records())
    assert f"{naming} left out" in error and path.name in error
    assert (tmp_path / "out" / "weights.safetensors").exists()


def launch(folder, root, processes, options, **environment):
    """Run `train` in one process, or in several of torchrun, which watch themselves in `folder`."""
    program = folder / "program.py"
    program.write_text(PROGRAM)
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]
    words = [sys.executable, *([*torchrun, str(processes)] if processes > 1 else []), str(program)]
    ran = subprocess.run(
        [*words, str(folder), "train", *options],
        capture_output=True,
        text=True,
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"} | environment,
        timeout=300,
    )
    assert ran.returncode == 0, ran.stderr[-2000:]


def test_two_processes_of_torchrun_see_the_samples_of_one_and_keep_the_same_weights(
    store, tmp_path, root
):
    # a batch that is relit, then one of pictures
    run = RUN | {"data": {"sharing": 1, "source": "mix", "pictures_share": 0.5}}
    (store.folder / "run.json").write_text(json.dumps(run))
    options = [
        "--data",
        str(store.folder),
        "--workers",
        "0",
        "--sheet-every",
        "0",
        str(store.folder / "run.json"),
        "--out",
    ]
    for name, processes in (("one", 1), ("two", 2)):
        launch(tmp_path, root, processes, [*options, str(tmp_path / name)])
    one, first_half, second_half = (
        [json.loads(line) for line in (tmp_path / f"{name}.jsonl").read_text().splitlines()]
        for name in ("1-0", "2-0", "2-1")
    )
    assert len(one) == RUN["schedule"]["steps"]
    for whole, a, b in zip(one, first_half, second_half, strict=True):
        assert len(a["samples"]) == len(b["samples"]) == 2
        assert sorted(a["samples"] + b["samples"]) == sorted(whole["samples"])
        assert a["weights"] == b["weights"]


def test_processes_of_a_run_that_ends_by_a_clock_follow_the_firsts(store, tmp_path, root):
    schedule = {**RUN["schedule"], "steps": 100, "seconds": 1.9}
    (store.folder / "run.json").write_text(json.dumps(RUN | {"schedule": schedule}))
    options = ["--data", str(store.folder), "--workers", "0", "--sheet-every", "0"]
    options += [str(store.folder / "run.json"), "--out", str(tmp_path / "out")]
    launch(tmp_path, root, 2, options, UNEQUAL_CLOCKS="yes")
    first, second = (
        [json.loads(line)["weights"] for line in (tmp_path / name).read_text().splitlines()]
        for name in ("2-0.jsonl", "2-1.jsonl")
    )
    assert first == second  # weights after each step, and so learning rates and the end
    assert len(set(first)) == 4  # a step takes the first process half a second, the second a whole


def test_a_run_without_contact_sheets_ends_with_weights(store, tmp_path):
    options = ("--sheet-every", "0")
    assert train(store, tmp_path / "out", *options) == 0
    weights = tmp_path / "out" / "weights.safetensors"
    written = weights.read_bytes()
    assert train(store, tmp_path / "other", "--sheet-every", "2") == 0
    assert (tmp_path / "other" / "weights.safetensors").read_bytes() == written
    weights.unlink()
    assert train(store, tmp_path / "out", *options) == 0
    assert weights.read_bytes() == written


def test_the_command_of_a_complete_run_leaves_what_the_last_one_wrote(store, tmp_path):
    made = tmp_path / "out" / "made.json"
    assert train(store, tmp_path / "out") == 0
    written = made.read_text()
    assert json.loads(written)["validation"]
    assert train(store, tmp_path / "out") == 0
    assert made.read_text() == written


@pytest.mark.parametrize(("world", "expected"), [("1", "written, finalised"), ("2", "written, ")])
def test_one_of_several_processes_ends_without_waiting_for_the_threads_of_torch(
    root, world, expected
):
    program = (
        "import atexit; from learn.training import processes;"
        "atexit.register(print, 'finalised', end='');"
        "print('written', end=', '); processes.end_without_finalising()"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=root,
        env=os.environ | {"WORLD_SIZE": world},
        timeout=120,
    )
    assert (ran.returncode, ran.stdout) == (0, expected)
