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


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def look(
    origins: np.ndarray,
    d: np.ndarray,
    boxes: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    triangles: np.ndarray,
    met: np.ndarray,
    places: np.ndarray,
) -> None:
    """Find what rays from origins (R, 3) in one direction d (3,) meet first.

    met     (R,) set to the triangle's number, −1: none
    places  (R, 3) set to the distance, and to the places along the triangle's two edges
    """
    waiting = np.empty(DEEPEST, np.int32)
    entries = np.empty(DEEPEST, np.float32)
    inverse = np.empty(3, np.float32)
    _inverse(d, inverse)
    for i in range(len(origins)):
        o = origins[i]
        met[i], nearest = -1, HUGE
        waits, node = 0, 0
        while True:
            if count[node]:
                for t in range(first[node], first[node] + count[node]):
                    far, u, v = _meet(triangles[t], o, d)
                    inside = u >= -BESIDE and v >= -BESIDE and u + v <= ONE + BESIDE
                    if inside and ZERO < far < nearest:
                        met[i], nearest = t, far
                        places[i, 0], places[i, 1], places[i, 2] = far, u, v
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
    arrived: np.ndarray,
    sent: np.ndarray,
) -> None:
    """Cast rays from points towards the light that they reflect, and add what arrives.

    Directions are drawn in proportion to the luminance of what each would add to the picture. Below
    a facet that its normal leans from, they count as much as Cycles keeps of the light there
    (shaders.direct_light_kernels.add_leaning). The density with which Cycles would draw a direction
    by the closures is taken to be in proportion to what these reflect of it.

    light     (G, 3, T) what each patch of the light adds to the picture at each group's normal
    energies  (T,) of the patches, mean of the channels
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
                blocked = _is_blocked(o, d, inverse, boxes, first, count, triangles, waiting)
                for c in range(3):
                    weight = kept * total * light[g, c, t] / luminance
                    sent[p, c] += weight
                    if not blocked:
                        arrived[p, c] += weight
