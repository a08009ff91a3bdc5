"""Pixels that are points: where Cycles' pixel shows a second surface besides the point's.

Cycles' narrowest pixel filter is a bell with a standard deviation of 0.0025 pixels. Beside an edge,
some of its rays therefore meet another surface than the one through the pixel's centre. Geometry is
seen through points that stand for equal parts of the bell, and the share that meets another surface
is counted.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

DEVIATION = 0.0025  # pixels
COUNT = 32  # points; a step of 1/32 in the share of a pixel that lies beside an upright edge
# Cycles looks its filters up in a table whose middle lies half an entry away from the centre: with
# a BOX filter, the first sample goes by so many pixels to the right of it and above it
BOX_SHIFT = 0.25 / 511
# within these, normals and facets count as those of one surface: on small roundings they turn fast
SAME_NORMAL = float(np.cos(np.radians(3.0)))
SAME_FACET = float(np.cos(np.radians(10.0)))


def offsets() -> list[tuple[float, float]]:
    """Return the points' places (rightwards, upwards) in pixels, the nearest to the centre first.

    They form a lattice, so that across an edge of any direction they lie at many distances from it:
    edges of upright objects are upright in every view, and whole columns of pixels lie beside them.
    """
    bell, golden = NormalDist(0, DEVIATION), (math.sqrt(5) - 1) / 2
    places = [
        (bell.inv_cdf((k + 0.5) / COUNT), bell.inv_cdf((0.5 + k * golden) % 1))
        for k in range(COUNT)
    ]
    return sorted(places, key=lambda at: at[0] ** 2 + at[1] ** 2)


class Seen(NamedTuple):
    """What rays through one point of each pixel meet; 0 outside the mask.

    mask (height, width), normals and facets (height, width, 3), segments (height, width)
    """

    mask: np.ndarray
    normals: np.ndarray
    facets: np.ndarray
    segments: np.ndarray


def other(centre: Seen, around: Sequence[Seen]) -> tuple[np.ndarray, Seen]:
    """Return which share of a pixel shows another surface than its centre, and that surface.

    around   what rays through `offsets` meet
    Returns  share (height, width) float32, 0 outside the centre's mask; the nearest other surface
    """
    count = np.zeros(centre.mask.shape, np.float32)
    second = Seen(*(np.zeros_like(values) for values in centre))
    for each in around:
        differs = centre.mask & ~(
            (centre.segments == each.segments)
            & (np.einsum("hwi,hwi->hw", centre.normals, each.normals) > SAME_NORMAL)
            & (np.einsum("hwi,hwi->hw", centre.facets, each.facets) > SAME_FACET)
        )
        first = differs & (count == 0)
        for values, theirs in zip(second, each, strict=True):
            values[first] = theirs[first]
        count += differs
    return count / len(around), second
