"""Normals that points of a picture share: groups of them, their means, and normals made to face.

n  (P, 3) unit normals, camera frame; the viewer is at (0, 0, 1)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shaders import direct_light_kernels

# points that share a normal from which it has a sum of its own, and of so many normals at most
FACE_POINTS, MOST_FACES = 64, 256
COS_FLAT = float(np.cos(np.radians(0.1)))  # between normals and facets that count as the same
NORMAL_STEPS = 1 << 17  # of a normal's x and y, by which normals are distinguished
COS_LEANING = float(np.cos(np.radians(2.0)))  # between normals and facets that differ
FACING = 1e-3  # n·v of normals that lean away from the viewer


class Group(NamedTuple):
    """Points, some of which have the same normals.

    points  (G,) their indices; first (U,) one index of each normal
    each    (G,) which of the U normals every point has
    """

    points: np.ndarray
    first: np.ndarray
    each: np.ndarray


def by_repetition(n: np.ndarray, facets: np.ndarray) -> tuple[Group, Group]:
    """Return the normals (P, 3) that one point has, and those that two or more of flat faces have.

    Normals that lean from their facets count as those of one point.
    """
    (flat,) = np.nonzero(np.einsum("pi,pi->p", n, facets) > COS_FLAT)
    x, y, z = np.rint((n[flat].T.astype(np.float64) + 1) * NORMAL_STEPS).astype(np.int64)
    keys = (x * (2 * NORMAL_STEPS + 1) + y) * 2 + (z > NORMAL_STEPS)
    _, first, each, counts = np.unique(
        keys, return_index=True, return_inverse=True, return_counts=True
    )
    alone = np.ones(len(n), bool)
    alone[flat] = counts[each] == 1
    (points,) = np.nonzero(alone)
    (normals,) = np.nonzero(counts > 1)
    inside = counts[each] > 1
    return (
        Group(points, points, np.arange(len(points))),
        Group(flat[inside], flat[first[normals]], np.searchsorted(normals, each[inside])),
    )


def large(shared: Group) -> Group:
    """Return those normals of a group that at least FACE_POINTS have, MOST_FACES of them."""
    counts = np.bincount(shared.each, minlength=len(shared.first))
    most = np.argsort(-counts, kind="stable")[:MOST_FACES]
    kept = most[counts[most] >= FACE_POINTS]
    place = np.full(len(counts), -1)
    place[kept] = np.arange(len(kept))
    inside = place[shared.each] >= 0
    return Group(shared.points[inside], shared.first[kept], place[shared.each[inside]])


def distinct(
    indices: np.ndarray, cells: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | slice]:
    """Return one of the indices (N,) for each cell, and which of them stands for each index."""
    if cells is None:
        return indices, slice(None)
    _, first, each = np.unique(cells[indices], return_index=True, return_inverse=True)
    return indices[first], each


def means(n: np.ndarray, each: np.ndarray | slice) -> np.ndarray:
    """Return the mean (G, 3), of unit length, of normals (P, 3) of each group.

    each  (P,) the number of each normal's group, or a slice: every normal is one
    """
    if isinstance(each, slice):
        return n
    sums = np.stack([np.bincount(each, values) for values in n.T], axis=1)
    lengths = np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
    return np.ascontiguousarray(sums / lengths, np.float32)


def turn_to_viewer(n: np.ndarray, facets: np.ndarray | None = None) -> tuple[np.ndarray, bool]:
    """Return normals (P, 3) with n·v of at least FACING, and whether any leans from its facet."""
    out = np.empty(n.shape, np.float32)
    facets = n if facets is None else facets
    leaning = direct_light_kernels.face(
        np.ascontiguousarray(n, np.float32), facets, np.float32(FACING), COS_LEANING, out
    )
    return out, leaning > 0
