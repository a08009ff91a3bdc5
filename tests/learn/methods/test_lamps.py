"""Lamps of few texels, which samples that follow narrow lobes may miss."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from learn.experiments.layer import chart_cases
from learn.experiments.layer.quadrature_materials import sun_at
from learn.methods import lamps, load, quadrature
from learn.methods.directional import sample
from manifests.materials import find
from shaders.envmap import directions
from shaders.frames import ELEVATION, camera_from_light

TURN = camera_from_light(ELEVATION)
ALL = torch.ones(3, 3, dtype=torch.bool)
SIZE = 64, 128


def small_batch(name, camera, light, **others):
    """A batch of pixels all over a picture of 32², the brightest among them, and its leaves."""
    batch, leaves = chart_cases.batch_of(find(name).label, light, 32, camera, **others)
    bright = load("exact").radiance(batch, 1e-2).sum(-1).argsort(descending=True)
    pick = torch.cat([sample(len(batch.n), 32), bright[:16]])
    view = None if batch.view is None else batch.view[pick]
    return replace(batch, n=batch.n[pick], view=view, counts=(len(pick),)), leaves


def one_lobe(gamma):
    m = torch.full((3, 3, 2, 6), 1e-9)
    m[:, 1, 0], m[:, 1, 1] = 0.5, gamma
    return m


def by_texels(batch, parts=16):
    fine = batch.light.repeat_interleave(parts, 1).repeat_interleave(parts, 2)
    return load("exact").radiance(replace(batch, light=fine), 1e-2)


# without lamps of their own these err by 25, 17, 9 and 6 %
@pytest.mark.parametrize(
    "name, camera",
    [
        ("black-fabric", "perspective"),
        ("dark-specular-fabric", "perspective"),
        ("black-fabric", "orthographic"),
        ("dark-specular-fabric", "orthographic"),
    ],
)
def test_a_sun_behind_the_shape_is_seen_at_its_rim(name, camera):
    batch, _ = small_batch(name, camera, sun_at(125))
    right = by_texels(batch)
    radiance = quadrature.radiance(batch, 1e-2)
    assert (radiance - right).abs().mean() < 5e-3 * right.mean()  # half of the tolerance


def test_a_lamp_at_a_small_tolerance_is_split_for_lobes_that_whole_texels_serve():
    # by whole texels of the fine map this errs by 1.4 %
    batch, _ = small_batch("color-changing-paint3", "perspective", sun_at(125))
    fine = replace(batch, light=batch.light.repeat_interleave(4, 1).repeat_interleave(4, 2))
    assert quadrature.sharpness(batch.m).max() < quadrature.BROAD * 4**2
    right = by_texels(batch, 32)
    assert (quadrature.radiance(fine, 1e-4) - right).abs().mean() < 5e-4 * right.mean()


def test_derivatives_by_light_and_normals_contain_lamps():
    batch, (n, _, light) = small_batch(
        "black-fabric", "perspective", sun_at(125), with_gradients=True
    )
    radiance, right = quadrature.radiance(batch, 1e-2), by_texels(batch)
    ours, others = (
        torch.autograd.grad(each.sum(), [n, light], retain_graph=True) for each in (radiance, right)
    )
    for one, other in zip(ours, others, strict=True):
        assert (one - other).abs().sum() < 0.03 * other.abs().sum()


def test_lamps_come_by_their_energy_and_smooth_light_has_none():
    light = np.ones((8, 16, 3))
    assert len(lamps.brightest(light, 0.03)) == 0
    light[4, 3], light[2, 5, 1], light[0, 7] = 50, 80, 15  # the last is a small texel at the pole
    assert lamps.brightest(light, 0.03).tolist() == [2 * 16 + 5, 4 * 16 + 3]
    # by radiance alone it would be one
    assert light[0, 7].max() > 0.03 * light.max(-1).sum()


@pytest.mark.parametrize(
    "gamma, tolerance, parts", [(100, 1e-2, 1), (2e4, 1e-2, 16), (100, 1e-3, 4), (2e4, 1e-4, 0)]
)
def test_lamps_are_split_by_sharpness_and_tolerance(gamma, tolerance, parts):
    light, m = torch.from_numpy(sun_at(90)), one_lobe(gamma)
    assert lamps.parts_of(light, m, ALL, None, TURN, tolerance).max() == parts


def test_many_lamps_are_split_until_their_parts_are_a_quarter_of_the_texels():
    light, m = torch.full((*SIZE, 3), 0.01), one_lobe(2e4)
    light[20:30, 10:20] = torch.linspace(40, 60, 100).reshape(10, 10, 1)
    parts = lamps.parts_of(light, m, ALL, None, TURN, 1e-2)
    split = parts > 0
    assert 0.25 * parts.size <= (parts**2).sum() <= 0.25 * parts.size + parts.max() ** 2
    energy = light.numpy().max(-1) * directions(*SIZE)[1]
    assert energy[split].min() > np.median(energy[20:30, 10:20])
