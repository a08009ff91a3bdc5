"""Kernels for a look-up in a square table by bicubic Catmull–Rom weights, and its derivatives. Plain loops in float64 over float32 arrays.

table  (size, size, 3) values at the nodes
at     (P, 2) place of each pixel in the table, (row, column) in nodes, within [1, size − 2)
out    (P, 3)

    out = Σ_ij a_i(row) a_j(column) table[r + i − 1, c + j − 1],   i, j = 0 … 3,   r, c the whole parts of row and column
"""

from numba import njit, types

from learn.engines.vector import FLOAT_POINTER

CHUNKS = 4  # of pixels, in the backward pass: the most threads it can use

FORWARD = types.void(*[types.int64] * 3, *[FLOAT_POINTER] * 3)
BACKWARD = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 5)


@njit(forceinline=True)
def weights(t):
    """Catmull–Rom weights of the four nodes around a place t in [0, 1) after the second."""
    t2 = t * t
    t3 = t2 * t
    return (
        0.5 * (t2 + t2 - t3 - t),
        0.5 * (3 * t3 - 5 * t2) + 1,
        0.5 * (4 * t2 - 3 * t3 + t),
        0.5 * (t3 - t2),
    )


@njit(forceinline=True)
def weight_slopes(t):
    """Their derivatives by t."""
    t2 = t * t
    return (
        0.5 * (4 * t - 3 * t2 - 1),
        0.5 * (9 * t2 - 10 * t),
        0.5 * (8 * t - 9 * t2 + 1),
        0.5 * (3 * t2 - 2 * t),
    )


def forward(first, last, size, at, table, out):
    """Values of pixels first … last − 1."""
    for p in range(first, last):
        y, x = types.float64(at[2 * p]), types.float64(at[2 * p + 1])
        row, column = int(y), int(x)
        a, b = weights(y - row), weights(x - column)
        o0, o1, o2 = 0.0, 0.0, 0.0
        for i in range(4):
            o = 3 * ((row + i - 1) * size + column - 1)
            r0, r1, r2 = 0.0, 0.0, 0.0
            for j in range(4):
                r0 += b[j] * table[o + 3 * j]
                r1 += b[j] * table[o + 3 * j + 1]
                r2 += b[j] * table[o + 3 * j + 2]
            o0 += a[i] * r0
            o1 += a[i] * r1
            o2 += a[i] * r2
        out[3 * p] = o0
        out[3 * p + 1] = o1
        out[3 * p + 2] = o2


def backward(first, last, pixels, size, at, table, g, by_at, by_table):
    """Derivatives of Σ g·out from pixel chunks first … last − 1: by_at (P, 2), by_table (CHUNKS, size, size, 3)."""
    for chunk in range(first, last):
        base = chunk * 3 * size * size
        for i in range(3 * size * size):
            by_table[base + i] = 0.0
        for p in range(chunk * pixels // CHUNKS, (chunk + 1) * pixels // CHUNKS):
            y, x = types.float64(at[2 * p]), types.float64(at[2 * p + 1])
            row, column = int(y), int(x)
            y -= row
            x -= column
            a, b, da, db = weights(y), weights(x), weight_slopes(y), weight_slopes(x)
            g0, g1, g2 = g[3 * p], g[3 * p + 1], g[3 * p + 2]
            by_y, by_x = 0.0, 0.0
            for i in range(4):
                o = 3 * ((row + i - 1) * size + column - 1)
                for j in range(4):
                    q = o + 3 * j
                    value = g0 * table[q] + g1 * table[q + 1] + g2 * table[q + 2]
                    by_y += da[i] * b[j] * value
                    by_x += a[i] * db[j] * value
                    w = a[i] * b[j]
                    by_table[base + q] += w * g0
                    by_table[base + q + 1] += w * g1
                    by_table[base + q + 2] += w * g2
            by_at[2 * p] = by_y
            by_at[2 * p + 1] = by_x
