"""Cones of unit vectors: one about vectors, and bounds on the cosines between two of them.

A cone is an axis with the cosine and sine of its half angle. Bounds err by SLACK to the safe side.
"""

import math

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.layout import LANES
from learn.engines.vector import Lanes, fma, load, maximum, minimum, single, sqrt
from learn.engines.vector import select as choose

WIDENED = 1e-4  # radians by which a cone about vectors is widened against rounding
SLACK = 2e-6  # on cosines, for rounding

# the axis, and the cosine and sine of the half angle
Cone = tuple[float, float, float, float, float]


@inlined
def cone_about(n: np.ndarray, start: int, count: int) -> Cone:
    """Axis, cosine and sine of the half angle of a cone about vectors, slightly widened.

    n  (P, 3) unit vectors, of which `count` from `start` on are in the cone
    """
    x, y, z = 0.0, 0.0, 0.0
    for p in range(start, start + count):
        x, y, z = x + n[3 * p], y + n[3 * p + 1], z + n[3 * p + 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-6:  # vectors that cancel: the whole sphere
        return single(0.0), single(0.0), single(1.0), single(-1.0), single(0.0)
    x, y, z, least = x / length, y / length, z / length, 1.0
    for p in range(start, start + count):
        least = min(least, x * n[3 * p] + y * n[3 * p + 1] + z * n[3 * p + 2])
    sine = math.sqrt(max(1.0 - least * least, 0.0))
    wider, further = least - WIDENED * sine, sine + WIDENED * least
    if wider < -1.0 or further < 0.0:
        wider, further = -1.0, 0.0
    return single(x), single(y), single(z), single(wider), single(further)


@inlined
def along_axis(cones: np.ndarray, o: int, x: float, y: float, z: float) -> Lanes:
    """Cosines of a direction with sixteen axes, whose three rows begin at offset o."""
    return fma(load(cones, o), x, fma(load(cones, o + LANES), y, load(cones, o + 2 * LANES) * z))


@inlined
def nearest_cosine(axis: Lanes, cos_a: Lanes, sin_a: Lanes, cos_b: Lanes, sin_b: Lanes) -> Lanes:
    """Largest cosine between a vector of one cone and one of the other.

    axis  cosine between their axes
    Half angles (in [0, π]) that sum to π or more leave no gap between the cones. There the cosine
    of the sum is no bound: beyond π it rises again. a + b ≥ π where cos a ≤ cos(π − b) = −cos b.
    """
    cos_sum, sin_sum = cos_a * cos_b - sin_a * sin_b, sin_a * cos_b + cos_a * sin_b
    nearest = fma(axis, cos_sum, sqrt(maximum(1.0 - axis * axis, 0.0)) * sin_sum)
    nearest = choose(axis > cos_sum, 1.0, minimum(nearest + SLACK, 1.0))
    return choose(cos_a + cos_b > 0.0, nearest, 1.0)
