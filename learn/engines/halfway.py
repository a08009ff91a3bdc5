"""Half vectors of a pixel's own view with sixteen lights.

Letters and arrays as in learn.engines.general, whose geometry holds w and what rounding took off w.

    s = w + v,  h = s/‖s‖,  c = n·h = 1 − ½‖h − n‖²

s is kept as a float and its rounding error, and v's length is set right, so that h − n is right to
its own size: a lobe of γ = 1e5 needs it.
"""

from typing import NamedTuple

import numpy as np
from numba import float32, float64

from learn.engines.compilation import inlined
from learn.engines.distant import peak_cosine, w_of
from learn.engines.layout import LANES, W_REST_X, W_REST_Y, W_REST_Z
from learn.engines.triples import Triple, dot
from learn.engines.vector import Lanes, Vector, fma, load, maximum, splat, sqrt

LEAST_SQUARE = 1e-9  # of ‖s‖: where the light is in front of the horizon it is above HORIZON²


class HalfVectors(NamedTuple):
    """Half vectors of one pixel's view with sixteen lights, camera frame.

    s          w + v, and s_square its ‖s‖², at least LEAST_SQUARE
    inverse_s  1/‖s‖
    offset     h − n
    c, log_c   c = n·h, and log2 c
    """

    s: Vector
    s_square: Lanes
    inverse_s: Lanes
    offset: Vector
    c: Lanes
    log_c: Lanes


@inlined
def two_sum(a: Lanes, b: Lanes) -> tuple[Lanes, Lanes]:
    """a + b and its rounding error."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@inlined
def shortfall(x: float, y: float, z: float) -> np.float32:
    """1/‖v‖ − 1 of a vector that was scaled to unit length in float32."""
    x64, y64, z64 = float64(x), float64(y), float64(z)
    return float32(0.5 * (1.0 - (x64 * x64 + y64 * y64 + z64 * z64)))


@inlined
def view_at(v: np.ndarray, p: int) -> tuple[Vector, np.float32]:
    """The view at place p of an array (P, 3), in all lanes, and by which part it is too short."""
    x, y, z = v[p], v[p + 1], v[p + 2]
    return (splat(x), splat(y), splat(z)), shortfall(x, y, z)


@inlined
def w_plus_v(geometry: np.ndarray, o: int, v: Vector, v_short: np.float32) -> tuple[Vector, Vector]:
    """s = w + v as three floats and their three rounding errors; v_short: of `view_at`."""
    wx, wy, wz = w_of(geometry, o)
    sx, rx = two_sum(wx, v[0])
    sy, ry = two_sum(wy, v[1])
    sz, rz = two_sum(wz, v[2])
    rx = fma(v[0], v_short, rx + load(geometry, o + LANES * W_REST_X))
    ry = fma(v[1], v_short, ry + load(geometry, o + LANES * W_REST_Y))
    rz = fma(v[2], v_short, rz + load(geometry, o + LANES * W_REST_Z))
    return (sx, sy, sz), (rx, ry, rz)


@inlined
def offset(s: Lanes, rest: Lanes, n: Lanes, inverse: Lanes) -> Lanes:
    """One component of h − n, inverse = 1/‖s‖."""
    return fma(rest, inverse, fma(s, inverse, 0.0 - n))


@inlined
def half_vectors(
    geometry: np.ndarray, o: int, n: Triple, v: Vector, v_short: np.float32
) -> HalfVectors:
    """A pixel's half vectors h = (w + v)/‖w + v‖ with the lights of the block at offset o."""
    (sx, sy, sz), (rx, ry, rz) = w_plus_v(geometry, o, v, v_short)
    s = sx + rx, sy + ry, sz + rz
    s_square = maximum(dot(s, s), LEAST_SQUARE)
    inverse = 1.0 / sqrt(s_square)
    from_n = (
        offset(sx, rx, n[0], inverse),
        offset(sy, ry, n[1], inverse),
        offset(sz, rz, n[2], inverse),
    )
    c, log_c = peak_cosine(from_n)
    return HalfVectors((sx, sy, sz), s_square, inverse, from_n, c, log_c)
