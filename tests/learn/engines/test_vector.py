"""The sixteen-lane functions against numpy in float64, over the whole of their domains."""

import ctypes

import numpy as np
import pytest

numba = pytest.importorskip("numba")
types, njit = numba.types, numba.njit


@pytest.fixture(scope="module")
def lanewise():
    """lanewise(function, *inputs) → float32 array: `function` of Wide values, run over arrays of a
    multiple of 16 floats.
    """
    from learn.engines.vector import FLOAT_POINTER, load, store

    def run(function, *inputs):
        inputs = [np.ascontiguousarray(a, dtype=np.float32) for a in inputs]
        one = njit(forceinline=True)(function) if not hasattr(function, "py_func") else function
        if len(inputs) == 1:

            def kernel(count, a, out):
                for i in range(0, count, 16):
                    store(out, i, one(load(a, i)))

        else:

            def kernel(count, a, b, out):
                for i in range(0, count, 16):
                    store(out, i, one(load(a, i), load(b, i)))

        out = np.empty_like(inputs[0])
        signature = types.void(types.int64, *[FLOAT_POINTER] * (len(inputs) + 1))
        compiled = numba.cfunc(signature)(kernel)
        pointers = [
            ctypes.cast(a.ctypes.data, ctypes.POINTER(ctypes.c_float)) for a in (*inputs, out)
        ]
        compiled.ctypes(out.size, *pointers)
        return out

    return run


def test_exp2(lanewise):
    from learn.engines.exponentials import exp2

    x = np.linspace(-47.9, 100, 16 * 5000).astype(np.float32)
    np.testing.assert_allclose(lanewise(exp2, x), np.exp2(x.astype(np.float64)), rtol=3e-7)
    # held, not 0 and not denormal
    assert (lanewise(exp2, np.full(16, -1e9)) == np.float32(2.0**-48)).all()


def test_exp2m1_keeps_its_digits_near_zero(lanewise):
    from learn.engines.exponentials import exp2m1

    x = np.concatenate([np.geomspace(1e-15, 1, 8000), np.linspace(0, 72, 8000)]).astype(np.float32)
    exact = np.expm1(x.astype(np.float64) * np.log(2))
    np.testing.assert_allclose(lanewise(exp2m1, x), exact, rtol=6e-7)


def test_log2_keeps_its_digits_near_one(lanewise):
    from learn.engines.exponentials import log2

    gap = np.concatenate([np.geomspace(1e-12, 1, 8000), np.linspace(0, 1 - 1e-4, 8000)])
    gap = np.minimum(gap, 1 - 1e-4).astype(np.float32)
    c = (1 - gap.astype(np.float64)).astype(np.float32)
    exact = np.where(
        c > 0.75, np.log1p(-gap.astype(np.float64)) / np.log(2), np.log2(c.astype(np.float64))
    )
    np.testing.assert_allclose(lanewise(log2, c, gap), exact, rtol=3e-7)


def test_angle(lanewise):
    from learn.engines.exponentials import angle

    theta = np.linspace(0, np.pi / 2, 16000)
    y, x = (np.sin(theta) ** 2).astype(np.float32), (np.cos(theta) ** 2).astype(np.float32)
    exact = np.arctan2(np.sqrt(y.astype(np.float64)), np.sqrt(x.astype(np.float64)))
    np.testing.assert_allclose(lanewise(angle, y, x), exact, rtol=4e-7, atol=1e-15)


def test_spline_is_the_one_of_shaders(lanewise):
    from learn.engines import splines
    from shaders.spline import basis

    theta = np.linspace(0, np.pi / 2, 1600)
    right = basis(theta.astype(np.float32).astype(np.float64))
    for i in range(6):
        picked = lanewise(pick(splines.basis, i), theta)
        # x ≤ 4 is rounded to 2.4e-7, slopes reach 2
        np.testing.assert_allclose(picked, right[:, i], atol=5e-7)
        zero = (right[:, i] == 0) & (np.abs(np.sin(theta * 8)) > 1e-3)
        assert (picked[zero] == 0).all()  # no trace of a control value where its function is 0


def test_spline_slope_is_the_derivative(lanewise):
    """The derivative of Σ m_t b_t by tents and steps against a central difference of
    shaders.spline.
    """
    from learn.engines import splines
    from learn.engines.lights import spline_steps
    from shaders.spline import basis

    theta, step = np.linspace(0.01, 1.56, 1600).astype(np.float32).astype(np.float64), 1e-6
    m = np.array([0.3, 2.0, -1.0, 0.5, 4.0, 1.0])
    tents = np.stack([lanewise(pick(splines.tents, i), theta) for i in range(5)], -1)
    slope = tents @ spline_steps(m) * splines.ANGLE_TO_X
    numeric = (basis(theta + step) - basis(theta - step)) @ m / (2 * step)
    np.testing.assert_allclose(slope, numeric, atol=2e-5)


def pick(function, i):
    def one(x):
        return function(x)[i]

    return one


def test_lane_sum_adds_in_a_fixed_tree(lanewise):
    from learn.engines.vector import lane_sum, splat

    rng = np.random.default_rng(3)
    x = rng.normal(size=16).astype(np.float32)
    tree = x
    while len(tree) > 1:
        tree = tree[: len(tree) // 2] + tree[len(tree) // 2 :]
    assert (lanewise(lambda a: splat(lane_sum(a)), x) == tree[0]).all()


def test_operators_and_select(lanewise):
    from learn.engines.vector import maximum, minimum, select

    a, b = np.random.default_rng(4).normal(size=(2, 64)).astype(np.float32)
    np.testing.assert_allclose(
        lanewise(lambda x, y: (x + y) * 2.0 - x / 4.0, a, b), (a + b) * 2 - a / 4, rtol=1e-6
    )
    np.testing.assert_array_equal(
        lanewise(lambda x, y: select(x > y, x, y), a, b), np.maximum(a, b)
    )
    np.testing.assert_array_equal(
        lanewise(lambda x, y: select(x < 0.5, x, y), a, b), np.where(a < 0.5, a, b)
    )
    np.testing.assert_array_equal(
        lanewise(lambda x, y: maximum(minimum(x, y), -1.0), a, b), np.maximum(np.minimum(a, b), -1)
    )
