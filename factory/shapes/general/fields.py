"""Signed distances to build solids from: primitives, outlines, paths, and what combines them.

Every function returns a field (see factory.shapes.general.isosurface). Lengths are in the unit of
the shape: the finished mesh is scaled into the unit sphere. Primitives stand about the origin.
Source: Quilez, "Distance functions" (formulas of box, capsule, cone and the smooth minimum).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from factory.shapes.general.isosurface import Field

NEARBY = 0.4  # a path farther away than this is taken for the sphere that holds it
OUTLINE_CELLS = 320  # along the longer side of a tabulated outline


def ellipsoid(half: ArrayLike) -> Field:
    """An ellipsoid; half its axes. Near the surface the value is the distance to first order."""
    axes = np.asarray(half, float)

    def field(p: np.ndarray) -> np.ndarray:
        scaled = np.linalg.norm(p / axes, axis=-1)
        slope = np.linalg.norm(p / axes**2, axis=-1)
        return np.where(slope > 1e-6, scaled * (scaled - 1) / np.maximum(slope, 1e-6), -axes.min())

    return field


def superquadric(half: ArrayLike, square: float) -> Field:
    """A body between an ellipsoid (square 2) and a box (square 8 and more)."""
    axes = np.asarray(half, float)

    def field(p: np.ndarray) -> np.ndarray:
        radius = (np.abs(p / axes) ** square).sum(-1) ** (1 / square)
        return (radius - 1) * axes.min()

    return field


def box(half: ArrayLike, rounding: float) -> Field:
    """A box whose edges have the radius `rounding`."""
    inner = np.asarray(half, float) - rounding

    def field(p: np.ndarray) -> np.ndarray:
        q = np.abs(p) - inner
        outside = np.linalg.norm(np.maximum(q, 0), axis=-1)
        return outside + np.minimum(q.max(-1), 0) - rounding

    return field


def cylinder(radius: float, half_height: float, rounding: float) -> Field:
    """A cylinder about z whose edges have the radius `rounding`."""
    return _turned_box(lambda z: radius - rounding, half_height - rounding, rounding)


def cone(low: float, high: float, half_height: float, rounding: float) -> Field:
    """A truncated cone about z, from radius `low` below to `high` above."""

    def width(z: np.ndarray) -> np.ndarray:
        share = np.clip((z + half_height) / (2 * half_height), 0, 1)
        return low + (high - low) * share - rounding

    slope = abs(high - low) / (2 * half_height)
    return scaled_values(
        _turned_box(width, half_height - rounding, rounding), 1 / np.hypot(1, slope)
    )


def _turned_box(width, half_height, rounding):
    def field(p: np.ndarray) -> np.ndarray:
        side = np.hypot(p[..., 0], p[..., 1]) - width(p[..., 2])
        lid = np.abs(p[..., 2]) - half_height
        outside = np.hypot(np.maximum(side, 0), np.maximum(lid, 0))
        return outside + np.minimum(np.maximum(side, lid), 0) - rounding

    return field


def torus(ring: float, tube: float) -> Field:
    """A torus about z."""

    def field(p: np.ndarray) -> np.ndarray:
        return np.hypot(np.hypot(p[..., 0], p[..., 1]) - ring, p[..., 2]) - tube

    return field


def capsule(
    start: ArrayLike,
    finish: ArrayLike,
    radius: float,
    finish_radius: float | None = None,
) -> Field:
    """A rod with round ends between two points; its radius may change along it."""
    return path(np.array([start, finish], float), [radius, finish_radius or radius])


def path(points: np.ndarray, radii: ArrayLike, closed: bool = False) -> Field:
    """A tube along a polyline (N, 3), its radius one number or (N,), interpolated between them."""
    points = np.asarray(points, float)
    sizes = np.broadcast_to(np.asarray(radii, float), (len(points),))
    if closed:
        points, sizes = np.vstack([points, points[:1]]), np.append(sizes, sizes[0])
    centre = (points.min(0) + points.max(0)) / 2
    bound = float(np.linalg.norm(points - centre, axis=1).max() + sizes.max())

    def field(p: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(p - centre, axis=-1) - bound
        near = distance < NEARBY
        distance[near] = exact(p[near])
        return distance

    def exact(p: np.ndarray) -> np.ndarray:
        least = np.full(p.shape[:-1], np.inf)
        for a, b, r, s in zip(points[:-1], points[1:], sizes[:-1], sizes[1:], strict=True):
            run = b - a
            t = np.clip(((p - a) @ run) / (run @ run), 0, 1)
            away = p - a - t[..., None] * run
            distance = np.sqrt(np.einsum("...i,...i->...", away, away))
            np.minimum(least, distance - (r + t * (s - r)), out=least)
        return least

    return field


def half_space(normal: ArrayLike, distance: float) -> Field:
    """What lies behind the plane normal · p = distance."""
    unit = np.asarray(normal, float) / np.linalg.norm(np.asarray(normal, float))
    return lambda p: p @ unit - distance


class Outline:
    """The signed distance to closed outlines in the plane, tabulated once and interpolated.

    outlines  polygons (N, 2) each; a point inside an odd number of them is inside
    margin    of the table about the outlines, as a share of their longer side
    """

    def __init__(self, outlines: Sequence[np.ndarray], margin: float = 0.6) -> None:
        corners = np.concatenate(outlines)
        low, high = corners.min(0), corners.max(0)
        border = margin * (high - low).max()
        self._low = low - border
        span = high - low + 2 * border
        self._step = span.max() / OUTLINE_CELLS
        shape = np.ceil(span / self._step).astype(int) + 1
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1)
        points = self._low + grid * self._step
        least = np.full(shape, np.inf)
        inside = np.zeros(shape, bool)
        x, y = points[..., 0], points[..., 1]
        for outline in outlines:
            for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
                run = b - a
                square = run @ run
                if not square > 0:
                    continue
                t = np.clip(((points - a) @ run) / square, 0, 1)
                away = points - a - t[..., None] * run
                np.minimum(least, np.einsum("...i,...i->...", away, away), out=least)
                if a[1] != b[1]:
                    crosses = ((a[1] > y) != (b[1] > y)) & (
                        x < a[0] + (y - a[1]) / (b[1] - a[1]) * run[0]
                    )
                    inside ^= crosses
        self._table = np.where(inside, -1, 1) * np.sqrt(least)

    def __call__(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The distance at (u, v); beyond the table, its border's value and the way there."""
        place = np.stack([u - self._low[0], v - self._low[1]]) / self._step
        most = np.array(self._table.shape).reshape(2, *[1] * u.ndim) - 1.0
        held = np.clip(place, 0, most)
        beyond = np.sqrt(((place - held) ** 2).sum(0)) * self._step
        return map_coordinates(self._table, held, order=1, mode="nearest") + beyond


def revolved(outline: Outline) -> Field:
    """The outline's (u, v) as (distance from the axis, height), turned about z."""
    return lambda p: outline(np.hypot(p[..., 0], p[..., 1]), p[..., 2])


def extruded(
    outline: Outline, half_depth: float, rounding: float, taper: float = 0.0, twist: float = 0.0
) -> Field:
    """The outline's (u, v) as (y, z), given depth along x.

    rounding  radius of the edges;  taper  share by which the front is smaller than the back
    twist     radians from back to front
    """

    def field(p: np.ndarray) -> np.ndarray:
        along = np.clip(p[..., 0] / half_depth, -1, 1)
        scale = 1 - 0.5 * taper * (along + 1)
        angle = 0.5 * twist * along
        c, s = np.cos(angle), np.sin(angle)
        u = (c * p[..., 1] + s * p[..., 2]) / scale
        v = (c * p[..., 2] - s * p[..., 1]) / scale
        side = outline(u, v) * scale + rounding
        lid = np.abs(p[..., 0]) - (half_depth - rounding)
        outside = np.hypot(np.maximum(side, 0), np.maximum(lid, 0))
        return outside + np.minimum(np.maximum(side, lid), 0) - rounding

    return field


def moved(field: Field, shift: ArrayLike) -> Field:
    """The solid shifted."""
    offset = np.asarray(shift, float)
    return lambda p: field(p - offset)


def turned(field: Field, rotation: np.ndarray) -> Field:
    """The solid turned by a rotation (3, 3): p ↦ rotation @ p."""
    return lambda p: field(p @ rotation)


def mirrored(field: Field) -> Field:
    """The solid's half at positive y, and its mirror image."""

    def mirrored_field(p: np.ndarray) -> np.ndarray:
        q = np.copy(p)
        q[..., 1] = np.abs(q[..., 1])
        return field(q)

    return mirrored_field


def scaled_values(field: Field, factor: float) -> Field:
    """The same surface, its values multiplied: for fields that are steeper than a distance."""
    return lambda p: factor * field(p)


def union(parts: Sequence[Field], blend: float = 0.0) -> Field:
    """What lies in any part; `blend` is the size of the fillet between them."""

    def field(p: np.ndarray) -> np.ndarray:
        result = parts[0](p)
        for part in parts[1:]:
            result = _smooth_minimum(result, part(p), blend)
        return result

    return field


def cut(field: Field, tools: Sequence[Field], blend: float = 0.0) -> Field:
    """The solid without what lies in any of the tools."""

    def cut_field(p: np.ndarray) -> np.ndarray:
        result = field(p)
        for tool in tools:
            result = -_smooth_minimum(-result, tool(p), blend)
        return result

    return cut_field


def intersection(parts: Sequence[Field], blend: float = 0.0) -> Field:
    """What lies in all parts."""

    def field(p: np.ndarray) -> np.ndarray:
        result = parts[0](p)
        for part in parts[1:]:
            result = -_smooth_minimum(-result, -part(p), blend)
        return result

    return field


def shell(field: Field, thickness: float) -> Field:
    """The solid's wall, half inside and half outside its surface."""
    return lambda p: np.abs(field(p)) - thickness / 2


def displaced(field: Field, height: Field) -> Field:
    """The surface raised by `height` (a function of points, small against the solid)."""
    return lambda p: field(p) - height(p)


def _smooth_minimum(a: np.ndarray, b: np.ndarray, blend: float) -> np.ndarray:
    if blend <= 0:
        return np.minimum(a, b)
    share = np.clip(0.5 + 0.5 * (b - a) / blend, 0, 1)
    return b + share * (a - b) - blend * share * (1 - share)
