"""A closed surface of triangles, which every part of furniture, of cars and of general shapes is.

It is watertight and outward: vertices (V, 3) in metres, faces (F, 3). Axes are the world's: x
front, y left, z up, unless a docstring says otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

LEFT_RIGHT = (1.0, -1.0)  # signs of y


class Surface(NamedTuple):
    """vertices (V, 3), faces (F, 3), counter-clockwise seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Surface:
        """Return the surface translated by metres along each axis."""
        return Surface(self.vertices + np.array([x, y, z]), self.faces)

    def turned(self, axis: str, angle: float) -> Surface:
        """Return the surface rotated about the origin's x, y or z axis, right-handed, radians."""
        i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        vertices = self.vertices.copy()
        c, s = np.cos(angle), np.sin(angle)
        vertices[:, i], vertices[:, j] = (
            c * self.vertices[:, i] - s * self.vertices[:, j],
            s * self.vertices[:, i] + c * self.vertices[:, j],
        )
        return Surface(vertices, self.faces)

    def scaled(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Surface:
        """Return the surface scaled along each axis.

        A negative factor mirrors; faces are then reversed so that they stay outward.
        """
        return Surface(
            self.vertices * (x, y, z), self.faces[:, ::-1] if x * y * z < 0 else self.faces
        )

    def mirrored(self) -> Surface:
        """Return the surface with left and right exchanged."""
        return self.scaled(y=-1.0)


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume in the vertices' unit cubed; positive when the faces look outward."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6


def close_surface(vertices: ArrayLike, faces: np.ndarray) -> Surface:
    """Return a Surface from triangles, turned outward.

    Coinciding vertices are welded, and collapsed triangles dropped.
    """
    vertices = np.asarray(vertices, float)
    _, first, inverse = np.unique(
        np.round(vertices, 8), axis=0, return_index=True, return_inverse=True
    )
    faces = inverse.reshape(-1)[faces]
    faces = faces[
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    ]
    vertices = vertices[first]
    return Surface(vertices, faces if signed_volume(vertices, faces) > 0 else faces[:, ::-1])


def grid_faces(
    rows: int, columns: int, wrap_rows: bool = False, wrap_columns: bool = False
) -> np.ndarray:
    """Return triangles (F, 3) over a grid of vertices, row after row."""
    i, j = np.meshgrid(
        np.arange(rows - (not wrap_rows)), np.arange(columns - (not wrap_columns)), indexing="ij"
    )
    i, j = i.ravel(), j.ravel()
    below, beside = (i + 1) % rows, (j + 1) % columns
    a, b, c, d = (
        i * columns + j,
        below * columns + j,
        below * columns + beside,
        i * columns + beside,
    )
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
