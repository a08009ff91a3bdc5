"""The material's spline over θ_d for sixteen lights at once.

It is shaders.spline in terms that lose no digits in float32.

x        θ_d · 8/π in [0, 4]; the six functions as two clamped ends and two bumps, each a sum of
         squares that does not cancel, so that a control value of 1e5 leaves no trace where its
         function is 0
tents    the five linear B-splines at x = 0 … 4; the slope of the spline is Σ tent_j step_j, with
         steps from learn.engines.lights.spline_steps
"""

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.layout import (
    LANES,
)
from learn.engines.vector import (
    Lanes,
    fma,
    load,
    maximum,
    select,
    store,
)

ANGLE_TO_X = 2.546479089470325  # 8/π
Basis = tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]
Tents = tuple[Lanes, Lanes, Lanes, Lanes, Lanes]


@inlined
def positive_square(a: Lanes) -> Lanes:
    """max(a, 0)²."""
    a = maximum(a, 0.0)
    return a * a


@inlined
def magnitude(a: Lanes) -> Lanes:
    """|a|."""
    return maximum(a, 0.0 - a)


@inlined
def end(x: Lanes) -> tuple[Lanes, Lanes]:
    """The first two functions, seen from the end at x = 0."""
    return positive_square(1.0 - x), select(
        x < 1.0, x * fma(x, -1.5, 2.0), 0.5 * positive_square(2.0 - x)
    )


@inlined
def bump(distance: Lanes) -> Lanes:
    """The uniform quadratic B-spline, by the distance from its middle."""
    return select(
        distance < 0.5, fma(0.0 - distance, distance, 0.75), 0.5 * positive_square(1.5 - distance)
    )


@inlined
def basis(theta_d: Lanes) -> Basis:
    """The six functions at θ_d."""
    x = theta_d * ANGLE_TO_X
    b0, b1 = end(x)
    b5, b4 = end(4.0 - x)
    return b0, b1, bump(magnitude(x - 1.5)), bump(magnitude(x - 2.5)), b4, b5


@inlined
def tents(theta_d: Lanes) -> Tents:
    """The five linear B-splines at θ_d."""
    x = theta_d * ANGLE_TO_X
    t1 = maximum(1.0 - magnitude(x - 1.0), 0.0)
    t2 = maximum(1.0 - magnitude(x - 2.0), 0.0)
    t3 = maximum(1.0 - magnitude(x - 3.0), 0.0)
    return maximum(1.0 - x, 0.0), t1, t2, t3, maximum(x - 3.0, 0.0)


@inlined
def curve(values: np.ndarray, o: int, b: Basis) -> Lanes:
    """Σ_t values[o + t] b_t."""
    low = fma(b[2], values[o + 2], fma(b[1], values[o + 1], b[0] * values[o]))
    return fma(b[5], values[o + 5], fma(b[4], values[o + 4], fma(b[3], values[o + 3], low)))


@inlined
def slope(steps: np.ndarray, o: int, t: Tents) -> Lanes:
    """Σ_j steps[o + j] t_j: the curve's derivative by x."""
    low = fma(t[2], steps[o + 2], fma(t[1], steps[o + 1], t[0] * steps[o]))
    return fma(t[4], steps[o + 4], fma(t[3], steps[o + 3], low))


@inlined
def add_curve(sums: np.ndarray, o: int, q: Lanes, b: Basis) -> None:
    """Add q b_t to six rows of sums from o on: the curve's derivative by its control values."""
    store(sums, o, fma(q, b[0], load(sums, o)))
    store(sums, o + LANES, fma(q, b[1], load(sums, o + LANES)))
    store(sums, o + 2 * LANES, fma(q, b[2], load(sums, o + 2 * LANES)))
    store(sums, o + 3 * LANES, fma(q, b[3], load(sums, o + 3 * LANES)))
    store(sums, o + 4 * LANES, fma(q, b[4], load(sums, o + 4 * LANES)))
    store(sums, o + 5 * LANES, fma(q, b[5], load(sums, o + 5 * LANES)))
