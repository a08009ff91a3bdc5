"""Quadratic B-spline over θ_d with nine clamped knots and so six control values per curve.

u: θ_d / (π/2) in [0, 1].  Knots 0 0 0 ¼ ½ ¾ 1 1 1, hence the four intervals of x = 4u in [0, 4].
Source: supplement, "Material" ("a second degree B-spline with nine knots, which results in 6
variables"); the positions of the knots are our choice, because the paper does not give them.
"""

import numpy as np

from shaders.arrays import Array, namespace

CONTROL_VALUES = 6
INTERVALS = 4


def basis(theta_d: Array) -> Array:
    """Return the six basis functions at each angle; they are ≥ 0 and sum to 1.

    theta_d  (...), radians in [0, π/2]; values outside are clamped
    Returns  (..., 6)
    """
    xp = namespace(theta_d)
    x = xp.clip(theta_d * (2 * INTERVALS / np.pi), 0.0, float(INTERVALS))

    def edge(x):
        """Return the first two functions from a clamped end at x = 0, on one and two intervals."""
        first = xp.where(x < 1, (1 - x) ** 2, 0 * x)
        second = xp.where(x < 1, 2 * x - 1.5 * x * x, xp.where(x < 2, 0.5 * (2 - x) ** 2, 0 * x))
        return first, second

    def inner(x):
        """Return the uniform quadratic B-spline on [0, 3]."""
        rise, fall = 0.5 * x * x, 0.5 * (3 - x) ** 2
        middle = 0.75 - (x - 1.5) ** 2
        curve = xp.where(x < 1, rise, xp.where(x < 2, middle, fall))
        return xp.where((x > 0) & (x < 3), curve, 0 * x)

    b0, b1 = edge(x)
    b5, b4 = edge(INTERVALS - x)
    return xp.stack([b0, b1, inner(x), inner(x - 1), b4, b5], -1)


def basis_slope(theta_d: Array) -> Array:
    """Return derivatives of `basis` by θ_d, per radian; one-sided at the clamped ends.

    theta_d  (...), radians in [0, π/2]; values outside are clamped
    Returns  (..., 6); they sum to 0
    """
    xp = namespace(theta_d)
    x = xp.clip(theta_d * (2 * INTERVALS / np.pi), 0.0, float(INTERVALS))

    def edge(x):
        first = xp.where(x < 1, 2 * x - 2, 0 * x)
        second = xp.where(x < 1, 2 - 3 * x, xp.where(x < 2, x - 2, 0 * x))
        return first, second

    def inner(x):
        slope = xp.where(x < 1, x, xp.where(x < 2, 3 - 2 * x, x - 3))
        return xp.where((x > 0) & (x < 3), slope, 0 * x)

    b0, b1 = edge(x)
    b5, b4 = edge(INTERVALS - x)
    return xp.stack([b0, b1, inner(x), inner(x - 1), -b4, -b5], -1) * (2 * INTERVALS / np.pi)


def greville() -> np.ndarray:
    """Return the Greville abscissae (6,) in radians, where each control value acts most.

    They are the averages of neighbouring inner knots.
    """
    knots = (
        np.concatenate([[0, 0, 0], np.arange(1, INTERVALS), [INTERVALS] * 3])
        / INTERVALS
        * (np.pi / 2)
    )
    return 0.5 * (knots[1:7] + knots[2:8])
