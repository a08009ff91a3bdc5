"""The quadratic spline over θ_d: a partition of unity that is scipy's B-spline on the stated
knots.
"""

import numpy as np
import pytest

from shaders import spline

THETA_D = np.linspace(0, np.pi / 2, 1001)


def test_spline_basis_is_a_partition_of_unity():
    b = spline.basis(THETA_D)
    assert b.shape == (1001, 6)
    assert (b >= 0).all()
    np.testing.assert_allclose(b.sum(-1), 1.0, rtol=1e-14)


def test_nine_clamped_knots_make_six_functions_equal_to_scipys():
    interpolate = pytest.importorskip("scipy.interpolate")
    knots = np.array([0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1]) * (np.pi / 2)
    assert len(knots) == 9
    oracle = interpolate.BSpline(knots, np.eye(6), 2)(THETA_D)
    np.testing.assert_allclose(spline.basis(THETA_D), oracle, atol=1e-14)


def test_the_ends_are_held_by_the_first_and_last_control_value():
    np.testing.assert_array_equal(spline.basis(np.array([0.0, np.pi / 2])), np.eye(6)[[0, 5]])


def test_angles_outside_are_held_at_the_ends():
    np.testing.assert_array_equal(spline.basis(np.array([-0.1, 2.0])), np.eye(6)[[0, 5]])


def test_each_angle_meets_at_most_three_functions():
    assert ((spline.basis(THETA_D) > 0).sum(-1) <= 3).all()


def test_the_curve_and_its_slope_have_no_jump_at_the_inner_knots():
    for knot in np.array([1, 2, 3]) * np.pi / 8:
        h = 1e-6
        before, at, after = spline.basis(np.array([knot - h, knot, knot + h]))
        np.testing.assert_allclose(before, after, atol=1e-5)  # two steps of a slope below 4
        # step × curvature below 30
        np.testing.assert_allclose((at - before) / h, (after - at) / h, atol=1e-4)


def test_control_values_at_the_greville_angles_draw_a_straight_line():
    np.testing.assert_allclose(spline.basis(THETA_D) @ spline.greville(), THETA_D, atol=1e-14)
