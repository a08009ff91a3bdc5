"""The Lombardi-like method's posterior by hand, Baseline 1's regions, and which lights the
baselines never see.
"""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from learn.baselines import posterior, priors
from learn.baselines import training as making
from learn.commands.options import EDITING_WEIGHTS, TABLE_WEIGHTS
from learn.data import lights
from learn.data.batch import ExampleBatch
from learn.data.settings import Data, Run
from learn.evaluation import baseline_methods as methods
from learn.layer import predictions
from learn.networks import weights
from learn.networks.coding import compress
from learn.networks.encoder_decoder import Edited

SIZE, HARMONICS = 16, (priors.DEGREE + 1) ** 2


@pytest.fixture
def batch():
    """A black picture of two regions, left and right, above a row that belongs to neither."""
    segments = torch.ones(1, SIZE, SIZE, dtype=torch.int64)
    segments[:, :, SIZE // 2 :] = 2
    segments[:, -1] = 0
    n = torch.tensor([0.0, 0.0, 1.0])[None, :, None, None].expand(1, 3, SIZE, SIZE)
    label, light = torch.zeros(1, 2, 108), torch.ones(1, 3, 64, 128)
    mask = (segments > 0)[:, None].float()
    return ExampleBatch(
        torch.zeros(1, 3, SIZE, SIZE), mask, n, segments, label, light, label, ("plane",), 0.349
    )


def test_a_posterior_adds_the_pictures_misfit_and_both_priors(batch, monkeypatch):
    known = priors.Priors(
        mean=torch.zeros(108).double(),
        directions=torch.zeros(2, 108).double(),
        medoids=torch.zeros(1, 2).double(),
        light_mean=torch.zeros(HARMONICS, 3).double(),
        light_spread=torch.ones(HARMONICS, 3).double(),
    )
    off = (9**priors.NOISE - 1) / 8  # radiance that is one standard deviation from black
    drawn = []
    monkeypatch.setattr(predictions, "render", lambda n, *_, **__: torch.full(n.shape, drawn[-1]))
    z_m, z_L = torch.zeros(2, 2).double(), torch.zeros(HARMONICS, 3).double()
    of_picture = posterior.Posterior(batch, known)
    for radiance, material, light, expected in (
        (0.0, 0.0, 0.0, 0.0),
        (off, 0.0, 0.0, posterior.PIXELS / 2),
        (0.0, 3.0, 0.0, 4.5),
        (0.0, 0.0, 4.0, 8.0),
        (off, 3.0, 4.0, posterior.PIXELS / 2 + 12.5),
    ):
        drawn.append(radiance)
        z_m[1, 0], z_L[5, 1] = material, light
        # float32
        assert float(of_picture.energy(z_m, z_L, (4, 8))) == pytest.approx(expected, rel=1e-4)


def test_baseline_1_draws_each_region_in_its_own_material(batch):
    def flatly(image, mask, target):
        return Edited(None, None, None, compress(target[0, 0, 0]).expand(image.shape))

    label = torch.tensor([0.2, 0.7])[:, None].expand(2, 108)
    picture = methods.Swapped("Baseline 1", flatly, SIZE).edit(batch, label)
    for segment, expected in ((0, 0.0), (1, 0.2), (2, 0.7)):
        # float32
        np.testing.assert_allclose(
            picture[batch.segments[0].numpy() == segment], expected, rtol=1e-5
        )


@pytest.fixture
def options(tmp_path):
    """As learn.commands.train_baselines parses them: a run's weights that held two maps out are to
    be followed.
    """
    path = tmp_path / "weights.safetensors"
    run = Run(name="ours", data=Data(validation_lights=("sky",), test_lights=("room",)))
    weights.save(path, {"weight": torch.zeros(1)}, {"run": msgspec.json.encode(run).decode()})
    return SimpleNamespace(
        out=tmp_path / "out", like=path, steps=7, data=None, lights=None, workers=0, materials=None
    )


def test_a_preset_holds_out_the_lights_that_other_weights_held_out(options):
    preset = Run(name="baseline", data=Data(sharing=2, validation_lights=("lawn",)))
    run = making.resolve_preset(preset, options)
    assert run.data == Data(sharing=2, validation_lights=("sky",), test_lights=("room",))
    assert run.schedule.steps == 7
    assert (
        making.resolve_preset(preset, SimpleNamespace(like=None, steps=None, materials=None))
        == preset
    )


def test_baselines_draw_from_the_materials_of_the_weights_they_are_like(options):
    assert making.hold_out(options, Data(materials="built-in")).materials == "dataset"
    options.materials = "built-in"  # as --materials asks
    assert making.hold_out(options, Data()).materials == "built-in"
    # a run of version 1, which could not choose
    options.materials, options.like = None, TABLE_WEIGHTS
    assert making.hold_out(options, Data()).materials == "built-in"
    options.like = None
    assert making.hold_out(options, Data()).materials == "dataset"


def test_baselines_have_the_measured_lights_of_the_weights_they_are_like(options):
    assert not making.hold_out(options, Data()).measured_lights
    assert making.hold_out(options, Data(measured_lights=True)).measured_lights
    options.like = EDITING_WEIGHTS  # its run draws from them, and names them as held out
    assert making.hold_out(options, Data()).measured_lights


def test_priors_are_fitted_without_the_lights_that_other_weights_held_out(
    options, monkeypatch, rng
):
    asked = []
    train = SimpleNamespace(
        labels={name: rng.standard_normal(108) for name in "ab"},
        maps=[lights.draw_computed(rng).astype(np.float32) for _ in range(2)],
        copies=(),
    )
    monkeypatch.setattr(
        making.sources, "load_data_splits", lambda data, *_: asked.append(data) or {"train": train}
    )
    making.train_baseline("lombardi", None, options)
    assert asked == [Data(validation_lights=("sky",), test_lights=("room",))]
    assert priors.load(options.out / making.FILE_OF["lombardi"]).directions.shape[1] == 108
