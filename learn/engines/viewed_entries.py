"""Entries of a tile's list for a view per pixel, and which of the tile's pixels they matter to.

Letters, arrays and formulas as in learn.engines.viewed_lists, which makes the lists.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.layout import (
    CULLED_NORMALS,
    CULLED_TILE,
    CUT_AXIS,
    CUT_REACH,
    ENERGY_STRIDE,
    GENERAL_STRIDE,
    LANES,
    VIEW_CUTS,
    VIEW_VIEWS,
)
from learn.engines.triples import dot
from learn.engines.vector import bits, fma, load, sqrt


class Arrays(NamedTuple):
    """What both passes read: the arrays of that name, cuts as of learn.engines.viewed_lists."""

    n: np.ndarray
    geometry: np.ndarray
    energy: np.ndarray
    values: np.ndarray
    cuts: np.ndarray


class Entry(NamedTuple):
    """An entry of a tile's list: a block of lights that may matter to the tile.

    place   its number in cuts
    o, e    offsets of the block in geometry and in energy
    lowest  the log2 c above which some lobe counts
    """

    place: int
    o: int
    e: int
    lowest: float


class Run(NamedTuple):
    """The pixels of a run that an entry's block can matter to.

    start     number of the first pixel of the run's tile
    first     number of the run's first pixel in the tile
    near      which of the run's pixels, as bits
    furthest  the largest ‖d‖
    alone     whether the run is one pixel, whose lobes need no slopes
    """

    start: int
    first: int
    near: int
    furthest: float
    alone: bool


@inlined
def lowest_cut(cuts: np.ndarray, entry: int, many: int) -> float:
    """The log2 c above which some lobe of a list's entry counts."""
    lowest = cuts[VIEW_CUTS * entry]
    for s in range(1, many):
        lowest = min(lowest, cuts[VIEW_CUTS * entry + s])
    return lowest


@inlined
def entry_at(place: int, entries: np.ndarray, cuts: np.ndarray, many: int) -> Entry:
    """The list's entry of that number."""
    block = entries[place]
    lowest = lowest_cut(cuts, place, many)
    return Entry(place, GENERAL_STRIDE * block, ENERGY_STRIDE * block, lowest)


@inlined
def pixels_near(scratch: np.ndarray, o: int, count: int, cuts: np.ndarray, entry: int) -> int:
    """Which of sixteen pixels (at most `count`) an entry's block can matter to, as bits.

    o  offset of their normals; their views are VIEW_VIEWS − CULLED_NORMALS behind
    """
    x, y, z = load(scratch, o), load(scratch, o + CULLED_TILE), load(scratch, o + 2 * CULLED_TILE)
    a, v = VIEW_CUTS * entry + CUT_AXIS, o + VIEW_VIEWS - CULLED_NORMALS
    sx = cuts[a] + load(scratch, v)
    sy = cuts[a + 1] + load(scratch, v + CULLED_TILE)
    sz = cuts[a + 2] + load(scratch, v + 2 * CULLED_TILE)
    along = fma(x, sx, fma(y, sy, z * sz))
    near = along > sqrt(dot((sx, sy, sz), (sx, sy, sz))) * cuts[VIEW_CUTS * entry + CUT_REACH]
    return bits(near) & ((1 << min(LANES, count)) - 1)


@inlined
def unpack_views(v: np.ndarray, start: int, count: int, scratch: np.ndarray, o: int) -> None:
    """Write a tile's views as three rows at offset o."""
    for j in range(CULLED_TILE):
        for i in range(3):
            scratch[o + CULLED_TILE * i + j] = (
                v[3 * (start + j) + i] if j < count else types.float32(0.0)
            )
