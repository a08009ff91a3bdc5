"""Every command of `learn` that writes, where the disk is full: one line, no draft, nothing lost,
and the same command succeeds later.

RLIMIT_FSIZE stands for the full disk: it needs no root. tests/endurance/full_disk.py does the same
on real small file systems.
"""

import json

import numpy as np
import pytest
import torch

from learn.data.sources import VALIDATION_SHAPES, number_from_hash
from learn.editing import drawing
from learn.evaluation import bench
from learn.layer import predictions
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.weights import save_weights
from tests.support.full_disk_case import RUN, SIZE, check, check_read_only, pictures
from tests.support.synthetic import add_shape, matte, write_dataset

QUICK = (
    "agree",
    "predict, of a data set",
    "predict, of a photograph",
    "edit",
    "transfer",
    "train",
    "evaluate",
    "baselines",
    "the demo's page",
)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """What the commands read, its pictures made by the layer."""
    room = tmp_path_factory.mktemp("room")
    pictures(room)
    (room / "run.json").write_text(json.dumps(RUN | {"network": "compact"}))
    both = [matte("dark", 0.2), matte("light", 0.8)]
    store = write_dataset(
        room / "data",
        both,
        np.random.default_rng(3),
        SIZE,
        1,
        0.0,
        rotations=(0,),
        category="sphere",
    )
    add_shape(
        store,
        next(
            f"ball:{k}"
            for k in range(1000)
            if number_from_hash(f"ball:{k}", VALIDATION_SHAPES) == 0
        ),
        "train",
    )
    add_shape(store, "cube:1", "test")
    torch.manual_seed(0)
    network = Compact(Ranges.of(torch.tensor([each.label for each in both])))
    (room / "out").mkdir()
    save_weights(
        room / "out" / "weights.safetensors", network, network.state_dict(), json.dumps(RUN), SIZE
    )
    (room / "agreement").mkdir()
    summary = {"direct": {}, "breakdowns": {}, "causes": {}}
    (room / "agreement" / "report.json").write_text(json.dumps({"summary": summary, "about": {}}))
    return room


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Nothing here looks at how right the pictures are: they are what is written."""
    monkeypatch.setattr(bench, "FIT_PIXELS", 8)
    monkeypatch.setattr(predictions, "method_for", lambda label: "auto")
    monkeypatch.setattr(drawing, "SPHERE", 16)
    monkeypatch.setattr(drawing, "TILE", 16)


@pytest.mark.parametrize("name", QUICK)
def test_a_full_disk_costs_a_line_and_nothing_else(room, tmp_path, small_files, name):
    check(name, room, tmp_path, small_files, seed=QUICK.index(name))


@pytest.mark.parametrize("name", QUICK)
def test_a_read_only_disk_can_be_read_and_costs_a_line_where_it_was_to_be_written(
    room, tmp_path, read_only, name
):
    check_read_only(name, room, tmp_path, read_only)
