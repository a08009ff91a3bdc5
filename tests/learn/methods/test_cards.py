"""Every method keeps what its card claims, on three materials under three lights, from far and from near."""

import functools

import pytest
import torch
from card_scenes import LIGHTS, MATERIALS, light, material, perspective, sphere

from learn import methods
from learn.layer import render

TOLERANCE = 1e-2
CAMERAS = ("orthographic", "perspective")


def scene(camera, m, L):
    n = sphere()
    return {"n": n, "material": material(*MATERIALS[m]), "light": light(L), "view": perspective() if camera == "perspective" else None}


def rendered(scene, method):
    """Picture and derivatives of a weighted sum of it, float64."""
    leaves = {key: value.detach().clone().requires_grad_() for key, value in scene.items() if value is not None}
    seen = render(**leaves, method=method, tolerance=TOLERANCE)
    (seen * torch.linspace(0.5, 1.5, seen.numel(), dtype=seen.dtype).reshape(seen.shape)).sum().backward()
    return seen.detach().double(), {key: leaf.grad.double() for key, leaf in leaves.items()}


@functools.cache
def exact(camera, m, L):
    """The paper's sum of a scene in float64, computed once for all methods."""
    return rendered({key: None if value is None else value.double() for key, value in scene(camera, m, L).items()}, "exact")


def distance(found, right):
    return ((found - right).abs().mean() / right.abs().mean()).item()


def cameras(card):
    return CAMERAS[:1] if "orthographic" in card.needs else CAMERAS


@pytest.mark.parametrize("name", methods.NAMES)
def test_error_and_derivatives_are_within_the_cards_claims(name):
    card = methods.load(name).CARD
    assert card.name == name
    for camera in cameras(card):
        for m in MATERIALS:
            for L in LIGHTS:
                given = scene(camera, m, L)
                (seen, slopes), (truth, true_slopes) = rendered(given, name), exact(camera, m, L)
                if card.error is not None:
                    # float32 takes up to 1e-5 of its own
                    assert distance(seen, truth) <= card.error + 1e-5, (camera, m, L)
                for key, slope in slopes.items():
                    assert slope.isfinite().all(), (camera, m, L, key)
                    if card.gradient is not None:
                        assert distance(slope, true_slopes[key]) <= card.gradient + 1e-5, (camera, m, L, key)


@pytest.mark.parametrize("name", methods.NAMES)
def test_a_card_says_what_it_does(name):
    card = methods.load(name).CARD
    assert card.approximates and card.cost and card.memory and card.needs <= {"orthographic", "numba", "triton", "cuda"}


def test_a_method_for_distant_viewers_says_so():
    with pytest.raises(ValueError, match=r"reflectance_map.*orthographic"):
        render(**scene("perspective", "matte", "sky"), method="reflectance_map")


@pytest.mark.parametrize("name", [n for n in methods.NAMES if not n.startswith("monte_carlo")])
def test_tighter_tolerances_do_not_make_a_method_worse(name):
    given = scene("orthographic", "satin", "lamps")
    truth, _ = exact("orthographic", "satin", "lamps")
    loose, tight = (distance(render(**given, method=name, tolerance=t).double(), truth) for t in (5e-2, 1e-3))
    assert tight <= 1.2 * loose + 1e-5


def test_monte_carlo_comes_nearer_with_more_samples():
    given = scene("orthographic", "satin", "lamps")
    truth = render(**given, method="quadrature", tolerance=1e-4).double()
    for name in ("monte_carlo", "monte_carlo_brdf", "monte_carlo_light"):
        few, many = (distance(render(**given, method=name, tolerance=t).double(), truth) for t in (2.5e-1, 4e-3))
        assert many < 0.5 * few, name  # 64 times the samples: an eighth, and half is far outside chance over 250 pixels
