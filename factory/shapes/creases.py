"""Smooth normals that stop at creases: one normal per corner of each face.

vertices (V, 3); faces (F, 3); corner (face, i) is the i-th vertex of the face; corner normals
(F, 3, 3). Two faces that share an edge are smooth there when their normals differ by less than the
crease angle. The corners around a vertex that smooth edges connect share one normal: the mean of
their faces' normals, weighted by the angle at the corner. Linear in the number of faces, whatever
the valence: a vertex with a million faces costs a million.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

CREASE_DEG = 45.0


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals (F, 3), right-handed about the corner order, and areas (F,).

    A face of no area has normal 0.
    """
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    double_area = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(double_area, 1e-300)[:, None], 0.5 * double_area


def corner_angles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the interior angle (F, 3) at each corner, radians."""
    corners = vertices[faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    across = np.linalg.norm(np.cross(ahead, behind), axis=2)
    return np.arctan2(across, (ahead * behind).sum(2))


def edge_pairs(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return pairs of half-edges on each edge of exactly two faces, and the faces per edge.

    A half-edge is 3 * face + i: it leads from corner i to corner i + 1 of its face.
    Returns  first (P,), second (P,) half-edges; same (P,) bool: both run the same way, so the faces
             are wound inconsistently; counts (E,) faces per edge
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(start, end).astype(np.int64), np.maximum(start, end).astype(np.int64)
    key = low * (int(faces.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    beginnings = np.flatnonzero(np.diff(key[order], prepend=-1))
    counts = np.diff(beginnings, append=len(key))
    twos = beginnings[counts == 2]
    first, second = order[twos], order[twos + 1]
    return first, second, start[first] == start[second], counts


def corner_normals(
    vertices: np.ndarray, faces: np.ndarray, crease_deg: float = CREASE_DEG
) -> np.ndarray:
    """Return unit normals (F, 3, 3) float32, smooth across edges flatter than crease_deg."""
    normals, _ = face_normals(vertices, faces)
    first, second, same, _ = edge_pairs(faces)
    smooth = (normals[first // 3] * normals[second // 3]).sum(1) > np.cos(np.radians(crease_deg))
    first, second = first[smooth & ~same], second[smooth & ~same]

    # Corners at the two ends of a smooth edge belong together: a's start is b's end, and the other
    # way round
    def end(half_edge):
        return half_edge - half_edge % 3 + (half_edge + 1) % 3

    rows, columns = np.concatenate([first, end(first)]), np.concatenate([end(second), second])
    corners = 3 * len(faces)
    links = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(corners, corners))
    count, group = connected_components(links, directed=False)
    weighted = (corner_angles(vertices, faces)[:, :, None] * normals[:, None, :]).reshape(-1, 3)
    summed = np.stack([np.bincount(group, weighted[:, axis], count) for axis in range(3)], axis=1)
    smooth_normals = summed[group].reshape(-1, 3, 3)
    length = np.linalg.norm(smooth_normals, axis=2, keepdims=True)
    unit = smooth_normals / np.maximum(length, 1e-300)
    # A fan that turns right round (a needle's tip) has no mean direction: there the face's own
    # normal stands
    opposed = (unit * normals[:, None, :]).sum(2, keepdims=True) < 0.1
    return np.where(opposed, normals[:, None, :], unit).astype(np.float32)
