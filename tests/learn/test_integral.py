"""The converged integral against references that share no line with the half-vector taps: a closed
form, and each texel integrated alone.

The second walks over directions w in the map's own coordinates, texel by texel, by Gauss–Legendre
nodes a fraction of the lobe apart, in float64 and in numpy; the taps walk over half vectors about
the normal. What one gets wrong (a Jacobian, a border, a lobe's tail), the other does not share.
"""

import math

import numpy as np
import pytest
import torch

from learn.layer import render
from shaders.dsbrdf import evaluate, half_angles
from shaders.frames import ELEVATION, camera_from_light

SHARP = [310.0, 1.3e3, 5e3, 3e4, 1e5]
VIEWER = np.array([0.0, 0.0, 1.0])


def lobe(kappa, gamma):
    """(3, 3, 2, 6) one lobe, its κ a little different in each channel."""
    m = np.zeros((3, 3, 2, 6))
    m[:, :, 1] = 1.0
    m[:, 1, 0], m[:, 1, 1] = kappa * np.array([1.0, 0.8, 0.6])[:, None], gamma
    return m


def seen(m, n, light, view=None, dtype=torch.float32, **options):
    """(P, 3) by the quadrature, of normals (P, 3)."""
    given = {"n": n[None, None], "material": m.reshape(1, 108), "light": light[None]} | (
        {} if view is None else {"view": view[None, None]}
    )
    given = {name: torch.as_tensor(value, dtype=dtype) for name, value in given.items()}
    return render(**given, method="quadrature", **options)[0, 0].double().numpy()


def head_on(kappa, gamma):
    """Radiance at n = v under a uniform light 1, κ and γ constant over θ_d.

    With c = cos θ_h: w leans by 2 θ_h, dω = 4 c dω_h, so ∫ (e^{κ c^γ} − 1) (2c² − 1) 4 c · 2π dc
    over c from √½ to 1, term by term of e^x.
    """
    j = np.arange(1, 60)
    power, height = j * gamma, np.cumprod(kappa / j)

    def integral(p):
        return (1 - 2.0 ** (-p / 2)) / p

    return 8 * math.pi * (height * (2 * integral(power + 4) - integral(power + 2))).sum()


@pytest.mark.parametrize("gamma", [0.01, 1.0, 100.0, *SHARP])
@pytest.mark.parametrize("kappa", [0.01, 1.0, 8.0])
def test_head_on_radiance_is_the_closed_form(kappa, gamma):
    right = np.array([head_on(k, gamma) for k in (kappa, 0.8 * kappa, 0.6 * kappa)])
    result = seen(lobe(kappa, gamma), VIEWER[None], np.ones((64, 128, 3)))[0]
    # the sum over texels up to an exponent of 300 is right to that; taps to less
    np.testing.assert_allclose(result, right, rtol=3e-3)


@pytest.mark.parametrize("gamma", SHARP)
def test_a_map_lit_on_one_side_gives_half_the_closed_form(gamma):
    light = np.zeros((64, 128, 3))
    light[:32] = 1.0  # all above the horizontal plane, which halves the lobe about v
    result = seen(lobe(1.0, gamma), VIEWER[None], light, elevation=0.0)[0]
    np.testing.assert_allclose(result[0], 0.5 * head_on(1.0, gamma), rtol=1e-2)


def texel_by_texel(m, n, v, light, gamma, nodes=4):
    """Radiance (3,) of one pixel: every texel within 9 standard deviations of the highlight by
    Gauss–Legendre.
    """
    height, width = light.shape[:2]
    rotation = camera_from_light(ELEVATION)
    sigma = 2 / math.sqrt(gamma)
    mirror = (2 * (n @ v) * n - v) @ rotation  # light frame
    parts = math.ceil(math.pi / height / (0.75 * sigma))
    x, weight = np.polynomial.legendre.leggauss(nodes)
    inside, weight = (
        ((np.arange(parts)[:, None] + 0.5 * (x + 1)) / parts).ravel(),
        np.tile(0.5 * weight / parts, parts),
    )
    reach = 9 * sigma + 2 * math.pi / height
    total = np.zeros(3)
    for i in range(height):
        theta = math.pi * (i + inside) / height
        if np.abs(theta - math.acos(np.clip(mirror[1], -1, 1))).min() > reach:
            continue
        for j in range(width):
            phi = 2 * math.pi * (j + inside) / width
            w = directions(theta[:, None], phi[None])
            if (w @ mirror).max() < math.cos(min(reach, math.pi)):
                continue
            w = w.reshape(-1, 3) @ rotation.T
            h, theta_d = half_angles(w, np.broadcast_to(v, w.shape))
            f = evaluate(m, h @ n, theta_d)
            d_omega = (
                np.outer(weight * np.sin(theta), weight)
                * (math.pi / height)
                * (2 * math.pi / width)
            )
            total += light[i, j] * (np.maximum(w @ n, 0) * d_omega.ravel() @ f)
    return total


def directions(theta, phi):
    sine = np.sin(theta)
    return np.stack([np.cos(phi) * sine, np.cos(theta) * np.ones_like(phi), np.sin(phi) * sine], -1)


def pixels(rng, count):
    n = rng.normal(size=(count, 3)) * 0.5 + VIEWER
    v = rng.normal(size=(count, 3)) * 0.1 + VIEWER
    n[:, 2] = np.abs(n[:, 2]) + 0.2
    return n / np.linalg.norm(n, axis=1, keepdims=True), v / np.linalg.norm(
        v, axis=1, keepdims=True
    )


def test_the_reference_itself_is_converged_and_knows_the_closed_form():
    light = np.random.default_rng(1).random((64, 128, 3)) ** 4
    n, v = (a[0] for a in pixels(np.random.default_rng(2), 1))
    for gamma in (5e3, 1e5):
        coarse, fine = (
            texel_by_texel(lobe(1.0, gamma), n, v, light, gamma, nodes) for nodes in (4, 7)
        )
        np.testing.assert_allclose(coarse, fine, rtol=1e-6)
        head = texel_by_texel(lobe(1.0, gamma), VIEWER, VIEWER, np.ones((64, 128, 3)), gamma)
        np.testing.assert_allclose(head[0], head_on(1.0, gamma), rtol=1e-6)


@pytest.mark.parametrize("sun", [False, True], ids=["texels", "sun in one"])
@pytest.mark.parametrize("gamma", [5e3, 3e4, 1e5])
def test_lobes_narrower_than_a_texel_are_those_of_texels_integrated_alone(gamma, sun):
    rng = np.random.default_rng(7)
    light, (n, v) = rng.random((64, 128, 3)) ** 4, pixels(rng, 10)
    if sun:  # at the highlight of half of the pixels, beside its middle
        light[:] = 0.4
        light[20, 40] = 2e4
        w = (
            directions(
                math.pi * (20 + rng.random(5)) / 64, 2 * math.pi * (40 + rng.random(5)) / 128
            )
            @ camera_from_light(ELEVATION).T
        )
        n[:5] = half_angles(w, v[:5])[0]
    m = lobe(1.0, gamma)
    right = np.stack([texel_by_texel(m, *pixel, light, gamma) for pixel in zip(n, v, strict=True)])
    # the last: rounding of n to float32 is 1e-4 of a lobe's width
    for tolerance, bound in ((1e-2, 1e-2), (1e-3, 2e-3), (1e-4, 1e-3)):
        result = seen(m, n, light, v, tolerance=tolerance)
        assert np.abs(result - right).mean() <= bound * right.mean(), tolerance
