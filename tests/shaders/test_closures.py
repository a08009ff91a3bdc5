"""Claims of shaders.closures: normalised distributions, reciprocity, tilts that are plain vector
geometry, torch passing through.
"""

import numpy as np
import pytest

from shaders import closures
from tests.support.bsdf_directions import cosines, directions

WIDTHS = (0.02, 0.1, 0.4, 0.9)


def polar_integral(values, theta):
    """∫ values dω over the hemisphere, trapezoidal in θ."""
    y = values * 2 * np.pi * np.sin(theta)
    return float(((y[1:] + y[:-1]) / 2 * np.diff(theta)).sum())


@pytest.mark.parametrize("alpha", WIDTHS)
@pytest.mark.parametrize("kind", ["ggx", "beckmann", "sheen"])
def test_the_distribution_of_projected_microfacets_integrates_to_one(kind, alpha):
    theta = np.pi / 2 * np.linspace(1e-4, 1, 200_001) ** 2
    cos_h = np.maximum(np.cos(theta), 1e-9)
    distribution = 4 * closures.CLOSURES[kind](
        alpha, np.ones_like(cos_h), 1.0, cos_h, 1e-4 * np.ones_like(cos_h)
    )
    # light and view at the normal have no shadowing, so 4 f = D; 1e-4: trapezoids on 2e5 intervals,
    # and what lies below 1e-8 rad
    assert polar_integral(distribution * cos_h, theta) == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("alpha", WIDTHS)
def test_ashikhmin_shirleys_half_vector_density_integrates_to_one(alpha):
    theta = np.pi / 2 * np.linspace(1e-4, 1, 200_001) ** 2
    cos_h = np.maximum(np.cos(theta), 1e-9)
    density = 4 * closures.ashikhmin_shirley(
        alpha, np.ones_like(cos_h), 1.0, cos_h, np.ones_like(cos_h)
    )
    assert polar_integral(density, theta) == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("kind", closures.CLOSURES)
def test_light_and_view_may_be_exchanged(kind, rng):
    cos_i, cos_o, cos_h, cos_d = cosines(*directions(rng))
    there = closures.CLOSURES[kind](0.3, cos_i, cos_o, cos_h, cos_d)
    back = closures.CLOSURES[kind](0.3, cos_o, cos_i, cos_h, cos_d)
    np.testing.assert_allclose(there, back, rtol=1e-12)


@pytest.mark.parametrize("tilt", [-0.3, 0.2, 0.6])
def test_tilted_cosines_are_those_of_the_tilted_vector(tilt, rng):
    n, w_i, w_o = directions(rng)
    across = w_o - (w_o @ n)[:, None] * n
    n_tilted = n + tilt * across
    n_tilted /= np.linalg.norm(n_tilted, axis=-1, keepdims=True)
    *result, seen = closures.tilt_cosines(tilt, *cosines(n, w_i, w_o))
    expected = cosines(n_tilted, w_i, w_o)[:3]
    assert np.array_equal(seen, (expected[0] > 1e-4) & (expected[1] > 1e-4) & (expected[2] > 1e-4))
    for a, b in zip(result, expected, strict=True):
        np.testing.assert_allclose(a[seen], b[seen], atol=1e-12)


def test_a_tilt_of_nothing_changes_nothing(rng):
    c = cosines(*directions(rng))
    for kind in closures.CLOSURES:
        np.testing.assert_allclose(
            closures.evaluate(kind, 0.3, 0.0, *c), closures.CLOSURES[kind](0.3, *c), rtol=1e-12
        )


def test_a_tilted_matte_surface_reflects_by_its_own_cosine(rng):
    n, w_i, w_o = directions(rng)
    c = cosines(n, w_i, w_o)
    cos_tilted, _, _, seen = closures.tilt_cosines(0.4, *c)
    np.testing.assert_allclose(
        (closures.evaluate("diffuse", 1.0, 0.4, *c) * c[0])[seen],
        (cos_tilted / np.pi)[seen],
        rtol=1e-12,
    )


def test_light_behind_the_tilted_normal_gives_nothing():
    n, w_o = np.array([0.0, 0.0, 1.0]), np.array([np.sin(1.4), 0, np.cos(1.4)])
    w_i = np.array([-np.sin(1.5), 0, np.cos(1.5)])
    c = [np.array([x]) for x in cosines(n, w_i[None], w_o[None])]
    assert closures.evaluate("ggx", 0.5, 0.6, *(np.ravel(x) for x in c)) == 0


@pytest.mark.parametrize("kind", closures.CLOSURES)
def test_torch_gives_the_same_numbers(kind, rng):
    torch = pytest.importorskip("torch")
    c = cosines(*directions(rng))
    expected = closures.evaluate(kind, 0.2, 0.3, *c)
    result = closures.evaluate(
        kind,
        torch.tensor(0.2, dtype=torch.float64),
        torch.tensor(0.3, dtype=torch.float64),
        *map(torch.tensor, c),
    )
    np.testing.assert_allclose(result.numpy(), expected, rtol=1e-12)
