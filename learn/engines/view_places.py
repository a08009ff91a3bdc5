"""Kernels for the places where pixels in perspective read maps (learn/methods/view_places.py).

n, view  (P, 3) unit vectors
frame    (3, 3) two directions e1, e2 across the mean view, and the mean view
fit      (2, 6) coefficients of V's slopes, by the terms 1, x, y, z, x z, y z of a normal
place    (P, 3) n', which mirrors into V(n') what n mirrors into the view:
             n' = u/‖u‖,  u = 2 (n·v) n + V(n') − v
length   (P,) ‖u‖
least    n·v below which n·v counts as that

They are stored in float32; sums are in float64.
"""

import math

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.triples import Triple
from learn.engines.vector import FLOAT_POINTER, single

FORWARD = types.void(*[types.int64] * 3, *[FLOAT_POINTER] * 7)
BACKWARD = types.void(*[types.int64] * 3, *[FLOAT_POINTER] * 12)
# places in `limits`: `least`, a limit of each kernel's own, and the two widths of the offsets
LEAST, OWN, HALF = range(3)


@inlined
def middle(x: float, y: float, z: float, fit: np.ndarray, row: int) -> float:
    """One of V's slopes at a normal."""
    o = 6 * row
    linear = fit[o] + fit[o + 1] * x + fit[o + 2] * y + fit[o + 3] * z
    return linear + fit[o + 4] * x * z + fit[o + 5] * y * z


@inlined
def middle_slopes(
    x: float, y: float, z: float, fit: np.ndarray, by_a: float, by_b: float
) -> tuple[float, float, float]:
    """The derivative by the normal, from those by V's slopes."""
    by_xz = by_a * fit[4] + by_b * fit[10]
    by_yz = by_a * fit[5] + by_b * fit[11]
    return (
        by_a * fit[1] + by_b * fit[7] + by_xz * z,
        by_a * fit[2] + by_b * fit[8] + by_yz * z,
        by_a * fit[3] + by_b * fit[9] + by_xz * x + by_yz * y,
    )


@inlined
def from_frame(a: float, b: float, depth: float, frame: np.ndarray) -> Triple:
    """The vector whose components along the frame's three axes are a, b and depth.

    depth  a `single` if a and b are: their sum is then one too
    """
    return (
        a * frame[0] + b * frame[3] + depth * frame[6],
        a * frame[1] + b * frame[4] + depth * frame[7],
        a * frame[2] + b * frame[5] + depth * frame[8],
    )


@inlined
def into_frame(x: float, y: float, z: float, frame: np.ndarray) -> Triple:
    """The components of a vector along the frame's three axes."""
    return (
        x * frame[0] + y * frame[1] + z * frame[2],
        x * frame[3] + y * frame[4] + z * frame[5],
        x * frame[6] + y * frame[7] + z * frame[8],
    )


@inlined
def across(scale: float, g: Triple, q_x: float, q_y: float, q_z: float) -> Triple:
    """The component of g perpendicular to a place q, times a scale."""
    along = g[0] * q_x + g[1] * q_y + g[2] * q_z
    return scale * (g[0] - along * q_x), scale * (g[1] - along * q_y), scale * (g[2] - along * q_z)


def forward(
    first: int,
    last: int,
    steps: int,
    n: np.ndarray,
    view: np.ndarray,
    frame: np.ndarray,
    fit: np.ndarray,
    limits: np.ndarray,
    place: np.ndarray,
    length: np.ndarray,
) -> None:
    """Find the places of pixels first … last − 1, each in `steps` steps at most.

    limits  (4,); a place is found where the mean change of a component is below the second
    """
    least, settled = limits[LEAST], limits[OWN]
    for p in range(first, last):
        x, y, z = n[3 * p], n[3 * p + 1], n[3 * p + 2]
        v_x, v_y, v_z = view[3 * p], view[3 * p + 1], view[3 * p + 2]
        twice = 2 * max(x * v_x + y * v_y + z * v_z, least)
        m_x, m_y, m_z = twice * x - v_x, twice * y - v_y, twice * z - v_z
        q_x, q_y, q_z = x, y, z
        norm = 1.0
        for _ in range(steps):
            a, b = middle(q_x, q_y, q_z, fit, 0), middle(q_x, q_y, q_z, fit, 1)
            shrink = 1 / math.sqrt(1 + a * a + b * b)
            o_x, o_y, o_z = from_frame(a, b, single(1.0), frame)
            u_x, u_y, u_z = m_x + shrink * o_x, m_y + shrink * o_y, m_z + shrink * o_z
            norm = math.sqrt(u_x * u_x + u_y * u_y + u_z * u_z)
            t_x, t_y, t_z = u_x / norm, u_y / norm, u_z / norm
            change = abs(t_x - q_x) + abs(t_y - q_y) + abs(t_z - q_z)
            q_x, q_y, q_z = t_x, t_y, t_z
            if change < 3 * settled:
                break
        place[3 * p], place[3 * p + 1], place[3 * p + 2] = q_x, q_y, q_z
        length[p] = norm


def backward(
    first: int,
    last: int,
    terms: int,
    n: np.ndarray,
    view: np.ndarray,
    frame: np.ndarray,
    fit: np.ndarray,
    limits: np.ndarray,
    place: np.ndarray,
    length: np.ndarray,
    by_place: np.ndarray,
    by_x: np.ndarray,
    by_y: np.ndarray,
    by_n: np.ndarray,
    by_view: np.ndarray,
) -> None:
    """Derivatives by normals and views (P, 3) of pixels first … last − 1.

    terms         of the series for V's part in a mirrored place; −1: places are the normals
    limits        (4,); the second is the least depth of a view along the mean one
    by_place      (P, 3) derivative by n'
    by_x, by_y    (P,) derivatives by the offsets
    """
    for p in range(first, last):
        x, y, z = n[3 * p], n[3 * p + 1], n[3 * p + 2]
        v_x, v_y, v_z = view[3 * p], view[3 * p + 1], view[3 * p + 2]
        q_x, q_y, q_z = place[3 * p], place[3 * p + 1], place[3 * p + 2]
        # the offsets: slopes of the view less V's
        a, b, depth = into_frame(v_x, v_y, v_z, frame)
        depth = max(depth, limits[OWN])
        a, b = a / depth, b / depth
        by_a, by_b = by_x[p] / limits[HALF], by_y[p] / limits[HALF + 1]
        c_x, c_y, c_z = middle_slopes(q_x, q_y, q_z, fit, by_a, by_b)
        g_x, g_y, g_z = by_place[3 * p] - c_x, by_place[3 * p + 1] - c_y, by_place[3 * p + 2] - c_z
        by_a, by_b = by_a / depth, by_b / depth
        w_x, w_y, w_z = from_frame(by_a, by_b, -(by_a * a + by_b * b), frame)
        if terms < 0:
            by_n[3 * p], by_n[3 * p + 1], by_n[3 * p + 2] = g_x, g_y, g_z
        else:
            scale = 1 / length[p]
            u_x, u_y, u_z = across(scale, (g_x, g_y, g_z), q_x, q_y, q_z)
            a, b = middle(q_x, q_y, q_z, fit, 0), middle(q_x, q_y, q_z, fit, 1)
            shrink = 1 / math.sqrt(1 + a * a + b * b)
            o_x, o_y, o_z = from_frame(a, b, single(1.0), frame)
            o_x, o_y, o_z = shrink * o_x, shrink * o_y, shrink * o_z
            for _ in range(terms):
                radial = shrink * (u_x * o_x + u_y * o_y + u_z * o_z)
                by_a, by_b, _ = into_frame(u_x, u_y, u_z, frame)
                by_a, by_b = shrink * (by_a - radial * a), shrink * (by_b - radial * b)
                c_x, c_y, c_z = middle_slopes(q_x, q_y, q_z, fit, by_a, by_b)
                by_both = g_x + c_x, g_y + c_y, g_z + c_z
                u_x, u_y, u_z = across(scale, by_both, q_x, q_y, q_z)
            cosine = x * v_x + y * v_y + z * v_z
            share = 0.0
            if cosine > limits[LEAST]:
                share = 2 * (x * u_x + y * u_y + z * u_z)
            twice = 2 * max(cosine, limits[LEAST])
            by_n[3 * p] = twice * u_x + share * v_x
            by_n[3 * p + 1] = twice * u_y + share * v_y
            by_n[3 * p + 2] = twice * u_z + share * v_z
            w_x, w_y, w_z = w_x - u_x + share * x, w_y - u_y + share * y, w_z - u_z + share * z
        by_view[3 * p], by_view[3 * p + 1], by_view[3 * p + 2] = w_x, w_y, w_z
