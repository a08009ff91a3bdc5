"""Batches that are shown several times, mirrored and recoloured: when, and that they are true."""

import msgspec
import numpy as np
import pytest
import torch

from learn.data import lights
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Losses, Run, Schedule
from learn.layer import render
from learn.training import repetition
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
    maps = [lights.draw_computed(rng).astype(np.float32) for _ in range(2)]
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


def error_of(seen):
    """How far a batch's picture is off what the layer makes of its truth, relative to the mean.

    The batch's own picture is within the tolerance of its layer.
    """
    picture = render(
        seen.n.movedim(1, -1).contiguous(),
        seen.label.exp()[:, 0],
        seen.light.movedim(1, -1).contiguous(),
        method="exact",
        elevation=seen.elevation,
    ).movedim(-1, 1)
    return (picture - seen.image * seen.mask).abs().mean() / picture.mean()


def test_the_mirrored_truth_renders_the_mirrored_picture(data_splits):
    batch = RelitDataset(data_splits["train"], DATA, 2, SIZE, 5)[0]
    seen = repetition.mirror(batch)
    assert error_of(seen) < DATA.tolerance
    assert not torch.equal(seen.image, batch.image)
    assert torch.equal(seen.mask[:, 0] > 0, seen.segments > 0)


def test_a_mirror_image_of_a_mirror_image_is_the_batch(data_splits):
    batch = RelitDataset(data_splits["train"], DATA, 2, SIZE, 5)[0]
    again = repetition.mirror(repetition.mirror(batch))
    for name in ("image", "mask", "n", "segments", "label", "light", "target_label"):
        assert torch.equal(getattr(again, name), getattr(batch, name)), name


@pytest.mark.parametrize("count", [1, 2, 4, 6])
def test_each_batch_is_shown_once_in_each_version_the_later_ones_later(count):
    steps, delay = range(200 * count), repetition.DELAY
    shown = [repetition.shown_at(step, count) for step in steps]
    first = {number: step for step, (number, version) in enumerate(shown) if version == 0}
    assert sorted(first) == list(range(200))
    for version in range(1, count):
        of_version = [(step, number) for step, (number, v) in enumerate(shown) if v == version]
        later = [number for step, number in of_version if step >= count * delay * version]
        assert later == list(range(200 - delay * version))  # none twice, none left out
        assert all(first[number] < step for step, number in of_version)
    assert repetition.needed_batches(steps, count) == list(range(200))


@pytest.mark.parametrize(
    "data", [Data(), DATA, Data(recolored=2), Data(mirrored=True, recolored=1)]
)
@pytest.mark.parametrize("first", [0, 1, 33, 64, 65, 130])
def test_a_run_that_continues_is_shown_the_same_batches(first, data):
    class Named:
        def __init__(self, version):
            self.version = version

        def apply(self, number):
            return number, self.version

    made_so_far = []

    def made(numbers):
        for number in numbers:
            made_so_far.append(number)
            yield number

    count = len(repetition.versions_of(data))
    assert count == (1 + data.mirrored) * (1 + data.recolored)
    steps = range(first, 240)
    seen = list(repetition.repeat_batches(steps, [Named(v) for v in range(count)], made))
    assert seen == [repetition.shown_at(step, count) for step in steps]
    assert len(made_so_far) == len(set(made_so_far))


def test_recoloured_pictures_are_those_of_the_recoloured_scene(data_splits):
    batch = RelitDataset(data_splits["train"], DATA, 2, SIZE, 5)[0]
    seen = repetition.exchange_channels(batch, 1)
    assert error_of(seen) < DATA.tolerance
    assert torch.equal(seen.image[:, 1], batch.image[:, 0])
    again = repetition.exchange_channels(repetition.exchange_channels(seen, 1), 1)
    for name in ("image", "light", "label", "target_label", "n"):
        assert torch.equal(getattr(again, name), getattr(batch, name)), name


def test_a_mirrored_run_that_was_stopped_ends_with_bitwise_the_same_weights(
    data_splits, tmp_path, monkeypatch
):
    monkeypatch.setattr(repetition, "DELAY", 2)  # so that the sixth step is the first mirrored one

    def trained(folder, limit=None):
        own = run(10)
        training = Training(
            own, data_splits, folder, sheet_every=1000, checkpoint_every=1, workers=0
        )
        if limit is not None:
            training._is_done = lambda: training.step >= limit
        training.train()
        return training

    whole = trained(tmp_path / "whole")
    trained(tmp_path / "stopped", 7)
    resumed = trained(tmp_path / "stopped")
    assert resumed.step == 10
    for name, tensor in whole.network.state_dict().items():
        assert torch.equal(tensor, resumed.network.state_dict()[name]), name
    plain = msgspec.structs.replace(run(10), data=Data(sharing=2, photograph=False))
    other = Training(plain, data_splits, tmp_path / "plain", sheet_every=1000, workers=0)
    other.train()
    assert not all(
        torch.equal(tensor, other.network.state_dict()[name])
        for name, tensor in whole.network.state_dict().items()
    )
