"""Batches that are shown a second time, mirrored: which ones, when, and that they are true."""

import msgspec
import numpy as np
import pytest
import torch

from learn.data import lights
from learn.data.geometry import Geometry
from learn.data.relit import DataSplit, RelitDataset
from learn.data.settings import Data, Losses, Run, Schedule
from learn.layer import render
from learn.training import mirroring
from learn.training.loop import Training
from manifests.materials import load_catalogue
from tests.support import synthetic

SIZE = 32
DATA = Data(sharing=2, photograph=False, mirrored=True)
MATERIALS = ("teflon", "nickel", "gold-metallic-paint", "pvc")


@pytest.fixture(scope="module")
def data_splits(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    rng = np.random.default_rng(1)
    synthetic.write_dataset(folder, [synthetic.matte()], rng, size=SIZE, category="sphere")
    geometry, catalogue = Geometry(folder, progress=False), load_catalogue()
    labels = {name: catalogue[name].label.reshape(-1).astype(np.float32) for name in MATERIALS}
    maps = [lights.computed(rng).astype(np.float32) for _ in range(2)]
    return {
        side: DataSplit(geometry, np.arange(len(geometry)), labels, maps, side)
        for side in ("train", "validation", "test")
    }


def run(steps):
    return Run(
        name="mirrored",
        size=SIZE,
        parts=("normals",),
        data=DATA,
        losses=Losses(normals=1, material=0),
        schedule=Schedule(steps=steps, batch=4, warm_up=1),
        seed=1,
    )


def test_the_mirrored_truth_renders_the_mirrored_picture(data_splits):
    batch = RelitDataset(data_splits["train"], DATA, 2, SIZE, 5)[0]
    seen = mirroring.mirrored(batch)
    picture = render(
        seen.n.movedim(1, -1).contiguous(),
        seen.label.exp()[:, 0],
        seen.light.movedim(1, -1).contiguous(),
        method="exact",
        elevation=seen.elevation,
    ).movedim(-1, 1)
    # the batch's own picture is within the tolerance of its layer
    error = (picture - seen.image * seen.mask).abs().mean() / picture.mean()
    assert error < DATA.tolerance
    assert not torch.equal(seen.image, batch.image)
    assert torch.equal(seen.mask[:, 0] > 0, seen.segments > 0)


def test_a_mirror_image_of_a_mirror_image_is_the_batch(data_splits):
    batch = RelitDataset(data_splits["train"], DATA, 2, SIZE, 5)[0]
    again = mirroring.mirrored(mirroring.mirrored(batch))
    for name in ("image", "mask", "n", "segments", "label", "light", "target_label"):
        assert torch.equal(getattr(again, name), getattr(batch, name)), name


def test_each_batch_is_shown_once_as_it_is_and_once_mirrored_later():
    steps = range(400)
    shown = [mirroring.shown_at(step) for step in steps]
    plain = {number: step for step, (number, is_mirrored) in enumerate(shown) if not is_mirrored}
    others = [(number, step) for step, (number, is_mirrored) in enumerate(shown) if is_mirrored]
    assert sorted(plain) == list(range(200))
    later = [number for number, step in others if step >= 2 * mirroring.DELAY]
    assert later == list(range(200 - mirroring.DELAY))  # none twice, none left out
    assert all(plain[number] < step for number, step in others)
    assert mirroring.numbers(steps) == list(range(200))


@pytest.mark.parametrize("first", [0, 1, 33, 64, 65, 130])
def test_a_run_that_continues_is_shown_the_same_batches(first):
    def made(numbers):
        yield from numbers

    def shown(steps):
        return [
            (number, "mirrored") if is_mirrored else number
            for number, is_mirrored in map(mirroring.shown_at, steps)
        ]

    steps = range(first, 140)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mirroring, "mirrored", lambda number: (number, "mirrored"))
        assert list(mirroring.batches(steps, made)) == shown(steps)


def test_a_mirrored_run_that_was_stopped_ends_with_bitwise_the_same_weights(data_splits, tmp_path):
    def trained(folder, limit=None):
        own = run(38)
        training = Training(
            own, data_splits, folder, sheet_every=1000, checkpoint_every=1, workers=0
        )
        if limit is not None:
            training._is_done = lambda: training.step >= limit
        training.train()
        return training

    whole = trained(tmp_path / "whole")
    trained(tmp_path / "stopped", 35)
    resumed = trained(tmp_path / "stopped")
    assert resumed.step == 38
    for name, tensor in whole.network.state_dict().items():
        assert torch.equal(tensor, resumed.network.state_dict()[name]), name
    plain = msgspec.structs.replace(run(38), data=Data(sharing=2, photograph=False))
    other = Training(plain, data_splits, tmp_path / "plain", sheet_every=1000, workers=0)
    other.train()
    assert not all(
        torch.equal(tensor, other.network.state_dict()[name])
        for name, tensor in whole.network.state_dict().items()
    )
