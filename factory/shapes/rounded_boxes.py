"""Boxes with rounded edges, flat or puffed up."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from factory.shapes.closed_surface import Surface, close_surface, grid_faces


def rounded_box(
    size: ArrayLike,
    radius: float,
    bulge: Sequence[float] = (0.0, 0.0, 0.0),
    edge: int = 3,
    inner: int = 2,
) -> Surface:
    """Return a box about the origin with rounded edges, its sides flat or puffed.

    size    (3,) m
    radius  of the edges, m
    bulge   how far each pair of sides swells, as a share of its half size
    edge    steps round an edge
    inner   steps across a flat side
    """
    half = np.asarray(size, float) / 2
    radius = min(radius, 0.98 * half.min())
    curve = np.tan(np.linspace(np.pi / 4, 0, edge + 1))
    ticks = [
        np.concatenate(
            [
                -(h - radius) - radius * curve,
                np.linspace(-(h - radius), h - radius, inner + 1)[1:-1],
                h - radius + radius * curve[::-1],
            ]
        )
        for h in half
    ]
    count = len(ticks[0])
    i, j = (g.ravel() for g in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    side = grid_faces(count, count)
    places: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    for axis in range(3):
        for end in (0, count - 1):
            place = np.empty((count * count, 3), int)
            place[:, axis], place[:, (axis + 1) % 3], place[:, (axis + 2) % 3] = end, i, j
            faces.append((side if end else side[:, ::-1]) + len(places) * count * count)
            places.append(place)
    index = np.concatenate(places)
    corner = np.stack([ticks[axis][index[:, axis]] for axis in range(3)], 1)
    flat = np.clip(corner, -(half - radius), half - radius)
    away = corner - flat
    vertices = flat + radius * away / np.linalg.norm(away, axis=1, keepdims=True)
    share = 1 - np.clip(vertices / half, -1, 1) ** 2
    puffed = vertices.copy()
    for axis in range(3):
        puffed[:, axis] *= 1 + bulge[axis] * share[:, (axis + 1) % 3] * share[:, (axis + 2) % 3]
    return close_surface(puffed, np.concatenate(faces))


def cushion(size: ArrayLike, puff: float = 0.25, inner: int = 6) -> Surface:
    """Return a soft cushion: a box with swelling large sides and very round edges."""
    size = np.asarray(size, float)
    thin = int(size.argmin())
    bulge = [0.03, 0.03, 0.03]
    bulge[thin] = puff
    return rounded_box(size, 0.42 * size.min(), bulge, edge=3, inner=inner)
