"""Kernels that select the seen pixels, normalise their vectors, and scatter results back.

P pixels of whole pictures, N of them picked
vectors  (P, 3): normals or views, camera frame
state    (P,) one of OUTSIDE, AWAY, SEEN, WRONG (learn.engines.layout)
index    (N,) int64 places of the picked pixels
unit     (N, 3) vectors scaled to unit length; length (N,) what they were
"""

import math

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.layout import (
    AWAY,
    OUTSIDE,
    SEEN,
    SHORTEST,
    WRONG,
)
from learn.engines.vector import FLOAT_POINTER

BYTE_POINTER, PLACE_POINTER = types.CPointer(types.uint8), types.CPointer(types.int64)

LOOK = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 3, *[BYTE_POINTER] * 2)
UNIT = types.void(*[types.int64] * 2, FLOAT_POINTER, PLACE_POINTER, FLOAT_POINTER, FLOAT_POINTER)
UNIT_BACKWARD = types.void(*[types.int64] * 2, PLACE_POINTER, *[FLOAT_POINTER] * 4)
SPREAD = types.void(*[types.int64] * 2, PLACE_POINTER, *[FLOAT_POINTER] * 2)
PICK = types.void(*[types.int64] * 2, PLACE_POINTER, *[FLOAT_POINTER] * 2)


@inlined
def length_at(vectors: np.ndarray, p: int) -> float:
    """The length of vector p."""
    x, y, z = (
        types.float64(vectors[3 * p]),
        types.float64(vectors[3 * p + 1]),
        types.float64(vectors[3 * p + 2]),
    )
    return math.sqrt(x * x + y * y + z * z)


def look(
    first: int,
    last: int,
    has_view: int,
    has_mask: int,
    n: np.ndarray,
    view: np.ndarray,
    limits: np.ndarray,
    mask: np.ndarray,
    state: np.ndarray,
) -> None:
    """The state of pixels first … last − 1; without a mask, n = 0 is outside.

    limits  (2,): largest |length − 1|, and least n·v
    """
    tolerance, horizon = limits[0], limits[1]
    for p in range(first, last):
        outside = (
            mask[p] == 0
            if has_mask
            else n[3 * p] == 0.0 and n[3 * p + 1] == 0.0 and n[3 * p + 2] == 0.0
        )
        if outside:
            state[p] = OUTSIDE
            continue
        length = length_at(n, p)
        if not abs(length - 1.0) <= tolerance:  # NaN is not
            state[p] = WRONG
            continue
        facing = n[3 * p + 2] / length
        if has_view:
            view_length = length_at(view, p)
            if not abs(view_length - 1.0) <= tolerance:
                state[p] = WRONG
                continue
            facing = (
                n[3 * p] * view[3 * p]
                + n[3 * p + 1] * view[3 * p + 1]
                + n[3 * p + 2] * view[3 * p + 2]
            ) / (length * view_length)
        state[p] = SEEN if facing > horizon else AWAY


def unit(
    first: int,
    last: int,
    vectors: np.ndarray,
    index: np.ndarray,
    unit: np.ndarray,
    length: np.ndarray,
) -> None:
    """Unit vectors and lengths of the picked pixels first … last − 1."""
    for i in range(first, last):
        p = index[i]
        length[i] = max(length_at(vectors, p), SHORTEST)
        for k in range(3):
            unit[3 * i + k] = vectors[3 * p + k] / length[i]


def unit_backward(
    first: int,
    last: int,
    index: np.ndarray,
    unit: np.ndarray,
    length: np.ndarray,
    g: np.ndarray,
    by_vectors: np.ndarray,
) -> None:
    """Derivatives (P, 3) by the vectors of picked pixels: the tangential part of g over length."""
    for i in range(first, last):
        along = (
            unit[3 * i] * g[3 * i] + unit[3 * i + 1] * g[3 * i + 1] + unit[3 * i + 2] * g[3 * i + 2]
        )
        for k in range(3):
            by_vectors[3 * index[i] + k] = (g[3 * i + k] - along * unit[3 * i + k]) / length[i]


def spread(
    first: int, last: int, index: np.ndarray, values: np.ndarray, picture: np.ndarray
) -> None:
    """Values (N, 3) of picked pixels first … last − 1 into the picture (P, 3)."""
    for i in range(first, last):
        for k in range(3):
            picture[3 * index[i] + k] = values[3 * i + k]


def pick(first: int, last: int, index: np.ndarray, picture: np.ndarray, values: np.ndarray) -> None:
    """Values (N, 3) of the picture (P, 3) at picked pixels first … last − 1."""
    for i in range(first, last):
        for k in range(3):
            values[3 * i + k] = picture[3 * index[i] + k]
