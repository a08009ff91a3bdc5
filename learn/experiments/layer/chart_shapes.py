"""Normals of the work-precision chart's shapes: a sphere, and two with few distinct normals.

Each covers about 40 % of the picture and is seen from above its right side by a distant viewer. A
cube shows three normals, a cylinder those of a half circle and of its lid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

COVERED = 1.6  # of the picture's area, which is 4
TURN, RISE = np.radians(35.0), np.radians(25.0)  # of the shapes about the vertical; of the viewer
TALL = 1.2  # half the cylinder's height over its radius


def places(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x to the right and y up, (size, size) each, from −1 to 1."""
    x = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(x, -x)
    return x, y


def sphere(size: int) -> np.ndarray:
    """Return normals (size, size, 3), 0 outside the shape."""
    x, y = places(size)
    radius = np.sqrt(COVERED / np.pi)
    x, y = x / radius, y / radius
    z2 = 1 - x * x - y * y
    n = np.stack([x, y, np.sqrt(np.maximum(z2, 0))], -1)
    return np.where(z2[..., None] > 1e-6, n, 0.0)


def cube(size: int) -> np.ndarray:
    """Return normals (size, size, 3), 0 outside the shape."""
    turn = np.array([np.cos(TURN), 0, -np.sin(TURN)]), np.array([np.sin(TURN), 0, np.cos(TURN)])
    rise = np.array([[1, 0, 0], [0, np.cos(RISE), -np.sin(RISE)], [0, np.sin(RISE), np.cos(RISE)]])
    faces = np.stack([turn[0], [0, 1, 0], turn[1]]) @ rise.T
    faces *= np.sign(faces[:, 2:])  # the three that the viewer sees
    half = np.sqrt(COVERED / np.abs(faces[:, 2]).sum()) / 2
    x, y = places(size)
    slope = faces[:, 0, None, None] * x + faces[:, 1, None, None] * y
    depth = faces[:, 2, None, None]
    front, back = (half - slope) / depth, (-half - slope) / depth
    inside = front.min(0) >= back.max(0)
    return np.where(inside[..., None], faces[front.argmin(0)], 0.0)


def cylinder(size: int) -> np.ndarray:
    """Return normals (size, size, 3), 0 outside the shape."""
    up = np.array([0.0, np.cos(RISE), np.sin(RISE)])
    ahead = np.array([0.0, -np.sin(RISE), np.cos(RISE)])  # across the axis, towards the viewer
    radius = np.sqrt(COVERED / (4 * TALL * up[1] + np.pi * up[2]))
    x, y = places(size)
    half_depth = np.sqrt(np.maximum(radius**2 - x * x, 0))  # along `ahead`, to the side
    # the ray (x, y, z) is at y·up_y + z·up_z along the axis and y·ahead_y + z·ahead_z across it
    side, far_side = ((sign * half_depth - y * ahead[1]) / ahead[2] for sign in (1, -1))
    lid, floor = ((sign * TALL * radius - y * up[1]) / up[2] for sign in (1, -1))
    z = np.minimum(side, lid)
    inside = (np.abs(x) < radius) & (z >= np.maximum(far_side, floor))
    of_side = np.stack([x, *(half_depth[..., None] * ahead[1:]).transpose(2, 0, 1)], -1) / radius
    n = np.where((lid < side)[..., None], up, of_side)
    return np.where(inside[..., None], n, 0.0)


SHAPES: dict[str, Callable[[int], np.ndarray]] = {
    "sphere": sphere,
    "cube": cube,
    "cylinder": cylinder,
}


def normals(shape: str, size: int) -> torch.Tensor:
    """Return unit normals (1, size, size, 3) float32 of a shape of SHAPES, 0 outside it."""
    return torch.as_tensor(SHAPES[shape](size))[None].float()
