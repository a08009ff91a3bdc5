"""Evaluation and experiments on a cluster: the same rows as here, each once, however it is stopped.

Without Ray, workers are objects of this process (tests.support.fake_ray) that are lost at random;
one test starts a cluster.
"""

import json
import os
import re
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from learn.__main__ import COMMANDS as LEARN
from learn.data.settings import Data, Run
from learn.evaluation import card_batches, edit_evaluator
from learn.experiments import on_ray, runner
from learn.experiments.__main__ import COMMANDS as EXPERIMENTS
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.weights import save_weights
from manifests import files, outputs
from manifests.cli import main
from tests.support import fake_ray, ladder_rungs
from tests.support.synthetic import add_sides, matte, write_dataset
from tests.support.tetrahedron import ROOT

SIZE = 32
PROGRAMS = {
    "evaluate": ("learn", "--no-refine --edits 4 --gallery 1 --data {room}/data", "edits.jsonl"),
    "edit-brightness": ("learn.experiments", "--scenes 2 --data {room}/ladder", "rows.jsonl"),
    "relighting": ("learn.experiments", "--pictures 2 --data {room}/ladder", "rows.jsonl"),
    "upsampling": ("learn.experiments", "--edits 2 --data {room}/large", "rows.jsonl"),
    "unseen-shapes": (
        "learn.experiments",
        "--pictures 2 --data {room}/data --data {room}/large --allow-overlap",
        "rows.jsonl",
    ),
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
    store = write_dataset(room / "sides", both, rng, SIZE, 1, 0.0, (0,), category="sphere")
    add_sides(store)
    for name, seed in (("weights", 0), ("second", 1)):
        torch.manual_seed(seed)
        network = Compact(Ranges.of(torch.tensor([each.label for each in both])))
        run = Run(name="tiny", size=SIZE, data=Data(sharing=1), seed=seed)
        settings = msgspec.json.encode(run).decode()
        save_weights(room / f"{name}.safetensors", network, network.state_dict(), settings, SIZE)
    return room


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """What has no part in what is tested here is left out."""
    monkeypatch.setattr(edit_evaluator, "FIT_PIXELS", 8)


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
    lines = list(outputs.read_lines(out / PROGRAMS[name][2]))
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
    monkeypatch.setattr(tasks, "_start_worker", None)
    assert command(name, room, out, "--ray", "auto") == 0, capsys.readouterr().err
    if name == "evaluate":
        assert len(list((out / "gallery").glob("*.png"))) == 1


def card(room, out, *more):
    """Run evaluate-network on two seeds, with patterns as well."""
    words = f"evaluate-network {room}/weights.safetensors --other-seeds {room}/second.safetensors"
    words += f" --data {room}/sides --pictures {room}/sides --batches 3 --printed --allow-overlap"
    threads = torch.get_num_threads()
    try:
        return main("learn", "", LEARN, [*words.split(), "--out", str(out), *more])
    finally:
        torch.set_num_threads(threads)


def test_a_card_is_the_same_by_a_cluster_that_loses_workers(room, tmp_path, monkeypatch, capsys):
    assert card(room, tmp_path / "here") == 0, capsys.readouterr().err
    out, given = tmp_path / "there", Counter()

    def stopped(piece):
        given[piece is not None] += 1
        if given[True] > 1:
            raise KeyboardInterrupt
        return False

    def lost(piece):
        given[piece] += 1
        return piece in (None, 0, 7) and given[piece] == 1

    fake_ray.installed(monkeypatch, stopped)
    assert card(room, out, "--ray", "auto") == 130 and not (out / "card.json").exists()
    given.clear()
    fake_ray.installed(monkeypatch, lost)
    assert card(room, out, "--ray", "auto") == 0, capsys.readouterr().err
    assert given[0] == given[7] == 2 and given[None] > 2
    for name in ("card.json", "card.md", "sheet.jpg"):
        assert (out / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


def test_figures_that_are_not_known_come_back_from_a_worker():
    values = {"a": np.array([1.5, np.nan], np.float32), "b": np.array([1 / 3])}
    packed = msgspec.json.decode(msgspec.json.encode(card_batches._pack((values, ("x", "y")))))
    back, names = card_batches._unpack(packed)
    assert list(names) == ["x", "y"]
    for key, value in values.items():
        np.testing.assert_array_equal(back[key], value)
        assert back[key].dtype == value.dtype


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
        on_ray._pack(given)
    )
    assert on_ray._unpack(msgspec.json.decode(text)) == {
        "a": [tmp_path / "b", 1.5],
        "c": {"d": None},
        "e": "f",
        "g": [1, "h"],
    }


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("evaluate --processes 2", "expected no --processes, found 2"),
        ("evaluate --device cuda", "expected no --device, found --device cuda"),
        ("evaluate-ladder --device cuda", "expected no --device, found --device cuda"),
        ("evaluate-network --device cuda", "expected no --device, found --device cuda"),
    ],
)
def test_what_a_cluster_does_not_use_is_refused(words, problem, room, tmp_path, capsys):
    weights = "" if "evaluate-network" in words else "--weights"
    words += f" --ray auto --data {room}/data {weights} {room}/weights.safetensors"
    assert main("learn", "", LEARN, [*words.split(), "--out", str(tmp_path / "out")]) == 1
    assert problem in capsys.readouterr().err


def test_the_page_on_clusters_names_the_experiments_that_have_the_option():
    table = (ROOT / "docs" / "clusters.md").read_text("utf-8").split("\n## Evaluation and", 1)[1]
    listed = [
        name
        for line in table.splitlines()
        if line.startswith("| the experiment")
        for name in re.findall(r"`([a-z-]+)`", line.split("|")[1])
    ]
    with_option = [name for name in EXPERIMENTS if getattr(runner.find(name), "ON_RAY", False)]
    assert sorted(listed) == sorted(with_option)


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
    few = {"evaluate": ("--edits", "2"), "relighting": ("--pictures", "1"), "unseen-shapes": ()}
    for name, more in few.items():
        assert command(name, room, tmp_path / "here" / name, *more) == 0, capsys.readouterr().err
    with started(ray, nodes=2):
        for name, more in few.items():
            out = tmp_path / "there" / name
            assert command(name, room, out, "--ray", "auto", *more) == 0, capsys.readouterr().err
            assert rows(name, out) == rows(name, tmp_path / "here" / name)
        assert card(room, tmp_path / "there", "--ray", "auto") == 0, capsys.readouterr().err
    assert card(room, tmp_path / "here") == 0, capsys.readouterr().err
    for name in ("card.json", "card.md"):
        assert (tmp_path / "there" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
