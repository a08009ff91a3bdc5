"""Thin sheets with a thickness."""

import numpy as np
from numpy.typing import ArrayLike

from factory.shapes.closed_surface import Surface, close_surface, grid_faces


def shell(points: ArrayLike, thickness: float, times: int = 2) -> Surface:
    """Return a thin sheet through a cage of points (R, C, 3), smoothed by Loop subdivision.

    The sheet has a thickness, and its rim is round.
    """
    from trimesh.remesh import subdivide_loop

    points = np.asarray(points, float)
    rows, columns, _ = points.shape
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    both = np.concatenate(
        [
            (points + normal * thickness / 2).reshape(-1, 3),
            (points - normal * thickness / 2).reshape(-1, 3),
        ]
    )
    faces = grid_faces(rows, columns)
    rim = np.concatenate(
        [
            np.arange(columns - 1),
            np.arange(rows - 1) * columns + columns - 1,
            (rows - 1) * columns + np.arange(columns - 1, 0, -1),
            np.arange(rows - 1, 0, -1) * columns,
        ]
    )
    ahead, size = np.roll(rim, -1), rows * columns
    wall = np.concatenate(
        [np.stack([rim, ahead, ahead + size], 1), np.stack([rim, ahead + size, rim + size], 1)]
    )
    # The sheet runs i then j; its rim runs j first: the wall's sense is the sheet's own
    surface = np.concatenate([faces, (faces + size)[:, ::-1], wall])
    vertices, faces = subdivide_loop(both, surface, times)
    return close_surface(vertices, faces)
