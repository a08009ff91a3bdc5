"""Deformation of stored geometry: from one view of one shape, any number of other shapes.

To a distant viewer the visible surface is a height field z(x) over the mask. Three changes keep
every visible point visible, and normals follow exactly:

    z'(x) = s z(φ(x)) + g(x)
    n'    ∝ (s Jᵀ n_xy − n_z ∇g, n_z),   n at φ(x)

φ  a map of the picture plane with Jacobian J: rotation, stretching, shear and a smooth bend
s  a stretch of depth
g  a smooth height with gradient ∇g: a slope, broad swellings and, at times, fine relief

There is no division by n_z, so that rims, where it is 0, stay rims. Views in perspective are
treated as if they were seen from afar; their normals are those of each pixel's ray
(learn.data.geometry).

Heights and coordinates x, y are in half widths of the picture; x points to the right and y up, as
in shaders.frames. H, W picture.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional as F

from shaders.frames import pixel_grid

ROTATED = 0.3  # share of pictures that are turned by any angle
TILT = 0.15  # radians, standard deviation of the angle of the others
STRETCH = 0.2  # standard deviation of the logarithm, along each of two axes
SHEAR = 0.2  # standard deviation
SMALLER = 0.25  # logarithm by which the object may fill less than the frame, at most
MARGIN = 0.97  # half widths up to which the object may fill the frame
BEND = 0.3  # of the Jacobian, root mean square over the picture, at most
DEPTH = 0.25  # standard deviation of the logarithm of s
SLOPE = 0.15  # standard deviation of each component of the slope
SWELLING = 0.5  # gradient of swellings, root mean square over the picture, at most
BROAD_NODES = (3, 6)  # of bends and swellings: random values along a side, interpolated smoothly
RELIEF = 0.35  # share of pictures with fine relief
RELIEF_SLOPE = (0.1, 0.7)  # its gradient, root mean square over the picture
RELIEF_NODES = (8, 32)
LEAST_AREA = 0.2  # det J below which a map of the plane is drawn again: it nearly folds
ATTEMPTS = 4


class PlaneMap(NamedTuple):
    """Where each pixel of a deformed view looks.

    source    φ (H, W, 2)
    jacobian  (H, W, 2, 2) of φ over `scale`
    scale     the uniform scale of φ; heights are divided by it too, so that it changes no normal
    """

    source: np.ndarray
    jacobian: np.ndarray
    scale: float


class Deformed(NamedTuple):
    """A deformed view.

    n         (H, W, 3) float32 unit normals, 0 in the background
    segments  (H, W) int64, 1 … S, 0 in the background
    depth     (H, W) float32, away from the viewer, 0 in the background; None where none was given
    """

    n: np.ndarray
    segments: np.ndarray
    depth: np.ndarray | None


def deform(
    rng: np.random.Generator,
    n: np.ndarray,
    segments: np.ndarray,
    depth: np.ndarray | None = None,
    half_extent: float = 1.0,
) -> Deformed:
    """Return a view under a random deformation.

    A view whose map of the plane nearly folds in every attempt stays as it is.

    n, segments, depth  as of `Deformed`; n_z ≥ 0
    half_extent         half the picture's width in units of depth
    """
    mask = segments > 0
    for _ in range(ATTEMPTS if mask.any() else 0):
        plane = plane_map(rng, mask)
        covered = np.rint(_nearest(segments[..., None], plane.source)[..., 0]).astype(np.int64)
        J = plane.jacobian
        area = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
        if area.min(where=covered > 0, initial=1.0) >= LEAST_AREA:
            break
    else:
        return Deformed(n, segments, depth)
    visible = covered > 0
    s, (g, slope) = np.exp(rng.normal(0, DEPTH)), height(rng, mask.shape)
    before = _within(n, mask, plane.source)
    across = s * np.einsum("hwij,hwi->hwj", J, before[..., :2]) - before[..., 2:] * slope
    after = np.concatenate([across, before[..., 2:]], -1)
    after /= np.maximum(np.linalg.norm(after, axis=-1, keepdims=True), 1e-9)
    after = (after * visible[..., None]).astype(np.float32)
    if depth is None:
        return Deformed(after, covered, None)
    behind = _within(depth[..., None], mask, plane.source)[..., 0]
    behind = (s / plane.scale * behind - half_extent * g) * visible
    return Deformed(after, covered, behind.astype(np.float32))


def plane_map(rng: np.random.Generator, mask: np.ndarray) -> PlaneMap:
    """Return a random map of the plane that brings the object of a mask (H, W) into the frame."""
    x, y = pixel_grid(*mask.shape)
    angle = rng.uniform(-np.pi, np.pi) if rng.random() < ROTATED else rng.normal(0, TILT)
    cos, sin = np.cos(angle), np.sin(angle)
    stretch = np.exp(rng.normal(0, STRETCH, 2))
    shear = np.array([[1, rng.normal(0, SHEAR)], [0, 1]])
    linear = np.array([[cos, -sin], [sin, cos]]) @ shear @ np.diag(stretch / stretch.prod() ** 0.5)
    places = np.linalg.inv(linear) @ np.stack([x[mask], y[mask]])
    low, high = places.min(1), places.max(1)
    scale = (high - low).max() / (2 * MARGIN) * np.exp(rng.uniform(0, SMALLER))
    scale = max(float(scale), 2 / max(mask.shape))
    bend = [smooth(rng, mask.shape, BROAD_NODES) for _ in range(2)]
    amount = rng.uniform(0, BEND)
    moved = np.stack([x, y], -1) + amount * np.stack([value for value, _ in bend], -1)
    jacobian = np.eye(2) + amount * np.stack([gradient for _, gradient in bend], -2)
    return PlaneMap((scale * moved + (low + high) / 2) @ linear.T, linear @ jacobian, scale)


def height(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return a random height g (H, W) and its gradient (H, W, 2)."""
    fields = [(rng.uniform(0, SWELLING), BROAD_NODES)]
    if rng.random() < RELIEF:
        fields.append((rng.uniform(*RELIEF_SLOPE), RELIEF_NODES))
    slope = rng.normal(0, SLOPE, 2)
    g = np.stack(pixel_grid(*shape), -1) @ slope
    gradient = np.broadcast_to(slope, (*shape, 2))
    for amount, nodes in fields:
        value, change = smooth(rng, shape, nodes)
        g, gradient = g + amount * value, gradient + amount * change
    return g, gradient


def smooth(
    rng: np.random.Generator, shape: tuple[int, ...], nodes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a smooth random field (H, W) and its gradient (H, W, 2) of mean square 1.

    nodes  least and largest number of random values along a side
    """
    count = int(rng.integers(nodes[0], nodes[1] + 1))
    values = torch.from_numpy(rng.normal(0, 1, (1, 1, count, count)))
    field = F.interpolate(values, shape, mode="bicubic", align_corners=True)[0, 0].numpy()
    rows, columns = np.gradient(field, 2 / max(shape))
    gradient = np.stack([columns, -rows], -1)
    size = np.sqrt((gradient**2).sum(-1).mean())
    return field / size, gradient / size


def _within(values: np.ndarray, mask: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return values (H, W, C) at places (H, W, 2), interpolated inside the mask alone.

    Beside the mask's rim they are those of the nearest pixel.
    """
    inside = _sample(mask[..., None], source, "bilinear") > 1 - 1e-4
    return np.where(inside, _sample(values, source, "bilinear"), _nearest(values, source))


def _nearest(values: np.ndarray, source: np.ndarray) -> np.ndarray:
    return _sample(values, source, "nearest")


def _sample(values: np.ndarray, source: np.ndarray, mode: str) -> np.ndarray:
    """Return values (H, W, C) at places (H, W, 2); 0 outside the picture."""
    height, width = values.shape[:2]
    size = np.array([width, -height]) / max(height, width)
    grid = torch.from_numpy((source / size).astype(np.float32))[None]
    image = torch.from_numpy(np.ascontiguousarray(values, np.float32)).permute(2, 0, 1)[None]
    result = F.grid_sample(image, grid, mode=mode, align_corners=False)
    return result[0].permute(1, 2, 0).numpy()
