"""Convex solids with few parameters: where rays leave them towards the viewer, and their outlines.

Each solid has a frame of its own, with its centre at the origin. Its sizes are positive lengths.
A ray is o + t · d; d points towards the viewer, so that the visible point has the largest t.
"""

from typing import Protocol

import numpy as np

CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
AROUND = 40  # points that stand for a circle
PARALLEL = 1e-9  # components of directions below this count as this


class Solid(Protocol):
    """A convex solid.

    count  number of its sizes
    even   how firmly they are held together: weight of the deviations of their logarithms
    """

    count: int
    even: float

    def points(self, sizes: np.ndarray) -> np.ndarray:
        """Return points (V, 3) whose convex hull is the solid, or close to it."""

    def normals(self, o: np.ndarray, d: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Return the unit normals (…, 3) where rays leave the solid.

        A ray that misses the solid has the normal of a place near which it passes.

        o, d  (…, 3) origins and directions of the rays
        """

    def sizes(self, R: np.ndarray, axes: np.ndarray, extents: np.ndarray) -> np.ndarray:
        """Return sizes for which the picture of the solid has about these extents.

        R        (3, 3) its rotation into the view frame
        axes     (A, 2) unit vectors in the picture; extents (A,): half widths along them
        """


class Box:
    """A box; sizes are half its edges."""

    count, even = 3, 0.025

    def points(self, sizes: np.ndarray) -> np.ndarray:
        return CORNERS * sizes

    def normals(self, o: np.ndarray, d: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        d = _not_zero(d)
        leaves = (np.sign(d) * sizes - o) / d  # t at which a ray leaves each pair of planes
        face = leaves.argmin(-1)[..., None]
        n = np.zeros(np.broadcast(o, d).shape)
        np.put_along_axis(n, face, np.sign(np.take_along_axis(d, face, -1)), -1)
        return n

    def sizes(self, R: np.ndarray, axes: np.ndarray, extents: np.ndarray) -> np.ndarray:
        return _least_squares(np.abs(axes @ R[:2]), extents)


class Cylinder:
    """A cylinder or truncated cone about its own z.

    Its sizes are the radii at −z and at +z, and half its height.
    """

    count, even = 3, 0.025

    def points(self, sizes: np.ndarray) -> np.ndarray:
        angle = 2 * np.pi * np.arange(AROUND) / AROUND
        circle = np.stack([np.cos(angle), np.sin(angle)], 1)
        low, high, half = sizes
        ends = [np.c_[r * circle, np.full(AROUND, z)] for r, z in ((low, -half), (high, half))]
        return np.concatenate(ends)

    def normals(self, o: np.ndarray, d: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        d = _not_zero(d)
        low, high, half = sizes
        mean, slope = (low + high) / 2, (high - low) / (2 * half)
        end = (np.sign(d[..., 2]) * half - o[..., 2]) / d[..., 2]
        # on the side, |o_xy + t d_xy| = mean + slope · (o_z + t d_z)
        radius = mean + slope * o[..., 2]
        a = (d[..., :2] ** 2).sum(-1) - (slope * d[..., 2]) ** 2
        b = (o[..., :2] * d[..., :2]).sum(-1) - slope * d[..., 2] * radius
        c = (o[..., :2] ** 2).sum(-1) - radius**2
        a = np.where(np.abs(a) < PARALLEL, PARALLEL, a)
        side = (-b + np.sqrt(np.maximum(b * b - a * c, 0))) / a
        # seen from within the cone that the side continues, only an end is visible
        side = np.where((a < 0) & (slope * d[..., 2] > 0), np.inf, side)
        at_end = end <= side
        t = np.where(at_end, end, side)[..., None]
        p = o + t * d
        along = np.maximum(np.linalg.norm(p[..., :2], axis=-1), PARALLEL)
        n = np.concatenate(
            [p[..., :2] / along[..., None], np.full((*along.shape, 1), -slope)], -1
        ) / np.sqrt(1 + slope**2)
        n[at_end] = 0
        n[..., 2] = np.where(at_end, np.sign(d[..., 2]), n[..., 2])
        return n

    def sizes(self, R: np.ndarray, axes: np.ndarray, extents: np.ndarray) -> np.ndarray:
        z = np.abs(axes @ R[:2, 2])
        radius, half = _least_squares(np.stack([np.sqrt(np.maximum(1 - z**2, 0)), z], 1), extents)
        return np.array([radius, radius, half])


class Ball:
    """A ball, flattened or lengthened along its own z; sizes: radius, half length along z.

    With three different axes its depth would not follow from its outline. Even so, normals that
    face the viewer too much would flatten it towards the viewer, were it not held round.
    """

    count, even = 2, 0.2

    def points(self, sizes: np.ndarray) -> np.ndarray:
        return _sphere() * sizes[[0, 0, 1]]

    def normals(self, o: np.ndarray, d: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        axes = sizes[[0, 0, 1]]
        p, q = o / axes, d / axes
        a, b, c = (q * q).sum(-1), (p * q).sum(-1), (p * p).sum(-1) - 1
        t = (-b + np.sqrt(np.maximum(b * b - a * c, 0))) / a
        n = (p + t[..., None] * q) / axes
        return n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), PARALLEL)

    def sizes(self, R: np.ndarray, axes: np.ndarray, extents: np.ndarray) -> np.ndarray:
        z = (axes @ R[:2, 2]) ** 2
        return np.sqrt(_least_squares(np.stack([1 - z, z], 1), extents**2))


def _sphere(count: int = 240) -> np.ndarray:
    """Return points (count, 3) evenly spread over the unit sphere, on a Fibonacci spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], 1)


def _not_zero(d: np.ndarray) -> np.ndarray:
    return np.where(np.abs(d) < PARALLEL, PARALLEL, d)


def _least_squares(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the least-squares solution, none of it below a twentieth of the largest right side."""
    from scipy.optimize import nnls

    return np.maximum(nnls(matrix, right)[0], right.max() / 20)
