"""Environment maps: the sphere is covered once, turning is turning, and no size of map gains or
loses light.
"""

import numpy as np
import pytest

from shaders import envmap

SIZES = [(64, 128), (1, 2), (7, 9), (512, 1024)]


@pytest.mark.parametrize("size", SIZES)
def test_solid_angles_cover_the_sphere_exactly_once(size):
    assert envmap.directions(*size)[1].sum() == pytest.approx(4 * np.pi, rel=1e-14)


def test_a_texels_solid_angle_is_the_integral_of_sin_theta_over_it():
    fine = (np.arange(6400) + 0.5) * np.pi / 6400
    integral = np.sin(fine).reshape(64, 100).sum(1) * (np.pi / 6400) * (2 * np.pi / 128)
    # midpoint rule with 100 steps a row: (π/6400)²/24 relative
    np.testing.assert_allclose(envmap.row_solid_angles(64, 128), integral, rtol=2e-8)


@pytest.mark.parametrize("size", SIZES)
def test_directions_are_unit_and_balance_to_zero(size):
    w, solid_angle = envmap.directions(*size)
    np.testing.assert_allclose(np.linalg.norm(w, axis=-1), 1.0, rtol=1e-14)
    np.testing.assert_allclose((w * solid_angle[..., None]).sum((0, 1)), 0.0, atol=1e-12)


def test_the_first_row_is_the_zenith_and_columns_run_from_right_to_the_viewer():
    w, _ = envmap.directions(64, 128)
    assert w[0, 0, 1] > 0.999 and w[-1, 0, 1] < -0.999
    np.testing.assert_allclose(w[32, 0], [1, 0, 0], atol=0.05)
    np.testing.assert_allclose(w[32, 32], [0, 0, 1], atol=0.05)


@pytest.mark.parametrize("size", [(64, 128), (7, 9)])
def test_texel_finds_the_place_that_directions_came_from(size):
    w, _ = envmap.directions(*size)
    rows, columns = np.indices(size)
    result = envmap.texel(w, *size)
    np.testing.assert_array_equal(result[0], rows)
    np.testing.assert_array_equal(result[1], columns)


def test_texel_holds_at_poles_and_on_both_sides_of_the_seam():
    assert envmap.texel(np.array([0.0, 1.0, 0.0]), 64, 128) == (0, 0)
    assert envmap.texel(np.array([0.0, -1.0, 0.0]), 64, 128)[0] == 63
    assert envmap.texel(np.array([1.0, 0.0, 1e-9]), 64, 128)[1] == 0
    assert envmap.texel(np.array([1.0, 0.0, -1e-9]), 64, 128)[1] == 127


def irradiance(L, n):
    """∫ L max(0, n·w) dw over the texels, (3,)."""
    w, solid_angle = envmap.directions(*L.shape[:2])
    return np.einsum("ijk,ij->k", L, np.maximum(w @ n, 0) * solid_angle)


def test_irradiance_of_a_constant_light_is_pi(rng):
    for n in rng.normal(size=(5, 3)):
        # texel centres at the cosine's edge: error falls with the square of the texel, π/64
        np.testing.assert_allclose(
            irradiance(np.ones((64, 128, 3)), n / np.linalg.norm(n)), np.pi, rtol=1e-3
        )


@pytest.mark.parametrize("texels", [1, 17, 128, -5])
def test_rolling_the_map_is_turning_the_light(rng, texels):
    L = rng.uniform(0, 1, (64, 128, 3))
    n = np.array([0.5, 0.3, np.sqrt(1 - 0.34)])
    angle = 2 * np.pi * texels / 128  # φ grows from +x to +z
    c, s = np.cos(angle), np.sin(angle)
    n_turned = np.array([c * n[0] - s * n[2], n[1], s * n[0] + c * n[2]])
    np.testing.assert_allclose(
        irradiance(envmap.roll(L, texels), n_turned), irradiance(L, n), rtol=1e-12
    )


def test_rolling_a_tensor_is_rolling_the_array(rng):
    torch = pytest.importorskip("torch")
    L = rng.uniform(0, 1, (2, 4, 8, 3))
    np.testing.assert_array_equal(envmap.roll(torch.tensor(L), 3).numpy(), envmap.roll(L, 3))


@pytest.mark.parametrize("target", [(64, 128), (32, 64), (50, 33), (200, 512), (1, 1)])
def test_resizing_keeps_the_mean_radiance(rng, target):
    L = rng.lognormal(0, 3, (90, 180, 3))
    np.testing.assert_allclose(
        envmap.mean_radiance(envmap.resize(L, *target)), envmap.mean_radiance(L), rtol=1e-12
    )


def test_resizing_keeps_the_energy_of_each_region(rng):
    """A texel of the small map holds the light of exactly the texels that lie in it, one bright
    lamp included.
    """
    L = rng.lognormal(0, 3, (256, 512, 3))
    solid_angle = envmap.directions(256, 512)[1][..., None]
    energy = (L * solid_angle).reshape(64, 4, 128, 4, 3).sum((1, 3))
    small = envmap.resize(L, 64, 128) * envmap.directions(64, 128)[1][..., None]
    np.testing.assert_allclose(small, energy, rtol=1e-12)


def test_enlarging_and_shrinking_again_gives_the_map_back(rng):
    L = rng.uniform(0, 5, (16, 32, 3))
    np.testing.assert_allclose(envmap.resize(envmap.resize(L, 64, 128), 16, 32), L, rtol=1e-12)


def test_resizing_never_leaves_the_range_of_the_map(rng):
    L = rng.uniform(2, 5, (33, 66, 3))
    for size in ((64, 128), (20, 41)):
        small = envmap.resize(L, *size)
        assert small.min() >= L.min() - 1e-12 and small.max() <= L.max() + 1e-12


def test_unit_mean_has_mean_luminance_one_and_its_scale_gives_the_map_back(rng):
    L = rng.lognormal(2, 2, (64, 128, 3))
    scaled, scale = envmap.unit_mean(L)
    # float32 texels
    assert envmap.mean_radiance(scaled) @ envmap.LUMINANCE == pytest.approx(1.0, rel=1e-6)
    np.testing.assert_allclose(scaled * scale, L, rtol=1e-6)
    assert envmap.LUMINANCE.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_map_without_light_cannot_be_scaled(value):
    with pytest.raises(ValueError, match="expected positive finite mean luminance"):
        envmap.unit_mean(np.full((4, 8, 3), value))


def test_a_copy_turned_scaled_and_rounded_is_the_same_capture_and_another_map_is_not(rng):
    L, other = (np.exp(rng.standard_normal((16, 32, 3))) for _ in range(2))
    copy = envmap.roll(3 * L.astype(np.float16).astype(float), 5)
    assert envmap.likeness(L, copy) > 0.9999  # half floats keep three digits
    assert envmap.is_same_source(L, copy) and not envmap.is_same_source(L, other)
    assert not envmap.is_same_source(L, L[::-1])  # upside down is another light
