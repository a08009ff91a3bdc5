"""Kernels that gather a map's texels into larger ones by a stencil, and the transpose.

learn/methods/coarse.py uses them.

fine     (planes, height, width), several maps one after the other
coarse   (planes, height / step, width / step)
stencil  (4 step,): weights in the coarse texel (i, j) of the fine ones from row step·i − 3/2 step,
         and column step·j − 3/2 step, on
along    (width,) scratch: one coarse row, its columns still fine
Columns wrap around; beyond a pole lies the same row's other half.
"""

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.vector import FLOAT_POINTER

GATHER = SCATTER = types.void(*[types.int64] * 5, *[FLOAT_POINTER] * 4)


@inlined
def over_poles(row: int, height: int, width: int) -> tuple[int, int]:
    """The row at a place beyond a pole or not, and the columns by which it is turned."""
    if row < 0:
        return -1 - row, width // 2
    if row >= height:
        return 2 * height - 1 - row, width // 2
    return row, 0


@inlined
def around(column: int, width: int) -> int:
    """The column, wrapped around."""
    return column + width if column < 0 else column - width if column >= width else column


def gather(
    first: int,
    last: int,
    height: int,
    width: int,
    step: int,
    stencil: np.ndarray,
    fine: np.ndarray,
    along: np.ndarray,
    coarse: np.ndarray,
) -> None:
    """Coarse planes first … last − 1."""
    for plane in range(first, last):
        for i in range(height // step):
            for column in range(width):
                along[column] = 0.0
            for q in range(4 * step):
                row, turn = over_poles(step * i - 3 * step // 2 + q, height, width)
                o, weight = (plane * height + row) * width, stencil[q]
                for column in range(width - turn):
                    along[column] += weight * fine[o + column + turn]
                for column in range(turn):
                    along[width - turn + column] += weight * fine[o + column]
            for j in range(width // step):
                total = types.float32(0.0)
                for q in range(4 * step):
                    total += stencil[q] * along[around(step * j - 3 * step // 2 + q, width)]
                coarse[(plane * (height // step) + i) * (width // step) + j] = total


def scatter(
    first: int,
    last: int,
    height: int,
    width: int,
    step: int,
    stencil: np.ndarray,
    coarse: np.ndarray,
    along: np.ndarray,
    fine: np.ndarray,
) -> None:
    """Fine planes first … last − 1 from coarse ones: the transpose of `gather`."""
    for plane in range(first, last):
        for texel in range(plane * height * width, (plane + 1) * height * width):
            fine[texel] = 0.0
        for i in range(height // step):
            for column in range(width):
                along[column] = 0.0
            for j in range(width // step):
                value = coarse[(plane * (height // step) + i) * (width // step) + j]
                for q in range(4 * step):
                    along[around(step * j - 3 * step // 2 + q, width)] += stencil[q] * value
            for q in range(4 * step):
                row, turn = over_poles(step * i - 3 * step // 2 + q, height, width)
                o, weight = (plane * height + row) * width, stencil[q]
                for column in range(width - turn):
                    fine[o + column + turn] += weight * along[column]
                for column in range(turn):
                    fine[o + column] += weight * along[width - turn + column]
