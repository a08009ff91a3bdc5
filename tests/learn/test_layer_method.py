"""Where the layer's method can be chosen: refinement, training's losses, and relit pictures.

A lobe that is narrower than a texel, under a light whose texels differ, is what the sum over texels
and the integral differ in.
"""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import torch

from learn.data.batch import ExampleBatch
from learn.data.data_split import DataSplit
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Losses, decode_run
from learn.layer import render
from learn.networks.prediction import Prediction
from learn.refinement import PHOTOGRAPHS, RefinementSettings, refine
from learn.refinement.energy import Energy, State
from learn.training import losses, rerendering
from manifests.errors import InputError
from manifests.schema import Camera
from manifests.training_runs import LAYER_METHODS
from tests.support.synthetic import glossy, matte, sphere, write_dataset

SIZE = 20
GAMMA = 4e3
ELEVATION = 0.349


@pytest.fixture(scope="module")
def scene():
    """A ball in a glossy material under many small lamps: (ExampleBatch, its truth)."""
    normals, mask = sphere(Camera(size=(SIZE, SIZE)))
    n = torch.from_numpy(normals).movedim(-1, 0)[None].contiguous()
    inside = torch.from_numpy(mask)[None]
    label = torch.tensor(glossy(gamma=GAMMA).label).reshape(1, 1, 108).float()
    lamps = torch.rand(1, 1, 64, 128, generator=torch.Generator().manual_seed(0)) < 0.1
    light = 0.3 + 5.0 * lamps.expand(1, 3, 64, 128)
    picture = render(
        n.movedim(1, -1).contiguous(),
        label[:, 0].exp(),
        light.movedim(1, -1).contiguous(),
        mask=inside,
        method="quadrature",
        tolerance=1e-3,
    )
    image = picture.movedim(-1, 1).contiguous()
    batch = ExampleBatch(
        image, inside[:, None].float(), n, inside.long(), label, light, label, ("ball",), ELEVATION
    )
    return batch, Prediction(n, None, label, None, light)


def start_of(batch, truth):
    return State(truth.label.double(), truth.light, batch.n, {"material": torch.zeros(1, 3)})


def test_settings_by_a_method_differ_in_that_method_alone():
    for settings in (RefinementSettings(), PHOTOGRAPHS):
        assert settings.with_method("auto") == settings
        by = settings.with_method("quadrature")
        assert [by.method, *(level.method for level in by.levels)] == 3 * ["quadrature"]
        assert by.with_method("auto") == settings


def test_the_energy_of_the_truth_is_least_by_the_method_that_made_the_picture(scene):
    batch, truth = scene
    state = start_of(batch, truth)
    image = {
        method: Energy(batch, state, RefinementSettings().with_method(method)).terms_of_all_pixels(
            state
        )["image"]
        for method in LAYER_METHODS
    }
    assert image["quadrature"] < 1e-5 < 1e-3 < image["auto"]


@pytest.mark.parametrize("gamma", [4e3, 1e4])
def test_glossy_objects_are_refined_by_the_integral(scene, gamma):
    """With lamps in the predicted light; also lobes that are sharper than the samples follow."""
    batch, truth = scene
    label = torch.tensor(glossy(gamma=gamma).label).reshape(1, 1, 108).float()
    start = truth._replace(label=label, light=0.7 * truth.light)
    settings = RefinementSettings().with_method("quadrature")
    levels = tuple(replace(each, rounds=0, joint_iterations=3) for each in settings.levels)
    result = refine(batch, start, replace(settings, levels=levels, outer_iterations=1))
    assert result.after["total"] < 0.8 * result.before["total"]
    parts = (result.prediction.n, result.prediction.label, result.prediction.light)
    assert all(part.isfinite().all() for part in parts)


def pictures_of(batch, truth, method):
    """The picture by both ways of the losses, as (P, 3), and its derivatives by all parts."""
    inside = (batch.segments > 0).flatten(1)
    where = inside.nonzero()[None, :, 1]
    parts = [x.clone().requires_grad_() for x in (batch.n, truth.label, truth.light)]
    n, label, light = parts
    sampled = rerendering.render_pixels(n, label, light, batch, where, 1e9, method)[0]
    frame = rerendering.render_frames(n, label, light, batch, 1e9, method)[0]
    whole = frame.flatten(1)[:, where[0]].T
    gradients = torch.autograd.grad(sampled.mean() + whole.mean(), parts)
    return sampled.detach(), whole.detach(), gradients


def test_losses_are_rendered_by_the_method_that_the_run_names(scene):
    batch, truth = scene
    seen = batch.image[0].flatten(1)[:, (batch.segments > 0).flatten()].T
    for picture in pictures_of(batch, truth, "quadrature")[:2]:
        assert (picture - seen).abs().mean() < 1e-2 * seen.mean()
    for picture in pictures_of(batch, truth, "auto")[:2]:
        assert (picture - seen).abs().mean() > 0.1 * seen.mean()
    for gradient in pictures_of(batch, truth, "quadrature")[2]:
        assert gradient.isfinite().all() and gradient.abs().max() > 0


def test_a_run_names_the_method_of_its_losses(scene):
    """The truth of a picture that the integral made has no loss by the integral alone."""
    batch, truth = scene
    batch = replace(batch, picture=batch.image)
    values = {
        method: losses.layer_terms(
            truth,
            batch,
            Losses(image=1, pixels=200, layer_light=(64, 128), layer_method=method),
            torch.Generator().manual_seed(0),
        )["image"].item()
        for method in LAYER_METHODS
    }
    assert values["quadrature"] < 1e-5 < 1e-3 < values["auto"]


def test_a_run_names_the_method_of_its_relit_pictures(tmp_path, scene):
    from learn.data.geometry import Geometry

    write_dataset(tmp_path, [matte()], np.random.default_rng(1), size=32, category="sphere")
    geometry = Geometry(tmp_path, progress=False)
    light = scene[1].light[0].movedim(0, -1).numpy()
    labels = {"glossy": np.array(glossy(gamma=GAMMA).label, np.float32)}
    split = DataSplit(geometry, np.arange(len(geometry)), labels, [light], "test")
    batches = {
        method: RelitDataset(split, Data(sharing=1, layer_method=method), 1, 32, 5)[0]
        for method in LAYER_METHODS
    }
    batch = batches["quadrature"]
    right = render(
        batch.n.movedim(1, -1).contiguous(),
        batch.label[:, 0].exp(),
        batch.light.movedim(1, -1).contiguous(),
        mask=batch.segments > 0,
        method="quadrature",
        tolerance=1e-3,
    ).movedim(-1, 1)
    apart = {
        method: ((each.image - right).abs().mean() / right.mean()).item()
        for method, each in batches.items()
    }
    assert apart["quadrature"] < 0.02 and apart["auto"] > 0.1


def test_runs_without_the_keys_have_the_sum_and_other_methods_are_refused():
    old = {"name": "old", "losses": {"image": 1}, "data": {"sharing": 2}}
    for version in ({}, {"version": 2}, {"version": 3}):
        run = decode_run(json.dumps(old | version).encode(), "run.json")
        assert run.losses.layer_method == run.data.layer_method == "auto"
    both = old | {"losses": {"layer_method": "quadrature"}, "data": {"layer_method": "quadrature"}}
    run = decode_run(json.dumps(both).encode(), "run.json")
    assert decode_run(msgspec.json.encode(run), "run.json") == run
    assert run.losses.layer_method == run.data.layer_method == "quadrature"
    for part in ("losses", "data"):
        wrong = json.dumps(old | {part: {"layer_method": "exact"}}).encode()
        with pytest.raises(InputError, match=f"{part}.layer_method"):
            decode_run(wrong, "run.json")
