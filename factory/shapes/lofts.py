"""Closed surfaces that join rings of points: tubes, rods, slabs, revolutions, ellipsoids.

Axes and units as in factory.shapes.closed_surface.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from factory.shapes.closed_surface import Surface, close_surface, grid_faces
from factory.shapes.curves import frames_along, superellipse


def loft(rings: ArrayLike) -> Surface:
    """Return closed rings (R, N, 3) joined in order; a fan to the ring's centre closes each end."""
    rings = np.asarray(rings, float)
    count, around, _ = rings.shape
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(1)])
    j = np.arange(around)
    ahead = (j + 1) % around
    start = np.stack([np.full(around, count * around), j, ahead], 1)
    last = (count - 1) * around
    finish = np.stack([np.full(around, count * around + 1), last + ahead, last + j], 1)
    return close_surface(
        vertices, np.concatenate([grid_faces(count, around, wrap_columns=True), start, finish])
    )


def tube(
    path: ArrayLike,
    size: ArrayLike,
    around: int = 12,
    square: float = 2.0,
    bevel: float = 0.35,
    ring: bool = False,
    side: ArrayLike = (0.0, 1.0, 0.0),
) -> Surface:
    """Return a rod along a path; its section is a superellipse that may change along it.

    path    (N, 3) m
    size    half-widths: a number, (N,), or (N, 2): along `side` and across it
    square  the section's exponent: 2 round, 6 squarish
    bevel   ends rounded over this fraction of the half-width; 1: a hemisphere
    ring    the path closes on itself
    """
    path = np.asarray(path, float)
    size = np.asarray(size, float)
    size = np.broadcast_to(
        size[:, None] if size.ndim == 1 and len(size) == len(path) else size, (len(path), 2)
    )
    tangent, first, second = frames_along(path, side, ring)
    outline = superellipse(around, square)

    def rings(at, shrink, ahead):
        half = size[at][:, None, :] * outline * shrink
        centre = path[at] + tangent[at] * ahead
        return (
            centre[:, None, :]
            + half[..., :1] * first[at][:, None, :]
            + half[..., 1:] * second[at][:, None, :]
        )

    body = rings(slice(None), 1.0, 0.0)
    if ring:
        return close_surface(body.reshape(-1, 3), grid_faces(len(path), around, True, True))
    start: list[np.ndarray] = []
    finish: list[np.ndarray] = []
    for angle in np.linspace(0, np.pi / 2, 4)[1:]:
        shrink = 1 - bevel + bevel * np.cos(angle)
        start.insert(0, rings([0], shrink, -bevel * size[0].min() * np.sin(angle)))
        finish.append(rings([-1], shrink, bevel * size[-1].min() * np.sin(angle)))
    return loft(np.concatenate([*start, body, *finish]))


def rod(
    start: ArrayLike,
    finish: ArrayLike,
    size: ArrayLike,
    finish_size: ArrayLike | None = None,
    **options: Any,
) -> Surface:
    """Return a straight rod between two points, tapered to `finish_size`; sizes as in `tube`.

    options  of `tube`
    """
    t = np.linspace(0, 1, 3)[:, None]
    start_size = np.broadcast_to(size, (2,))
    end_size = start_size if finish_size is None else np.broadcast_to(finish_size, (2,))
    path = (1 - t) * np.asarray(start, float) + t * np.asarray(finish, float)
    return tube(path, (1 - t) * start_size + t * end_size, **options)


def slab(
    outline: ArrayLike, thickness: float, bevel: float = 0.3, dome: float = 0.0, steps: int = 3
) -> Surface:
    """Return a plate with rounded edges, flat in x–y about z = 0.

    outline  (N, 2), star-shaped about its centre
    bevel    edge radius over the half thickness
    dome     m that the middle rises above the rim; negative (a saddle): sinks below it
    """
    outline = np.asarray(outline, float)
    tangent = np.roll(outline, -1, 0) - np.roll(outline, 1, 0)
    inward = np.stack([-tangent[:, 1], tangent[:, 0]], 1) / np.maximum(
        np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12
    )
    centre = outline.mean(0)
    inward *= np.sign(((centre - outline) * inward).sum())
    radius = bevel * thickness / 2
    rings = []
    for side in (-1, 1):
        half = []
        for share in (0.0, 0.3, 0.6, 0.85):
            flat = centre + share * (outline + radius * inward - centre)
            half.append(
                np.column_stack(
                    [flat, np.full(len(flat), side * thickness / 2 + dome * (1 - share**2))]
                )
            )
        for angle in np.linspace(0, np.pi / 2, steps + 1):
            flat = outline + inward * radius * (1 - np.sin(angle))
            half.append(
                np.column_stack(
                    [
                        flat,
                        np.full(
                            len(flat), side * (thickness / 2 - radius + radius * np.cos(angle))
                        ),
                    ]
                )
            )
        rings += half if side < 0 else half[::-1]
    return loft(rings)


def revolve(profile: ArrayLike, around: int = 32) -> Surface:
    """Return a profile (N, 2) of (radius, z) revolved about z.

    It should begin and end on the axis; otherwise flat lids close it.
    """
    profile = np.asarray(profile, float)
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    return loft(profile[:, :1, None] * circle + profile[:, 1:, None] * np.array([0.0, 0.0, 1.0]))


def ellipsoid(size: ArrayLike, square: float = 2.0, around: int = 20) -> Surface:
    """Return a superellipsoid about the origin; size (3,) m across; square as in `superellipse`."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, around // 2 + 1)
    c, s = np.cos(latitude), np.sin(latitude)
    share = (np.abs(c) ** square + np.abs(s) ** square) ** (-1 / square)
    outline = superellipse(around, square)
    rings = np.concatenate(
        [
            (c * share)[:, None, None] * outline,
            np.broadcast_to((s * share)[:, None, None], (len(c), around, 1)),
        ],
        axis=2,
    )
    return loft(rings * np.asarray(size) / 2)
