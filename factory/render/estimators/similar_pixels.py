"""The loop of factory.render.estimators.lost_detail, compiled by numba."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def average_similar(
    values: np.ndarray, features: np.ndarray, mask: np.ndarray, near: np.ndarray, power: int
) -> np.ndarray:
    """Return the means of values (height, width, 3) over similar pixels; 0 outside the mask.

    values    float32
    features  (height, width, F) float32, in units of their weights' standard deviations
    mask      (height, width) bool, the pixels that count
    near      (R + 1,) float32 weights of pixels 0 … R rows or columns away
    power     of the weights (lost_detail.POWER)
    """
    height, width = mask.shape
    radius, count = len(near) - 1, features.shape[2]
    scale = np.float32(1 / (2 * power))
    out = np.zeros_like(values)
    for row in range(height):
        for column in range(width):
            if not mask[row, column]:
                continue
            total = red = green = blue = np.float32(0)
            for y in range(max(row - radius, 0), min(row + radius + 1, height)):
                for x in range(max(column - radius, 0), min(column + radius + 1, width)):
                    if not mask[y, x]:
                        continue
                    square = np.float32(0)
                    for f in range(count):
                        step = features[y, x, f] - features[row, column, f]
                        square += step * step
                    left = np.float32(1) - square * scale
                    if left <= 0:
                        continue
                    weight = near[abs(y - row)] * near[abs(x - column)]
                    for _ in range(power):
                        weight *= left
                    total += weight
                    red += weight * values[y, x, 0]
                    green += weight * values[y, x, 1]
                    blue += weight * values[y, x, 2]
            out[row, column, 0] = red / total
            out[row, column, 1] = green / total
            out[row, column, 2] = blue / total
    return out
