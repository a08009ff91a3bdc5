"""The label's BRDF: reciprocal, never negative, exact for weak lobes, finite for strong ones."""

import numpy as np
import pytest

from shaders import dsbrdf


def constant_material(kappa, gamma):
    """m (3, 3, 2, 6) with the same κ (3,) and γ (3,) a lobe at every angle and in every channel."""
    m = np.empty(dsbrdf.SHAPE)
    m[:, :, 0] = np.asarray(kappa, dtype=float)[:, None]
    m[:, :, 1] = np.asarray(gamma, dtype=float)[:, None]
    return m


def unit(rng, count, above=False):
    w = rng.normal(size=(count, 3))
    if above:
        w[:, 2] = np.abs(w[:, 2])
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


def test_the_label_has_the_papers_108_numbers():
    assert dsbrdf.SIZE == 108


def test_the_formula_is_the_sum_of_three_exponential_lobes():
    c = np.array([0.2, 0.9, 1.0])
    kappa, gamma = [0.3, 1.1, 0.02], [0.5, 40.0, 3.0]
    expected = sum(np.exp(k * c**g) - 1 for k, g in zip(kappa, gamma, strict=True))
    f = dsbrdf.evaluate(constant_material(kappa, gamma), c, np.full(3, 0.4))
    np.testing.assert_allclose(f, np.repeat(expected[:, None], 3, axis=1), rtol=1e-13)


def test_flat_and_shaped_labels_give_the_same_values(rng):
    m, c, theta_d = rng.uniform(0.1, 2, dsbrdf.SHAPE), rng.uniform(0, 1, 9), rng.uniform(0, 1.5, 9)
    np.testing.assert_array_equal(
        dsbrdf.evaluate(m.ravel(), c, theta_d), dsbrdf.evaluate(m, c, theta_d)
    )


def test_control_values_act_where_their_angle_is(rng):
    """κ rises from 0 at normal incidence to 2 at grazing: the BRDF is 0 at θ_d = 0 and e² − 1 at
    π/2, h = n.
    """
    m = constant_material([0, 0, 0], [1, 1, 1])
    m[:, 1, 0] = np.linspace(0, 2, 6)
    np.testing.assert_allclose(
        dsbrdf.evaluate(m, np.ones(2), np.array([0, np.pi / 2]))[:, 0],
        [0, np.expm1(2.0)],
        rtol=1e-14,
    )


def test_light_and_viewer_may_change_places(rng):
    m = rng.uniform(0.05, 2.0, dsbrdf.SHAPE)
    w_i, w_o, n = unit(rng, 50, above=True), unit(rng, 50, above=True), np.array([0.0, 0.0, 1.0])
    values = []
    for a, b in ((w_i, w_o), (w_o, w_i)):
        h, theta_d = dsbrdf.half_angles(a, b)
        values.append(dsbrdf.evaluate(m, h @ n, theta_d))
    np.testing.assert_allclose(values[0], values[1], rtol=1e-12)
    assert (values[0] >= 0).all()


def test_theta_d_is_the_angle_between_light_and_half_vector(rng):
    w_i, w_o = unit(rng, 200), unit(rng, 200)
    h, theta_d = dsbrdf.half_angles(w_i, w_o)
    np.testing.assert_allclose(np.linalg.norm(h, axis=-1), 1.0, rtol=1e-13)
    # the paper's acos form; acos loses half the digits near 1, random directions stay away from it
    np.testing.assert_allclose(theta_d, np.arccos(np.clip((w_i * h).sum(-1), 0, 1)), atol=1e-7)


def test_theta_d_is_exact_for_nearly_equal_directions_where_acos_is_blind():
    angle = 1e-9
    w_i, w_o = np.array([0.0, 0.0, 1.0]), np.array([np.sin(angle), 0.0, np.cos(angle)])
    assert dsbrdf.half_angles(w_i, w_o)[1] == pytest.approx(angle / 2, rel=1e-9)
    assert np.arccos(min(1.0, w_i @ dsbrdf.half_angles(w_i, w_o)[0])) == 0.0


def test_differentiable_half_angles_agree_and_have_finite_slopes_where_directions_meet(rng):
    w_i, w_o = unit(rng, 200), unit(rng, 200)
    for ours, theirs in zip(
        dsbrdf.differentiable_half_angles(w_i, w_o), dsbrdf.half_angles(w_i, w_o), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13)
    torch = pytest.importorskip("torch")
    w = torch.tensor([[0.0, 0.6, 0.8]], dtype=torch.float64, requires_grad=True)
    h, theta_d = dsbrdf.differentiable_half_angles(w, w.detach())
    (h.sum() + theta_d.sum()).backward()
    assert w.grad.isfinite().all()


def test_opposite_directions_have_no_half_vector_and_a_right_angle():
    h, theta_d = dsbrdf.half_angles(np.array([0.0, 0.6, 0.8]), np.array([0.0, -0.6, -0.8]))
    np.testing.assert_array_equal(h, [0, 0, 0])
    assert theta_d == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_weak_lobe_keeps_its_digits(dtype):
    """exp(κ) − 1 of κ = 1e-9 is 0 in float32 if written as printed; expm1 keeps all digits."""
    m = constant_material([1e-9, 0, 0], [1, 1, 1]).astype(dtype)
    f = dsbrdf.evaluate(m, np.ones(1, dtype=dtype), np.zeros(1, dtype=dtype))
    np.testing.assert_allclose(f, 1e-9, rtol=1e-6)
    if dtype is np.float32:
        assert np.exp(dtype(1e-9)) - dtype(1) == 0


def test_half_vectors_at_or_behind_the_horizon_reflect_nothing():
    m = constant_material([1, 1, 1], [0.01, 1, 100])
    assert (dsbrdf.evaluate(m, np.array([0.0, -0.5, -1.0]), np.zeros(3)) == 0).all()


def test_no_kappa_overflows_and_no_gamma_leaves_a_nan():
    for kappa in (0.0, 30.0, 1e4):
        for gamma in (1e-3, 1.0, 1e5):
            f = dsbrdf.evaluate(
                constant_material([kappa] * 3, [gamma] * 3),
                np.array([1e-12, 0.5, 1 - 1e-9, 1.0]),
                np.zeros(4),
            )
            assert np.isfinite(f).all() and (f >= 0).all()


def test_a_weak_constant_lobe_has_the_albedo_of_its_closed_form():
    """κ → 0, γ = 0: f = κ, so the reflected share is ∫ κ cos θ dw = πκ."""
    kappa = 1e-6
    m = constant_material([kappa, 0, 0], [1e-12, 1, 1])
    cos_i = (np.arange(2000) + 0.5) / 2000
    w_i = np.stack([np.sqrt(1 - cos_i**2), 0 * cos_i, cos_i], axis=-1)
    h, theta_d = dsbrdf.half_angles(w_i, np.broadcast_to([0.0, 0.0, 1.0], w_i.shape))
    albedo = 2 * np.pi * (dsbrdf.evaluate(m, h[:, 2], theta_d)[:, 0] * cos_i).mean()
    # e^κ − 1 = κ + κ²/2
    assert albedo == pytest.approx(np.pi * kappa, rel=2e-6)


@pytest.mark.parametrize("factor", [0.5, 2.7])
def test_a_scaled_label_scales_every_lobes_height_and_keeps_its_sharpness(rng, factor):
    label = np.log(rng.uniform(0.01, 3.0, dsbrdf.SHAPE))
    scaled = np.exp(dsbrdf.scale_label(label, factor))
    kappa, gamma = np.exp(label[:, :, 0]), np.exp(label[:, :, 1])
    np.testing.assert_allclose(np.expm1(scaled[:, :, 0]), factor * np.expm1(kappa))
    np.testing.assert_allclose(
        dsbrdf.lobe_sharpness(scaled[:, :, 0], scaled[:, :, 1]),
        dsbrdf.lobe_sharpness(kappa, gamma),
    )


def test_a_scaled_matte_label_is_scaled_everywhere(rng):
    label = np.log(np.full(dsbrdf.SHAPE, 1e-6))
    label[:, :, 1] = 0.0
    cos_h, theta_d = rng.uniform(0, 1, 50), rng.uniform(0, np.pi / 2, 50)
    factors = np.array([0.25, 1.0, 4.0])
    before, after = (
        dsbrdf.evaluate(np.exp(each), cos_h, theta_d)
        for each in (label, dsbrdf.scale_label(label, factors))
    )
    np.testing.assert_allclose(after, before * factors, rtol=1e-5)


def test_flat_and_shaped_labels_of_both_libraries_are_scaled_alike(rng):
    torch = pytest.importorskip("torch")
    label = rng.normal(0, 1, (2, dsbrdf.SIZE))
    shaped = dsbrdf.scale_label(label.reshape(2, *dsbrdf.SHAPE), 3.0)
    np.testing.assert_array_equal(dsbrdf.scale_label(label, 3.0), shaped.reshape(2, dsbrdf.SIZE))
    np.testing.assert_allclose(
        dsbrdf.scale_label(torch.from_numpy(label), torch.tensor([3.0] * 3)),
        shaped.reshape(2, dsbrdf.SIZE),
    )
