"""A tree of boxes over triangles, built by numba.

It is a bounding volume hierarchy that is divided by the surface area heuristic over BINS intervals
of each axis (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies").

boxes      (N, 6) least and largest corner of each node
first      (N,) of a leaf its first triangle, of another node the first of its two children
count      (N,) triangles of a leaf; 0: two children
"""

from __future__ import annotations

import numpy as np
from numba import njit

LEAF = 4  # triangles of a leaf, at most
BINS = 16  # intervals of an axis at whose ends a node may be divided
DEEPEST = 128  # nodes that wait at once; more than any tree of float32 boxes has needed
HUGE = np.float32(1e30)


@njit(inline="always")
def _half_area(low, high):
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    return x * y + y * z + z * x


@njit(inline="always")
def _include(low, high, other_low, other_high):
    for axis in range(3):
        low[axis] = min(low[axis], other_low[axis])
        high[axis] = max(high[axis], other_high[axis])


@njit(inline="always")
def _bin(centre, least, extent):
    return min(int((centre - least) / extent * BINS), BINS - 1)


@njit(inline="always")
def _best_division(low, high, order, begin, end, least, most):
    """Return axis and last interval of the division of least cost; axis −1: there is none."""
    best, best_axis, best_bin = HUGE, -1, 0
    lows = np.empty((BINS, 3), np.float32)
    highs = np.empty((BINS, 3), np.float32)
    counts = np.empty(BINS, np.int64)
    areas = np.empty(BINS, np.float32)
    beyond = np.empty(BINS, np.int64)
    some_low, some_high = np.empty(3, np.float32), np.empty(3, np.float32)
    for axis in range(3):
        extent = most[axis] - least[axis]
        if extent <= 0:
            continue
        counts[:] = 0
        lows[:] = HUGE
        highs[:] = -HUGE
        for i in range(begin, end):
            t = order[i]
            b = _bin((low[t, axis] + high[t, axis]) / 2, least[axis], extent)
            counts[b] += 1
            _include(lows[b], highs[b], low[t], high[t])
        some_low[:] = HUGE
        some_high[:] = -HUGE
        total = 0
        for b in range(BINS - 1, 0, -1):
            _include(some_low, some_high, lows[b], highs[b])
            total += counts[b]
            areas[b], beyond[b] = _half_area(some_low, some_high), total
        some_low[:] = HUGE
        some_high[:] = -HUGE
        total = 0
        for b in range(BINS - 1):
            _include(some_low, some_high, lows[b], highs[b])
            total += counts[b]
            if total == 0 or beyond[b + 1] == 0:
                continue
            cost = _half_area(some_low, some_high) * total + areas[b + 1] * beyond[b + 1]
            if cost < best:
                best, best_axis, best_bin = cost, axis, b
    return best_axis, best_bin


@njit(cache=True, nogil=True)
def build_tree(
    low: np.ndarray,
    high: np.ndarray,
    order: np.ndarray,
    boxes: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
) -> int:
    """Fill a tree over the boxes of triangles, and return its number of nodes.

    low, high  (F, 3) float32 corners of each triangle's box
    order      (F,) numbers of the triangles, which are put into the order of the leaves
    boxes, first, count  room for 2 F nodes
    """
    waiting = np.empty((DEEPEST, 3), np.int64)
    waiting[0] = 0, 0, len(order)
    waits, used = 1, 1
    least, most = np.empty(3, np.float32), np.empty(3, np.float32)
    while waits:
        waits -= 1
        node, begin, end = waiting[waits]
        boxes[node, :3], boxes[node, 3:] = HUGE, -HUGE
        least[:], most[:] = HUGE, -HUGE
        for i in range(begin, end):
            t = order[i]
            _include(boxes[node, :3], boxes[node, 3:], low[t], high[t])
            centre = (low[t] + high[t]) / np.float32(2)
            _include(least, most, centre, centre)
        first[node], count[node] = begin, end - begin
        if end - begin <= LEAF:
            continue
        axis, last = _best_division(low, high, order, begin, end, least, most)
        middle = (begin + end) // 2
        # a tree of equal halves is shallow enough; one that goes deeper is divided in the middle
        if axis >= 0 and waits < DEEPEST // 2:
            extent = most[axis] - least[axis]
            i, j = begin, end - 1
            while i <= j:
                t = order[i]
                if _bin((low[t, axis] + high[t, axis]) / 2, least[axis], extent) <= last:
                    i += 1
                else:
                    order[i], order[j] = order[j], order[i]
                    j -= 1
            middle = i
        first[node], count[node] = used, 0
        waiting[waits] = used, begin, middle
        waiting[waits + 1] = used + 1, middle, end
        waits += 2
        used += 2
    return used
