"""Pixels that are points: where Cycles' pixel shows surfaces besides the point's.

Cycles' narrowest pixel filter is a bell with a standard deviation of 0.0025 pixels. Beside an edge,
some of its rays therefore meet other surfaces than the one through the pixel's centre. Geometry is
seen through points that stand for equal parts of the bell, and the shares that meet other surfaces
are counted.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from manifests.facets import OTHERS
from shaders.normal_groups import FACING

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


def others(
    centre: Seen, around: Sequence[Seen], most: int = OTHERS
) -> tuple[np.ndarray, list[Seen]]:
    """Return which shares of a pixel show other surfaces than its centre, and those surfaces.

    Points of one surface have like normals and facets, of which all face the viewer or all face
    away. A surface is as the point nearest to the centre sees it. Points that meet further
    surfaces than `most` count to the one whose normal is most alike.

    around   what rays through `offsets` meet, the nearest to the centre first
    Returns  shares (most, height, width) float32, 0 outside the centre's mask; `most` surfaces
    """
    shares = np.zeros((most, *centre.mask.shape), np.float32)
    surfaces = [Seen(*(np.zeros_like(values) for values in centre)) for _ in range(most)]
    beside = centre.mask & np.any([~_alike(centre, each) for each in around], axis=0)
    rows = np.nonzero(beside)
    if not len(rows[0]):
        return shares, surfaces
    surfaces_seen = [Seen(*(values[rows] for values in each)) for each in (centre, *surfaces)]
    counts = np.zeros((most + 1, len(rows[0])), np.int64)
    known = np.zeros_like(counts, bool)
    known[0] = True
    every = np.arange(len(rows[0]))
    for each in around:
        here = Seen(*(values[rows] for values in each))
        alike = known & np.array([_alike(one, here) for one in surfaces_seen])
        # the background has no normal: a product below any of two normals keeps it separate
        near = np.array(
            [np.where(one.mask & here.mask, _cosine(one, here), -2) for one in surfaces_seen]
        )
        new = ~alike.any(0) & ~known.all(0)
        first = np.argmin(known, axis=0)
        nearest = np.argmax(np.where(alike.any(0), alike, known) * (near + 3), axis=0)
        counts[np.where(new, first, nearest), every] += 1
        for k, one in enumerate(surfaces_seen):
            added = new & (first == k)
            known[k] |= added
            for values, theirs in zip(one, here, strict=True):
                values[added] = theirs[added]
    for k, (one, all_pixels) in enumerate(zip(surfaces_seen[1:], surfaces, strict=True)):
        shares[k][rows] = counts[k + 1] / len(around)
        for values, theirs in zip(all_pixels, one, strict=True):
            values[rows] = theirs
    return shares, surfaces


def _cosine(one: Seen, other: Seen) -> np.ndarray:
    """Return the cosines (…) between two surfaces' normals."""
    return np.einsum("...i,...i->...", one.normals, other.normals)


def _alike(one: Seen, other: Seen) -> np.ndarray:
    """Return whether two points' surfaces (…) count as one; two of the background do."""
    same = (
        (one.segments == other.segments)
        & (_cosine(one, other) > SAME_NORMAL)
        & (np.einsum("...i,...i->...", one.facets, other.facets) > SAME_FACET)
        & ((one.normals[..., 2] < FACING) == (other.normals[..., 2] < FACING))
    )
    return np.where(one.mask & other.mask, same, one.mask == other.mask)
