"""Polygons cut into triangles around their first corners, and where this is wrong.

Such a fan is right for convex polygons, and for those concave ones of which the first corner sees
every other. Arrays as in factory.shapes.polygons.
"""

import numpy as np

from factory.shapes.ragged import ranges

BLOCK = 500_000  # triangles that are examined at once: 100 MB
TINY = 1e-12  # doubled area below which three corners are in a line; the polygon's size is 1


def fans(corners: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles (F, 3) around each polygon's first corner, and the polygon (F,) of each."""
    triangles = lengths - 2
    owner = np.repeat(np.arange(len(lengths)), triangles)
    step = ranges(np.zeros_like(triangles), triangles)
    start = (np.cumsum(lengths) - lengths)[owner]
    return (
        np.stack(
            [corners[start], corners[start + step + 1], corners[start + step + 2]], axis=1
        ).reshape(-1, 3),
        owner,
    )


def where_fans_fail(
    vertices: np.ndarray, faces: np.ndarray, owner: np.ndarray, lengths: np.ndarray, depth: float
) -> tuple[np.ndarray, int]:
    """Return the polygons whose fan has a reversed triangle, and how many others have no normal.

    faces, owner  of `fans`
    depth         as of factory.shapes.polygons.triangulate
    """
    failing, none, polygon = [np.zeros(0, np.int64)], 0, 0
    ends = np.cumsum(lengths - 2)
    while polygon < len(lengths):
        start = int(ends[polygon - 1]) if polygon else 0
        last = max(int(np.searchsorted(ends, start + BLOCK, side="right")), polygon + 1)
        some = slice(start, int(ends[last - 1]))
        if (lengths[polygon:last] > 3).any():
            turned, without = _failing(
                vertices, faces[some], owner[some] - polygon, last - polygon, depth
            )
            failing.append(polygon + turned)
            none += without
        polygon = last
    return np.concatenate(failing), none


def _failing(vertices, faces, owner, count, depth):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    base = np.sqrt(
        np.maximum(
            np.maximum(squared_lengths(b - a), squared_lengths(c - a)), squared_lengths(c - b)
        )
    )
    normal = np.stack([np.bincount(owner, cross[:, k], count) for k in range(3)], axis=1)
    length = np.linalg.norm(normal, axis=1)
    # else its halves, wound against each other, cancel
    sure = length > TINY * np.bincount(owner, base**2, count)
    normal[sure] /= length[sure, None]
    height = np.einsum("fi,fi->f", cross, normal[owner])  # doubled area: height times base
    turned = (height < -depth * base - TINY * base**2) & sure[owner]
    covering = np.linalg.norm(cross, axis=1) > depth * base + TINY * base**2
    return np.unique(owner[turned]), len(np.unique(owner[covering & ~sure[owner]]))


def squared_lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the squared lengths (N,) of vectors (N, D)."""
    return np.einsum("fi,fi->f", vectors, vectors)
