"""Bases of lights: what their sums are."""

import numpy as np
import pytest

from factory.render.estimators.relighting import sum_basis_pictures
from factory.render.validation.light_bases import cells, factors, harmonics
from manifests.arrays import LIGHT_SHAPE
from shaders import envmap

W, SOLID_ANGLE = envmap.directions(*LIGHT_SHAPE[:2])


def drawn(seed):
    return np.random.default_rng(seed).exponential(size=LIGHT_SHAPE).astype(np.float32)


@pytest.mark.parametrize("rows", [4, 8, 64])
def test_cells_keep_the_energy_of_each_part_of_a_light(rows):
    L, basis = drawn(0), cells(rows, 2 * rows)
    assert len(basis.maps) == 2 * rows * rows and np.all(basis.maps.sum(0) == 1)
    shown = basis.light(L)
    energies = [
        (each * SOLID_ANGLE[..., None])[: 64 // rows, : 64 // rows].sum((0, 1))
        for each in (L, shown)
    ]
    np.testing.assert_allclose(*energies, rtol=1e-4)
    assert np.allclose(shown, L, rtol=1e-4) == (rows == 64)


def test_harmonics_show_what_is_smooth_and_blur_the_rest():
    basis = harmonics()
    assert len(basis.maps) == 31 and basis.maps.min() == 0
    x, y, z = np.moveaxis(W, -1, 0)
    smooth = np.stack([2 + x, 1.5 + y * z + 0.3 * x * (x * x - 3 * y * y), 1 - z**3], axis=-1)
    np.testing.assert_allclose(basis.light(smooth.astype(np.float32)), smooth, atol=5e-3)
    L = drawn(1)
    difference = ((basis.light(L) - L) * SOLID_ANGLE[..., None]).sum((0, 1))
    np.testing.assert_allclose(difference, 0, atol=1e-2)
    assert not np.allclose(basis.light(L), L, atol=0.5)


def test_factors_find_the_maps_of_which_lights_are_made():
    parts = [drawn(k)[..., 0] for k in range(3)]
    rng = np.random.default_rng(9)
    mixed = [np.einsum("b,bhw->hw", rng.uniform(size=3), parts) for _ in range(15)]
    lights = [np.stack(mixed[k : k + 3], axis=-1).astype(np.float32) for k in range(0, 15, 3)]
    basis = factors(lights, 3)
    assert basis.maps.shape == (3, 64, 128) and basis.maps.min() >= 0
    for L in lights:
        assert np.abs(basis.light(L) - L).mean() < 0.05 * L.mean()
    with pytest.raises(ValueError, match="not enough values"):
        basis.weights(lights[0].copy())


def test_a_picture_under_a_light_is_the_sum_of_pictures_under_the_basis():
    """A surface that takes in two texels: its picture under any light is linear in them."""
    basis = cells(8, 16)
    L = basis.light(drawn(3))
    (one, other), share = ((20, 30), (40, 90)), np.array([0.7, 0.2, 0.1], np.float32)

    def picture(of):
        return (of[one] + 2 * of[other]) * share[None, None]

    under_maps = np.stack([picture(np.repeat(each[..., None], 3, -1)) for each in basis.maps])
    np.testing.assert_allclose(
        sum_basis_pictures(under_maps, basis.weights(L)), picture(L), rtol=1e-4
    )
    negative = sum_basis_pictures(under_maps, -basis.weights(L))
    assert negative.shape == (1, 1, 3) and np.all(negative == 0)
