"""Evaluation and experiments on a cluster: the same rows as here, each once, however it is stopped.

Without Ray, workers are objects of this process (tests.support.fake_ray) that are lost at random;
one test starts a cluster.
"""

import json
import os
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from learn.__main__ import COMMANDS as LEARN
from learn.evaluation import bench
from learn.experiments import on_ray, runner
from learn.experiments.__main__ import COMMANDS as EXPERIMENTS
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.weights import save_weights
from manifests import files
from manifests.cli import main
from tests.support import fake_ray, ladder_rungs
from tests.support.synthetic import matte, write_dataset
from tests.support.tetrahedron import ROOT

SIZE = 32
PROGRAMS = {
    "evaluate": ("learn", "--no-refine --edits 4 --gallery 1 --data {room}/data", "edits.jsonl"),
    "relighting": ("learn.experiments", "--pictures 2 --data {room}/ladder", "rows.jsonl"),
    "upsampling": ("learn.experiments", "--edits 2 --data {room}/large", "rows.jsonl"),
}
# what differs between two measurements of the same
VARYING = ("commit", "seconds", "ms")


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Data sets in two materials, and untrained weights."""
    room = tmp_path_factory.mktemp("room")
    both = [matte("dark", 0.2), matte("light", 0.8)]
    rng = np.random.default_rng(3)
    write_dataset(room / "data", both, rng, SIZE, 1, 0.0, (0, 40), method="quadrature")
    write_dataset(room / "large", both, rng, 2 * SIZE, 1, 0.0, (0,), category="sphere")
    ladder_rungs.written(room / "ladder", SIZE)
    torch.manual_seed(0)
    network = Compact(Ranges.of(torch.tensor([each.label for each in both])))
    save_weights(room / "weights.safetensors", network, network.state_dict(), "{}", SIZE)
    return room


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """What has no part in what is tested here is left out."""
    monkeypatch.setattr(bench, "FIT_PIXELS", 8)


def command(name, room, out, *more):
    """Run a command or an experiment; its exit status."""
    program, words, _ = PROGRAMS[name]
    commands = LEARN if program == "learn" else EXPERIMENTS
    words = [name, *words.format(room=room).split(), "--out", str(out), *more]
    words += ["--weights", str(room / "weights.safetensors")]
    threads = torch.get_num_threads()
    try:
        return main(program, "", commands, words)
    finally:
        torch.set_num_threads(threads)


def rows(name, out):
    """The rows of a run, without what varies, each once, as sorted text."""
    lines = list(files.read_lines(out / PROGRAMS[name][2]))
    return sorted(json.dumps(without_varying(line), sort_keys=True) for line in lines)


def without_varying(value):
    if isinstance(value, dict):
        return {k: without_varying(v) for k, v in value.items() if k not in VARYING}
    return [without_varying(v) for v in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_cluster_that_is_stopped_and_loses_workers_measures_what_this_process_measures(
    name, room, tmp_path, monkeypatch, capsys
):
    assert command(name, room, tmp_path / "here") == 0, capsys.readouterr().err
    expected, out, given = rows(name, tmp_path / "here"), tmp_path / "there", Counter()

    def stopped(piece):
        given[piece is not None] += 1
        if given[True] > 1:
            raise KeyboardInterrupt
        return False

    def lost(piece):
        given[piece] += 1
        return piece in (None, 0) and given[piece] == 1

    fake_ray.installed(monkeypatch, stopped)
    assert command(name, room, out, "--ray", "auto") == 130
    assert 0 < len(rows(name, out)) < len(expected)
    given.clear()
    fake_ray.installed(monkeypatch, lost)
    assert command(name, room, out, "--ray", "auto") == 0, capsys.readouterr().err
    assert rows(name, out) == expected and given[0] == 2
    # with nothing left to do, no worker is started
    tasks = fake_ray.installed(monkeypatch)
    monkeypatch.setattr(tasks, "_started", None)
    assert command(name, room, out, "--ray", "auto") == 0, capsys.readouterr().err
    if name == "evaluate":
        assert len(list((out / "gallery").glob("*.png"))) == 1


def test_a_folder_that_is_not_shared_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(on_ray, "_wanted", tmp_path / "second.jsonl")
    with pytest.raises(Exception, match="a folder that all nodes share at one path"):
        runner.resume(tmp_path / "first.jsonl", [({"k": 1}, 1)], lambda k: {}, "row")
    files.write_text(tmp_path / "first.jsonl", '{"k": 1}\n')
    assert runner.resume(tmp_path / "first.jsonl", [({"k": 1}, 1)], lambda k: {}, "row")
    with pytest.raises(on_ray._Reached):
        runner.resume(tmp_path / "second.jsonl", [({"k": 1}, 1)], lambda k: {}, "row")


def test_options_reach_a_worker_as_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = {"a": [Path("b"), 1.5], "c": {"d": None}, "run": print, "e": "f", "g": (1, "h")}
    text = msgspec.json.Encoder(enc_hook=lambda path: str(path.absolute())).encode(
        on_ray._packed(given)
    )
    assert on_ray._unpacked(msgspec.json.decode(text)) == {
        "a": [tmp_path / "b", 1.5],
        "c": {"d": None},
        "e": "f",
        "g": [1, "h"],
    }


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("evaluate-network {room}/card.safetensors --device cuda", "found --device cuda"),
        ("evaluate --processes 2", "expected no --processes, found 2"),
        ("evaluate --device cuda", "expected no --device, found --device cuda"),
        ("evaluate-ladder --device cuda", "expected no --device, found --device cuda"),
    ],
)
def test_what_a_cluster_does_not_use_is_refused(words, problem, room, tmp_path, capsys):
    words += f" --ray auto --data {room}/data --weights {room}/weights.safetensors"
    assert main("learn", "", LEARN, [*words.split(), "--out", str(tmp_path / "out")]) == 1
    assert problem in capsys.readouterr().err


def test_experiments_with_a_clock_have_no_such_option(room, tmp_path, capsys):
    timed = {"edit-cost", "outer-iterations", "mitsuba-comparison", "refinement-ablation"}
    assert all(not getattr(runner.find(name), "ON_RAY", False) for name in timed)
    words = f"edit-cost --ray auto --data {room}/data --out {tmp_path}/out"
    with pytest.raises(SystemExit):
        main("learn.experiments", "", EXPERIMENTS, words.split())
    assert "unrecognized arguments: --ray auto" in capsys.readouterr().err


@pytest.mark.long
def test_a_real_cluster_measures_what_this_process_measures(room, tmp_path, monkeypatch, capsys):
    ray = pytest.importorskip("ray", reason="ray is not installed (extra ray)")
    from tests.support.ray_cluster import started

    monkeypatch.undo()  # workers measure all pixels and rungs
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    few = {"evaluate": ("--edits", "2"), "relighting": ("--pictures", "1")}
    for name, more in few.items():
        assert command(name, room, tmp_path / "here" / name, *more) == 0, capsys.readouterr().err
    with started(ray, nodes=2):
        for name, more in few.items():
            out = tmp_path / "there" / name
            assert command(name, room, out, "--ray", "auto", *more) == 0, capsys.readouterr().err
            assert rows(name, out) == rows(name, tmp_path / "here" / name)
