"""Rays against triangles, compiled by numba: what they meet, and whether anything is in the way.

Blender's own tree (mathutils.bvhtree) answers the same, but takes one ray for each call from
Python, which is nine times as slow (docs/log/rendering.md).

They are in one file because numba compiles a cached kernel again only when the file that defines it
has changed, not when another file whose functions it contains has.

A ray is tested against both children of a box, the nearer one first; towards the light it stops at
the first hit. A triangle is met as Möller and Trumbore (1997) have it.

boxes, first, count  of the tree (factory.render.tree_kernels)
triangles  (F, 9) a corner and the two edges that leave it, in the order of the leaves
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shaders import tone

DEEPEST = 128  # nodes that wait at once, as for the tree
ONE = np.float32(1)
ZERO = np.float32(0)
HUGE = np.float32(1e30)
# a box's sides are met within this share, so that no ray slips between two boxes that touch
LOOSE = np.float32(1.00001)
# the same between two triangles that share an edge, in units of the edges, for rays that see:
# quads are divided along diagonals on which whole rows of a grid's points may lie
BESIDE = np.float32(1e-6)
# of light at a group's normal, below which a point's own counts as the group's; and how many times
# as much the light counts at most
LEAST_COSINE, MOST_TIMES = np.float32(0.01), np.float32(4)
GOLDEN = (math.sqrt(5) - 1) / 2  # whose multiples cover a circle evenly
LUMINANCE = tuple(np.float32(share) for share in tone.LUMINANCE)


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
def _meet(t, o, d):
    """Return how far along a ray from o in direction d it meets the plane of triangle t (9,).

    Returns  distance, and u and v, the places along the two edges; −1 where there is no such place
    """
    px, py, pz = d[1] * t[8] - d[2] * t[7], d[2] * t[6] - d[0] * t[8], d[0] * t[7] - d[1] * t[6]
    determinant = t[3] * px + t[4] * py + t[5] * pz
    if determinant == 0:
        return -ONE, -ONE, -ONE
    inverse = ONE / determinant
    x, y, z = o[0] - t[0], o[1] - t[1], o[2] - t[2]
    u = (x * px + y * py + z * pz) * inverse
    qx, qy, qz = y * t[5] - z * t[4], z * t[3] - x * t[5], x * t[4] - y * t[3]
    v = (d[0] * qx + d[1] * qy + d[2] * qz) * inverse
    return (t[6] * qx + t[7] * qy + t[8] * qz) * inverse, u, v


@njit(inline="always", fastmath=True, error_model="numpy")
def _inverse(d, inverse):
    """Set inverse (3,) to 1/d: a product with 0 · ∞ would be no number."""
    for axis in range(3):
        step = d[axis] if abs(d[axis]) > np.float32(1e-12) else np.float32(1e-12)
        inverse[axis] = ONE / step


@njit(inline="always", fastmath=True, error_model="numpy")
def _is_blocked(o, d, inverse, boxes, first, count, triangles, waiting):
    """Return whether a ray from o (3,) in direction d (3,) meets any triangle."""
    _inverse(d, inverse)
    waits, node = 0, 0
    while True:
        if count[node]:
            for t in range(first[node], first[node] + count[node]):
                far, u, v = _meet(triangles[t], o, d)
                if u >= 0 and v >= 0 and u + v <= ONE and far > 0:
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


@njit(inline="always", fastmath=True, error_model="numpy")
def _nearest(o, d, inverse, boxes, first, count, triangles, waiting, entries):
    """Return the number of the triangle that a ray from o in direction d meets first, −1: none.

    Returns  the number; the distance; and u and v, the places along the triangle's two edges
    """
    met, nearest, at_u, at_v = -1, HUGE, ZERO, ZERO
    waits, node = 0, 0
    while True:
        if count[node]:
            for t in range(first[node], first[node] + count[node]):
                far, u, v = _meet(triangles[t], o, d)
                inside = u >= -BESIDE and v >= -BESIDE and u + v <= ONE + BESIDE
                if inside and ZERO < far < nearest:
                    met, nearest, at_u, at_v = t, far, u, v
        else:
            a, b = first[node], first[node] + 1
            to_a, to_b = _distance(a, boxes, o, inverse), _distance(b, boxes, o, inverse)
            if to_b < to_a:
                a, b, to_a, to_b = b, a, to_b, to_a
            if to_a < HUGE and to_a <= nearest * LOOSE:
                if to_b < HUGE:
                    waiting[waits], entries[waits] = b, to_b
                    waits += 1
                node = a
                continue
        while waits and entries[waits - 1] > nearest * LOOSE:
            waits -= 1
        if waits == 0:
            break
        waits -= 1
        node = waiting[waits]
    return met, nearest, at_u, at_v


@njit(inline="always", fastmath=True, error_model="numpy")
def _lift(rising, side, weights):
    """Return how far a smooth surface lies above its facet, along the interpolated normal.

    It is half of the height of a parabola through the corners, and at least that of the lowest of
    three planes: those that the corners' normals have, raised until no corner is above them. By
    this Cycles lifts the origins of shadow rays, so that coarse meshes do not shade themselves at
    their edges (shadow_terminator_geometry_offset).

    rising   (3, 3) how far corner j lies above the plane of corner k, seen from the side 1
    side     that is seen, 1 or −1
    weights  (3,) of the corners at the point
    """
    pairs, lowest = ZERO, HUGE
    for k in range(3):
        highest, here = ZERO, ZERO
        for j in range(3):
            above = side * rising[k, j]
            highest = max(highest, above)
            here += weights[j] * above
        pairs += weights[k] * here
        lowest = min(lowest, max(highest - here, ZERO))
    return max(lowest, -pairs / 2)


@njit(cache=True, nogil=True)
def lift(rising: np.ndarray, side: np.float32, weights: np.ndarray) -> float:
    """Return what `_lift` does, for one point."""
    return _lift(rising, side, weights)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def look(
    columns: np.ndarray,
    row: int,
    across: int,
    corner: np.ndarray,
    step: np.float32,
    rotation: np.ndarray,
    boxes: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    triangles: np.ndarray,
    corner_normals: np.ndarray,
    facet_normals: np.ndarray,
    rising: np.ndarray,
    segment: np.ndarray,
    mask: np.ndarray,
    normals: np.ndarray,
    facets: np.ndarray,
    depth: np.ndarray,
    segments: np.ndarray,
    lifts: np.ndarray,
) -> int:
    """Find what the points of some pixels of one row see; return how many see anything.

    Points are a grid, in whose order those that see something are written to normals, facets,
    depth, segments and lifts, as factory.render.geometry.Surface has them.

    columns   (N,) of the pixels, rising; row: theirs
    across    points along each side of a pixel
    corner    (3,) place of the grid's first point, x and y in the camera frame, and how far away
              the rays begin
    step      between points
    rotation  (3, 3) from the object's frame to the camera's
    corner_normals (F, 3, 3), facet_normals (F, 3), rising (F, 3, 3) as `_lift` has them, and
              segment (F,) of the triangles, in the object's frame
    mask      (height · across, width · across) bool, set where points see something
    """
    waiting = np.empty(DEEPEST, np.int32)
    entries = np.empty(DEEPEST, np.float32)
    inverse, o, d, weights = (
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
    )
    for axis in range(3):
        d[axis] = -rotation[2, axis]
    _inverse(d, inverse)
    seen = 0
    for fine_row in range(row * across, (row + 1) * across):
        y = corner[1] - np.float32(fine_row) * step
        for column in columns:
            for fine_column in range(column * across, (column + 1) * across):
                x = corner[0] + np.float32(fine_column) * step
                for axis in range(3):
                    o[axis] = (
                        x * rotation[0, axis]
                        + y * rotation[1, axis]
                        + corner[2] * rotation[2, axis]
                    )
                t, far, u, v = _nearest(
                    o, d, inverse, boxes, first, count, triangles, waiting, entries
                )
                if t < 0:
                    continue
                mask[fine_row, fine_column] = True
                weights[0], weights[1], weights[2] = ONE - u - v, u, v
                side = ZERO
                for axis in range(3):
                    side += rotation[2, axis] * facet_normals[t, axis]
                side = -ONE if side < 0 else ONE
                square = ZERO
                for axis in range(3):
                    o[axis] = ZERO
                    for k in range(3):
                        o[axis] += weights[k] * corner_normals[t, k, axis]
                    square += o[axis] ** 2
                length = np.float32(max(math.sqrt(square), 1e-12))
                for axis in range(3):
                    normal, facet = ZERO, ZERO
                    for k in range(3):
                        normal += rotation[axis, k] * o[k]
                        facet += rotation[axis, k] * facet_normals[t, k]
                    normals[seen, axis] = normal * side / length
                    facets[seen, axis] = facet * side
                depth[seen] = -corner[2] + far
                segments[seen] = segment[t]
                lifts[seen] = _lift(rising[t], side, weights) * length
                seen += 1
    return seen


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


@njit(inline="always")
def _stratum(j, number, shift):
    """Return which of so many strata a pixel's ray j is drawn from; each is drawn from once."""
    step = 5 if number % 5 else 7 if number % 7 else 11 if number % 11 else 1
    return (j * step + shift) % number


@njit(cache=True, nogil=True)
def draw_places(
    pixels: np.ndarray, turns: np.ndarray, strata: np.ndarray, rays: int, seed: int, out: np.ndarray
) -> None:
    """Set out (P, rays, 2) to numbers in [0, 1) that cover them evenly in each pixel.

    pixels, turns, strata, seed  as `cast` takes them
    """
    for i in range(len(pixels)):
        p = pixels[i]
        number = strata[p] * rays
        shift = _hash(np.uint32(p) * np.uint32(0x9E3779B9) + np.uint32(seed))
        turned = _unit(_hash(shift + np.uint32(1)))
        for r in range(rays):
            j = turns[i] * rays + r
            random = _hash(shift + np.uint32(j) * np.uint32(0x85EBCA6B) + np.uint32(1))
            out[i, r, 0] = (_stratum(j, number, int(shift)) + _unit(random)) / number
            out[i, r, 1] = (turned + j * GOLDEN) % 1


@njit(inline="always", fastmath=True, error_model="numpy")
def _set_origin(o, origin, d, facet, normal, lift, grazing, margin):
    """Set o (3,) to where a ray in direction d begins; the rest as `cast` has it of one point."""
    side = facet[0] * d[0] + facet[1] * d[1] + facet[2] * d[2]
    above = normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2]
    amount = ONE - side / grazing
    if above < grazing:
        amount += ONE - above / grazing
    up = min(max(amount, ZERO), ONE) * lift
    step = margin
    if side < 0:  # what is lifted may meet its own facet
        step = ZERO if up > 2 * margin else -margin
    for axis in range(3):
        o[axis] = origin[axis] + step * facet[axis] + up * normal[axis]
    return side


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def cast_drawn(
    towards: np.ndarray,
    radiance: np.ndarray,
    rotation: np.ndarray,
    members: np.ndarray,
    origins: np.ndarray,
    facets: np.ndarray,
    normals: np.ndarray,
    lift: np.ndarray,
    grazing: np.float32,
    margin: np.float32,
    pixels: np.ndarray,
    boxes: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    triangles: np.ndarray,
    arrived: np.ndarray,
    sent: np.ndarray,
) -> None:
    """Cast rays of points in directions that are known, and add what arrives.

    towards   (M, J, 3) directions of each of the points whose numbers are members (M,)
    radiance  (M, J, 3) what each adds to the picture
    rotation  (3, 3) from the directions' frame to that of the triangles
    The rest as `cast` takes it.
    """
    waiting = np.empty(DEEPEST, np.int32)
    inverse = np.empty(3, np.float32)
    d = np.empty(3, np.float32)
    o = np.empty(3, np.float32)
    for m in range(len(members)):
        i = members[m]
        p = pixels[i]
        for j in range(towards.shape[1]):
            value = radiance[m, j]
            if value[0] + value[1] + value[2] <= 0:
                continue
            w = towards[m, j]
            for axis in range(3):
                row = rotation[axis]
                d[axis] = row[0] * w[0] + row[1] * w[1] + row[2] * w[2]
            _set_origin(o, origins[i], d, facets[i], normals[i], lift[i], grazing, margin)
            blocked = _is_blocked(o, d, inverse, boxes, first, count, triangles, waiting)
            for c in range(3):
                sent[p, c] += value[c]
                if not blocked:
                    arrived[p, c] += value[c]


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
    normals: np.ndarray,
    lift: np.ndarray,
    grazing: np.float32,
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
    energies: np.ndarray,
    groups: np.ndarray,
    arrived: np.ndarray,
    sent: np.ndarray,
) -> None:
    """Cast rays from points towards the light that they reflect, and add what arrives.

    Directions are drawn in proportion to the luminance of what each would add to the picture at the
    group's normal. What is drawn counts by the cosine at the point's own, which matters where light
    grazes the surface. Below a facet that its normal leans from, they count as much as Cycles keeps
    of the light there (shaders.direct_light_kernels.add_leaning). The density with which Cycles
    would draw a direction by the closures is taken to be in proportion to what these reflect of it.

    light     (G, 3, T) what each patch of the light adds to the picture at each group's normal
    energies  (T,) of the patches, mean of the channels
    groups    (G, 3) the groups' normals, in the triangles' frame
    patches   (T, 4) as `_direction` takes them
    order     (T,) of the patches, in which neighbours are near
    rotation  (3, 3) from the light's frame to that of the triangles
    firsts    (G + 1,) of each group's points in members (P,), which numbers points
    origins, facets, normals  (P, 3) of points, in the triangles' frame; facets are the surface's
              own normals, from which the interpolated ones may lean
    lift      (P,) along the normals to the smooth surface, from which rays begin that are at most
              `grazing` (a cosine) above the facet; those further above it begin nearer
    margin    by which rays begin beside the surface
    pixels    (P,) of points; turns (P,): their numbers 0 … strata − 1 within the pixel
    strata    (pixels,) points of each pixel, which with `rays` each divide the light equally
    arrived, sent  (pixels, 3), to which the light of rays is added that arrives, and of all
    """
    many = light.shape[2]
    cumulated = np.empty(many, np.float64)
    solid = (patches[:, 0] - patches[:, 1]) * (patches[:, 3] - patches[:, 2])
    whole = 0.0  # energy of each direction, once; patches of both sizes hold it
    for t in range(many):
        whole += energies[t] / 2
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
        reflected = ZERO  # of light from everywhere
        for t in range(many):
            if energies[t] > 0:
                every = light[g, 0, t] + light[g, 1, t] + light[g, 2, t]
                reflected += every / (3 * energies[t]) * solid[t]
        for member in range(firsts[g], firsts[g + 1]):
            i = members[member]
            p = pixels[i]
            number = strata[p] * rays
            shift = _hash(np.uint32(p) * np.uint32(0x9E3779B9) + np.uint32(seed))
            for r in range(rays):
                j = turns[i] * rays + r
                random = _hash(shift + np.uint32(j) * np.uint32(0x85EBCA6B) + np.uint32(1))
                stratum = _stratum(j, number, int(shift))
                u = (stratum + _unit(random)) / number * total
                t = order[min(np.searchsorted(cumulated, u, side="right"), many - 1)]
                random = _hash(random + np.uint32(1))
                v = _unit(random)
                _direction(patches[t], v, _unit(_hash(random + np.uint32(1))), rotation, d)
                side = _set_origin(
                    o, origins[i], d, facets[i], normals[i], lift[i], grazing, margin
                )
                luminance = ZERO
                for c in range(3):
                    luminance += LUMINANCE[c] * light[g, c, t]
                kept = ONE
                if side < 0:
                    every = light[g, 0, t] + light[g, 1, t] + light[g, 2, t]
                    by_closures = every / (3 * energies[t]) / reflected
                    by_light = energies[t] / (np.float32(whole) * solid[t])
                    kept = by_light**2 / (by_closures**2 + by_light**2)
                of_group, of_point = ZERO, ZERO
                for axis in range(3):
                    of_group += groups[g, axis] * d[axis]
                    of_point += normals[i, axis] * d[axis]
                if of_group > LEAST_COSINE:
                    kept *= min(max(of_point, ZERO) / of_group, MOST_TIMES)
                blocked = _is_blocked(o, d, inverse, boxes, first, count, triangles, waiting)
                for c in range(3):
                    weight = kept * total * light[g, c, t] / luminance
                    sent[p, c] += weight
                    if not blocked:
                        arrived[p, c] += weight
