"""Rays against triangles, compiled by numba: a tree of boxes, and whether anything is in the way.

Blender's own tree (mathutils.bvhtree) answers the same, but takes one ray for each call from
Python, which is nine times as slow (docs/log/rendering.md).

They are in one file because numba compiles a cached kernel again only when the file that defines it
has changed, not when another file whose functions it contains has.

The tree is a bounding volume hierarchy that is divided by the surface area heuristic over BINS
intervals of each axis (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies").
A ray is tested against both children of a box, the nearer one first, and stops at the first hit. A
triangle is met as Möller and Trumbore (1997) have it.

boxes      (N, 6) least and largest corner of each node
first      (N,) of a leaf its first triangle, of another node the first of its two children
count      (N,) triangles of a leaf; 0: two children
triangles  (F, 9) a corner and the two edges that leave it, in the order of the leaves
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shaders import tone

LEAF = 4  # triangles of a leaf, at most
BINS = 16  # intervals of an axis at whose ends a node may be divided
DEEPEST = 128  # nodes that wait at once; more than any tree of float32 boxes has needed
ONE = np.float32(1)
ZERO = np.float32(0)
HUGE = np.float32(1e30)
# a box's sides are met within this share, so that no ray slips between two boxes that touch
LOOSE = np.float32(1.00001)
LUMINANCE = tuple(np.float32(share) for share in tone.LUMINANCE)


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


@njit(inline="always", fastmath=True, error_model="numpy")
def _distance(node, boxes, o, inverse):
    """Return where a ray enters a node's box, HUGE where it does not."""
    enter, leave = ZERO, HUGE
    for axis in range(3):
        one = (boxes[node, axis] - o[axis]) * inverse[axis]
        other = (boxes[node, axis + 3] - o[axis]) * inverse[axis]
        enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
    return enter if enter <= leave * LOOSE else HUGE


@njit(inline="always", fastmath=True, error_model="numpy")
def _meets(t, o, d):
    """Return whether a ray from o in direction d meets triangle t (9,)."""
    px, py, pz = d[1] * t[8] - d[2] * t[7], d[2] * t[6] - d[0] * t[8], d[0] * t[7] - d[1] * t[6]
    determinant = t[3] * px + t[4] * py + t[5] * pz
    if determinant == 0:
        return False
    inverse = ONE / determinant
    x, y, z = o[0] - t[0], o[1] - t[1], o[2] - t[2]
    u = (x * px + y * py + z * pz) * inverse
    qx, qy, qz = y * t[5] - z * t[4], z * t[3] - x * t[5], x * t[4] - y * t[3]
    v = (d[0] * qx + d[1] * qy + d[2] * qz) * inverse
    far = (t[6] * qx + t[7] * qy + t[8] * qz) * inverse
    return u >= 0 and v >= 0 and u + v <= ONE and far > 0


@njit(inline="always", fastmath=True, error_model="numpy")
def _is_blocked(o, d, inverse, boxes, first, count, triangles, waiting):
    """Return whether a ray from o (3,) in direction d (3,) meets any triangle."""
    for axis in range(3):  # a product with 0 · ∞ would be no number
        step = d[axis] if abs(d[axis]) > np.float32(1e-12) else np.float32(1e-12)
        inverse[axis] = ONE / step
    waits, node = 0, 0
    while True:
        if count[node]:
            for t in range(first[node], first[node] + count[node]):
                if _meets(triangles[t], o, d):
                    return True
        else:
            a, b = first[node], first[node] + 1
            to_a, to_b = _distance(a, boxes, o, inverse), _distance(b, boxes, o, inverse)
            if to_a < HUGE or to_b < HUGE:
                if to_a <= to_b:
                    near, far, further = a, b, to_b
                else:
                    near, far, further = b, a, to_a
                if further < HUGE:
                    waiting[waits] = far
                    waits += 1
                node = near
                continue
        if waits == 0:
            return False
        waits -= 1
        node = waiting[waits]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def are_blocked(
    origins: np.ndarray,
    towards: np.ndarray,
    boxes: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    triangles: np.ndarray,
    out: np.ndarray,
) -> None:
    """Set out (R,) bool to whether rays from origins (R, 3) in directions (R, 3) meet anything."""
    waiting = np.empty(DEEPEST, np.int32)
    inverse = np.empty(3, np.float32)
    for i in range(len(origins)):
        out[i] = _is_blocked(
            origins[i], towards[i], inverse, boxes, first, count, triangles, waiting
        )


@njit(inline="always")
def _hash(x):
    """Return 32 mixed bits of 32 (Wellons 2018, "Prospecting for hash functions", lowbias32)."""
    x = np.uint32(x)
    x ^= x >> np.uint32(16)
    x = np.uint32(x * np.uint32(0x7FEB352D))
    x ^= x >> np.uint32(15)
    x = np.uint32(x * np.uint32(0x846CA68B))
    x ^= x >> np.uint32(16)
    return x


@njit(inline="always")
def _unit(x):
    """Return a number in [0, 1) of 32 bits."""
    return np.float64(np.uint32(x)) * 2.0**-32


@njit(inline="always", fastmath=True, error_model="numpy")
def _direction(patch, u, v, rotation, d):
    """Set d (3,) to a direction of a patch of the light, which is uniform in solid angle.

    patch  (4,) cosines of the polar angle at its top and bottom, azimuths of its sides
    """
    height = patch[0] + (patch[1] - patch[0]) * np.float32(u)
    turn = patch[2] + (patch[3] - patch[2]) * np.float32(v)
    across = math.sqrt(max(ZERO, ONE - height * height))
    x, z = across * math.cos(turn), across * math.sin(turn)
    for axis in range(3):
        d[axis] = rotation[axis, 0] * x + rotation[axis, 1] * height + rotation[axis, 2] * z


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def cast(
    light: np.ndarray,
    patches: np.ndarray,
    order: np.ndarray,
    rotation: np.ndarray,
    firsts: np.ndarray,
    members: np.ndarray,
    origins: np.ndarray,
    facets: np.ndarray,
    margin: np.float32,
    pixels: np.ndarray,
    turns: np.ndarray,
    strata: np.ndarray,
    rays: int,
    seed: int,
    boxes: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    triangles: np.ndarray,
    arrived: np.ndarray,
    sent: np.ndarray,
) -> None:
    """Cast rays from points towards the light that they reflect, and add what arrives.

    Directions are drawn in proportion to the luminance of what each would add to the picture.

    light     (G, 3, T) what each patch of the light adds to the picture at each group's normal
    patches   (T, 4) as `_direction` takes them
    order     (T,) of the patches, in which neighbours are near
    rotation  (3, 3) from the light's frame to that of the triangles
    firsts    (G + 1,) of each group's points in members (P,), which numbers points
    origins, facets  (P, 3) of points, in the triangles' frame; facets are the surface's own normals
    margin    by which rays begin beside the surface
    pixels    (P,) of points; turns (P,): their numbers 0 … strata − 1 within the pixel
    strata    (pixels,) points of each pixel, which with `rays` each divide the light equally
    arrived, sent  (pixels, 3), to which the light of rays is added that arrives, and of all
    """
    many = light.shape[2]
    cumulated = np.empty(many, np.float64)
    waiting = np.empty(DEEPEST, np.int32)
    inverse = np.empty(3, np.float32)
    d = np.empty(3, np.float32)
    o = np.empty(3, np.float32)
    for g in range(len(firsts) - 1):
        total = 0.0
        for k in range(many):
            t = order[k]
            for c in range(3):
                total += LUMINANCE[c] * light[g, c, t]
            cumulated[k] = total
        if total <= 0:
            continue
        for member in range(firsts[g], firsts[g + 1]):
            i = members[member]
            p = pixels[i]
            number = strata[p] * rays
            shift = _hash(np.uint32(p) * np.uint32(0x9E3779B9) + np.uint32(seed))
            for r in range(rays):
                j = turns[i] * rays + r
                random = _hash(shift + np.uint32(j) * np.uint32(0x85EBCA6B) + np.uint32(1))
                # an odd step visits all strata of a power of two once
                stratum = (j * 5 + int(shift)) % number
                u = (stratum + _unit(random)) / number * total
                t = order[min(np.searchsorted(cumulated, u, side="right"), many - 1)]
                random = _hash(random + np.uint32(1))
                v = _unit(random)
                _direction(patches[t], v, _unit(_hash(random + np.uint32(1))), rotation, d)
                side = facets[i, 0] * d[0] + facets[i, 1] * d[1] + facets[i, 2] * d[2]
                step = margin if side >= 0 else -margin
                for axis in range(3):
                    o[axis] = origins[i, axis] + step * facets[i, axis]
                luminance = ZERO
                for c in range(3):
                    luminance += LUMINANCE[c] * light[g, c, t]
                blocked = _is_blocked(o, d, inverse, boxes, first, count, triangles, waiting)
                for c in range(3):
                    weight = total * light[g, c, t] / luminance
                    sent[p, c] += weight
                    if not blocked:
                        arrived[p, c] += weight
