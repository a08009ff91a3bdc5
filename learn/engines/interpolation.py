"""Kernels for a look-up in a map over normals by bicubic Catmull–Rom weights, and its derivatives.

n      (P, 3) unit normals; p = (n_x, n_y) / √(1 + n_z), the equal-area disk
       (learn/methods/reflectance_map.py)
size   nodes along a side; the place of a normal in nodes is (row, column) = ((p_y, p_x) + 1) (size
       − 5) / 2 + 2
table  (size, size, 4) values at the nodes, the fourth unused: four neighbours in a row are sixteen
       floats, one load
out    (P, 3)

    out = Σ_ij a_i(row) b_j(column) table[r + i − 1, c + j − 1],   i, j = 0 … 3

r and c are the whole parts of row and column. Places and weights are computed in float64, sums in
float32.
"""

import math

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.layout import (
    MAP_CHUNKS,
)
from learn.engines.vector import (
    FLOAT_POINTER,
    by_four,
    fma,
    in_turn,
    lane_sum,
    load,
    splat,
    store,
    turn_sums,
)

TOUCH = types.void(*[types.int64] * 3, *[FLOAT_POINTER] * 2)
FORWARD = types.void(*[types.int64] * 3, *[FLOAT_POINTER] * 3)
BACKWARD = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 5)


@inlined
def place(x: float, y: float, z: float, size: int) -> tuple[int, int, float, float, float]:
    """Row and column of the node before a normal's place, the remainders, and 1 / √(1 + n_z)."""
    shrink = 1.0 / math.sqrt(1.0 + z)
    half = 0.5 * (size - 5)
    v, u = (y * shrink + 1.0) * half + 2.0, (x * shrink + 1.0) * half + 2.0
    row, column = min(max(int(v), 1), size - 3), min(max(int(u), 1), size - 3)
    return row, column, v - row, u - column, shrink


@inlined
def weights(t: float) -> tuple[float, float, float, float]:
    """Catmull–Rom weights of the four nodes around a place t in [0, 1) after the second."""
    t2 = t * t
    t3 = t2 * t
    return (
        0.5 * (t2 + t2 - t3 - t),
        0.5 * (3 * t3 - 5 * t2) + 1,
        0.5 * (4 * t2 - 3 * t3 + t),
        0.5 * (t3 - t2),
    )


@inlined
def weight_slopes(t: float) -> tuple[float, float, float, float]:
    """Their derivatives by t."""
    t2 = t * t
    return (
        0.5 * (4 * t - 3 * t2 - 1),
        0.5 * (9 * t2 - 10 * t),
        0.5 * (8 * t - 9 * t2 + 1),
        0.5 * (3 * t2 - 2 * t),
    )


def touch(first: int, last: int, size: int, n: np.ndarray, touched: np.ndarray) -> None:
    """Set touched (size, size) to 1 at the node before each of the pixels first … last − 1."""
    for p in range(first, last):
        x, y, z = types.float64(n[3 * p]), types.float64(n[3 * p + 1]), types.float64(n[3 * p + 2])
        row, column, _, _, _ = place(x, y, z, size)
        touched[row * size + column] = 1.0


def forward(
    first: int, last: int, size: int, n: np.ndarray, table: np.ndarray, out: np.ndarray
) -> None:
    """Values of pixels first … last − 1."""
    for p in range(first, last):
        x, y, z = types.float64(n[3 * p]), types.float64(n[3 * p + 1]), types.float64(n[3 * p + 2])
        row, column, v, u, _ = place(x, y, z, size)
        a, b = weights(v), weights(u)
        o = 4 * ((row - 1) * size + column - 1)
        rows = splat(0.0)
        for i in range(4):
            rows = fma(a[i], load(table, o + 4 * size * i), rows)
        sums = turn_sums(rows * by_four(b[0], b[1], b[2], b[3]))
        out[3 * p] = sums[0]
        out[3 * p + 1] = sums[1]
        out[3 * p + 2] = sums[2]


def backward(
    first: int,
    last: int,
    pixels: int,
    size: int,
    n: np.ndarray,
    table: np.ndarray,
    g: np.ndarray,
    by_n: np.ndarray,
    by_table: np.ndarray,
) -> None:
    """Derivatives of Σ g·out from pixel chunks first … last − 1.

    by_n (P, 3) is written; by_table (MAP_CHUNKS, size, size, 4) is added to
    """
    for chunk in range(first, last):
        base = chunk * 4 * size * size
        for p in range(chunk * pixels // MAP_CHUNKS, (chunk + 1) * pixels // MAP_CHUNKS):
            x, y, z = (
                types.float64(n[3 * p]),
                types.float64(n[3 * p + 1]),
                types.float64(n[3 * p + 2]),
            )
            row, column, v, u, shrink = place(x, y, z, size)
            a, b, da, db = weights(v), weights(u), weight_slopes(v), weight_slopes(u)
            weighted = in_turn(g[3 * p], g[3 * p + 1], g[3 * p + 2], 0.0)
            by_column = weighted * by_four(db[0], db[1], db[2], db[3])
            weighted = weighted * by_four(b[0], b[1], b[2], b[3])
            o = 4 * ((row - 1) * size + column - 1)
            rows, slopes = splat(0.0), splat(0.0)
            for i in range(4):
                q = o + 4 * size * i
                nodes = load(table, q)
                rows = fma(a[i], nodes, rows)
                slopes = fma(da[i], nodes, slopes)
                store(by_table, base + q, fma(a[i], weighted, load(by_table, base + q)))
            scale = 0.5 * (size - 5) * shrink
            by_x, by_y = scale * lane_sum(rows * by_column), scale * lane_sum(slopes * weighted)
            by_n[3 * p] = by_x
            by_n[3 * p + 1] = by_y
            by_n[3 * p + 2] = -0.5 * shrink * shrink * (x * by_x + y * by_y)
