"""Closed surfaces for furniture and cars: lofts, tubes, slabs, boxes, revolutions, shells.

Each one is watertight and outward. A Surface is vertices (V, 3) in metres and faces (F, 3). Axes
are the world's: x front, y left, z up, unless a docstring says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

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


def closed(vertices: ArrayLike, faces: np.ndarray) -> Surface:
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
    return closed(
        vertices, np.concatenate([grid_faces(count, around, wrap_columns=True), start, finish])
    )


def smooth_path(points: ArrayLike, count: int) -> np.ndarray:
    """Return `count` points (count, 3) of a smooth curve through points (P, 3), by chord length."""
    points = np.asarray(points, float)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return CubicSpline(length, points)(np.linspace(0, length[-1], count))


def rounded_path(points: ArrayLike, radius: float, steps: int = 5) -> np.ndarray:
    """Return a path (N, 3) through straight runs with rounded corners.

    The corners are arcs (quadratic Bézier) of about `radius` metres.
    """
    points = np.asarray(points, float)
    path = [points[:1]]
    t = np.linspace(0, 1, steps + 1)[:, None]
    for before, corner, after in zip(points[:-2], points[1:-1], points[2:], strict=True):
        lengths = np.linalg.norm(before - corner), np.linalg.norm(after - corner)
        reach = min(radius, 0.45 * min(lengths))
        a, b = (
            corner + reach * (before - corner) / lengths[0],
            corner + reach * (after - corner) / lengths[1],
        )
        path.append((1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b)
    return np.concatenate([*path, points[-1:]])


def superellipse(around: int, square: float = 2.0) -> np.ndarray:
    """Return the unit superellipse (around, 2): |x|^square + |y|^square = 1.

    2 is a circle, 8 a square with rounded corners.
    """
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False) + np.pi / around
    c, s = np.cos(angle), np.sin(angle)
    return (
        np.stack([c, s], 1) / ((np.abs(c) ** square + np.abs(s) ** square) ** (1 / square))[:, None]
    )


def _frames(path, side, ring):
    """Return tangents and two normals, each (N, 3), carried along the path without twist.

    The first normal is as near `side` as possible.
    """
    tangent = np.gradient(path, axis=0) if not ring else np.roll(path, -1, 0) - np.roll(path, 1, 0)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    first = np.empty_like(path)
    start = np.asarray(side, float)
    if abs(start @ tangent[0]) > 0.95 * np.linalg.norm(start):
        start = np.roll(start, 1)
    for k, t in enumerate(tangent):
        start = start - (start @ t) * t
        start = start / np.linalg.norm(start)
        first[k] = start
    return tangent, first, np.cross(tangent, first)


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
    tangent, first, second = _frames(path, side, ring)
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
        return closed(body.reshape(-1, 3), grid_faces(len(path), around, True, True))
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
    return closed(puffed, np.concatenate(faces))


def cushion(size: ArrayLike, puff: float = 0.25, inner: int = 6) -> Surface:
    """Return a soft cushion: a box with swelling large sides and very round edges."""
    size = np.asarray(size, float)
    thin = int(size.argmin())
    bulge = [0.03, 0.03, 0.03]
    bulge[thin] = puff
    return rounded_box(size, 0.42 * size.min(), bulge, edge=3, inner=inner)


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
    return closed(vertices, faces)
