"""Curves through space, and outlines of cross-sections."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline


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


def frames_along(
    path: np.ndarray, side: ArrayLike, ring: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return tangents and two normals, each (N, 3), carried along the path without twist.

    The first normal is as near `side` as possible.

    path  (N, 3) m
    ring  whether the path closes on itself
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
