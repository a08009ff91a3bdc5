"""The adapter from predicted tensors to pictures: regions, policies, derivatives."""

import numpy as np
import pytest
import torch

from learn.figures.spheres import sphere_normals
from learn.layer import predictions, render
from learn.metrics.pictures import compare, display_l2
from manifests.materials import find
from shaders.frames import ELEVATION

SIZE = 12


@pytest.fixture
def scene(rng):
    """Normals (1, 3, H, W), light (1, 3, 8, 16) and segments (1, H, W) of a sphere."""
    n = torch.from_numpy(sphere_normals(SIZE)).movedim(-1, 0)[None]
    light = torch.from_numpy(rng.random((1, 3, 8, 16), np.float32))
    return n, light, (n != 0).any(1).long()


def label_of(*names):
    return torch.from_numpy(np.stack([find(name).label.reshape(-1) for name in names])).float()[
        None
    ]


def test_two_regions_of_one_material_look_like_one_region(scene):
    n, light, segments = scene
    halves = segments + (segments > 0) * (torch.arange(SIZE) % 2)
    one = predictions.picture(n, label_of("red-fabric"), light, segments, ELEVATION)
    two = predictions.picture(n, label_of("red-fabric", "red-fabric"), light, halves, ELEVATION)
    assert one[0][segments[0] > 0].min() > 0 and not one[0][segments[0] == 0].any()
    torch.testing.assert_close(one, two)


def test_regions_have_the_material_of_their_own_number(scene):
    n, light, segments = scene
    halves = segments + (segments > 0) * (torch.arange(SIZE) % 2)
    each = [
        predictions.picture(n, label_of(name), light, segments, ELEVATION)
        for name in ("red-fabric", "blue-rubber")
    ]
    both = predictions.picture(n, label_of("red-fabric", "blue-rubber"), light, halves, ELEVATION)
    for number, alone in enumerate(each, 1):
        torch.testing.assert_close(both[halves == number], alone[halves == number])
    assert (each[0] - each[1]).abs().max() > 0.01


@pytest.mark.parametrize(
    ("name", "method"), [("red-fabric", "auto"), ("chrome-steel", "quadrature")]
)
def test_what_is_shown_is_rendered_as_its_material_requires(scene, name, method):
    n, light, segments = scene
    shown = predictions.picture(n, label_of(name), light, segments, ELEVATION, predictions.SHOWN)
    expected = render(
        n.movedim(1, -1),
        label_of(name)[:, 0].exp(),
        light.movedim(1, -1),
        method=method,
        tolerance=predictions.SHOWN.tolerance,
    )
    torch.testing.assert_close(shown, expected, rtol=0, atol=0)


def test_radiance_has_derivatives_in_every_part_and_a_picture_has_none(scene):
    n, light, segments = scene
    parts = [x.clone().requires_grad_() for x in (n.movedim(1, -1), label_of("red-fabric"), light)]
    radiance = predictions.radiance(
        *parts, segments, segments > 0, ELEVATION, predictions.PIXEL_LOSS
    )
    for derivative in torch.autograd.grad(radiance.sum(), parts):
        assert derivative.isfinite().all() and derivative.abs().max() > 0
    picture = predictions.picture(
        parts[0].movedim(-1, 1), *parts[1:], segments, ELEVATION, predictions.PIXEL_LOSS
    )
    assert not picture.requires_grad
    torch.testing.assert_close(picture, radiance.detach())


def test_display_l2_is_what_a_comparison_says(rng):
    truth, picture = rng.random((2, 9, 9, 3))
    mask = rng.random((9, 9)) < 0.5
    figures = compare(picture, truth, mask)
    assert display_l2(picture, truth, mask) == figures["l2"]
    assert display_l2(picture, truth, mask, frame=True) == figures["l2_frame"]
    assert figures["l2"] != figures["l2_frame"]
