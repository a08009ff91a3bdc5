"""Texels split where lobes are narrow: which they are, their light, and the sum over them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from learn.experiments.layer import chart_cases
from learn.methods import load, quadrature, split_texels
from manifests.materials import find
from shaders.envmap import directions, texel
from shaders.frames import ELEVATION, camera_from_light

SIZE = 64, 128
LIMITS = (300.0, 1200.0)
TURN = camera_from_light(ELEVATION)
ALL = torch.ones(3, 3, dtype=torch.bool)


def one_lobe(gamma, at_grazing):
    """κ = 1; γ from the viewer's direction to grazing angles."""
    m = torch.zeros(3, 3, 2, 6)
    m[:, 1, 0] = 1.0
    m[:, 1, 1] = torch.linspace(np.log(gamma), np.log(at_grazing), 6).exp()
    return m


def parts(m, lobes=ALL, view=None):
    return split_texels.parts_of_texels(m, lobes, view, SIZE, TURN, LIMITS, (1, 2))


@pytest.mark.parametrize("gamma, split", [(290.0, 1), (310.0, 2), (1190.0, 2), (5e4, 0)])
def test_a_lobe_of_one_width_splits_all_texels_alike(gamma, split):
    assert (parts(one_lobe(gamma, gamma)) == split).all()


def test_only_texels_at_angles_where_a_lobe_is_narrow_are_split():
    m = one_lobe(20.0, 900.0)
    w = directions(*SIZE)[0] @ TURN.T
    theta_d = np.arccos(np.clip(w[..., 2], -1, 1)) / 2
    sharp = split_texels.sharpness_along(m)[0, 1].numpy()
    narrowest = split_texels.ANGLES[np.argmax(sharp > LIMITS[0])]
    result = parts(m)
    assert (result[theta_d > narrowest] == 2).all()
    assert (result[theta_d < narrowest - np.radians(6)] == 1).all()
    assert 0.1 < (result == 2).mean() < 0.6
    # by lobes and channels that count
    assert (parts(m, ALL & (torch.arange(3) != 1)) == 1).all()


def test_views_that_differ_split_more_texels():
    m = one_lobe(20.0, 900.0)
    alike = torch.tensor([[0.0, 0.0, 1.0]] * 2)
    far = torch.nn.functional.normalize(torch.tensor([[0.3, 0.0, 1.0], [-0.3, 0.0, 1.0]]), dim=1)
    distant = parts(m) == 2
    assert (distant == (parts(m, view=alike) == 2)).all()
    wide = parts(m, view=far) == 2
    assert (wide[distant]).all() and wide.sum() > 1.2 * distant.sum()
    # what each of the views needs by itself
    assert all((wide[parts(m, view=each[None]) == 2]).all() for each in far)


def test_parts_of_texels_have_their_light_and_lie_in_them():
    rng = np.random.default_rng(1)
    parts_of_each = rng.integers(1, 4, SIZE)
    light = torch.from_numpy(rng.random((*SIZE, 3))).requires_grad_()
    lights, energy = split_texels.lights_of(light, torch.from_numpy(TURN), parts_of_each)
    assert len(lights.w) == len(energy) == (parts_of_each**2).sum()
    whole = light * torch.from_numpy(directions(*SIZE)[1])[..., None]
    sums = np.zeros((*SIZE, 3))
    np.add.at(sums, texel(lights.w @ TURN, *SIZE), energy.detach().numpy())
    np.testing.assert_allclose(sums, whole.detach(), rtol=1e-9)
    energy.sum().backward()
    np.testing.assert_allclose(
        light.grad, np.broadcast_to(directions(*SIZE)[1][..., None], light.shape), rtol=1e-9
    )


@pytest.mark.parametrize("camera", ["orthographic", "perspective"])
@pytest.mark.parametrize("name", ["white-diffuse-bball", "gold-paint"])
def test_the_sum_over_few_split_texels_is_that_over_many(name, camera):
    light = chart_cases.computed_lights()["sun in a texel"]
    batch, leaves = chart_cases.batch_of(find(name).label, light, 32, camera, True)
    radiance = quadrature.radiance(batch, 1e-2)
    by_leaves = torch.autograd.grad(radiance.sum(), leaves, retain_graph=True)
    fine = replace(batch, light=batch.light.repeat_interleave(6, 1).repeat_interleave(6, 2))
    right = load("exact").radiance(fine, 1e-2)
    by_right = torch.autograd.grad(right.sum(), leaves)
    assert (radiance - right).abs().mean() < 3e-3 * right.mean()
    for a, b in zip(by_leaves, by_right, strict=True):
        assert (a - b).abs().sum() < 0.02 * b.abs().sum()
    sharp = quadrature.sharpness(batch.m.detach())[0]
    assert sharp.max() > LIMITS[0]
    few = split_texels.parts_of_texels(
        batch.m[0], sharp <= LIMITS[1], batch.view, SIZE, TURN, LIMITS, (1, 2)
    )
    assert 0 < (few == 2).mean() < 0.1


@pytest.mark.parametrize("at_matte, sums", [(20.0, 1), (900.0, 2)])
def test_a_matte_lobe_has_a_sum_of_its_own_where_most_texels_are_split(monkeypatch, at_matte, sums):
    m = one_lobe(at_matte, 900.0)
    m[:, 0, 0], m[:, 0, 1] = 0.3, 2.0
    light = chart_cases.computed_lights()["lamps"]
    batch, _ = chart_cases.batch_of(
        m.log().nan_to_num(neginf=-50).reshape(108), light, 24, "distant"
    )
    made, lights_of = [], split_texels.lights_of

    def counted(light, turn, parts):
        made.append(int((parts**2).sum()))
        return lights_of(light, turn, parts)

    monkeypatch.setattr(split_texels, "lights_of", counted)
    quadrature.radiance(batch, 1e-2)
    assert len(made) == sums and made[0] < 1.5 * SIZE[0] * SIZE[1]


def test_a_lobe_on_both_sides_of_the_limit_has_one_strategy_unless_a_channel_is_much_broader(
    monkeypatch,
):
    m = torch.full((3, 3, 2, 6), 1e-9)
    m[:, 1, 0] = 0.5
    m[:, 1, 1] = torch.tensor([2000.0, 1000.0, 500.0])[:, None]
    light = chart_cases.computed_lights()["lamps"]
    batch, _ = chart_cases.batch_of(m.log().reshape(108), light, 24, "distant")
    seen, over_texels = [], quadrature.sum_over_texels

    def noted(batch, lobes, *others):
        seen.append(lobes[0, :, 1].tolist())
        return over_texels(batch, lobes, *others)

    monkeypatch.setattr(quadrature, "sum_over_texels", noted)
    quadrature.radiance(batch, 1e-2)
    assert seen == [[False, False, True]]


def test_a_picture_does_not_depend_on_the_materials_beside_it():
    light = chart_cases.computed_lights()["sun in a texel"]
    each = [
        chart_cases.batch_of(find(name).label, light, 32, "orthographic")[0]
        for name in ("white-diffuse-bball", "pink-fabric", "gold-paint")
    ]
    alone = [quadrature.radiance(batch, 1e-2) for batch in each]
    together = replace(
        each[0],
        n=torch.cat([batch.n for batch in each]),
        m=torch.cat([batch.m for batch in each]),
        counts=tuple(len(batch.n) for batch in each),
        light_of=(0, 0, 0),
    )
    result = quadrature.radiance(together, 1e-2).split(together.counts)
    assert all(torch.equal(a, b) for a, b in zip(alone, result, strict=True))
