"""Fits a primitive to a mask and to predicted normals.

The picture is the square that the network sees, with x to the right and y up from −1 to 1. A point
(x, y, z) of the view frame, z towards the viewer, appears at (x, y)/(1 − q z) + centre, where 1/q
is the viewer's distance. What is minimised:

    Σ (coverage − mask)² / Σ mask  +  NORMALS · mean (1 − cos angle between both normals)
        + terms that prefer a plausible perspective and lengths that do not differ much
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from learn.primitives import PRIMITIVES
from learn.primitives.solids import Ball, Box, Cylinder, Solid
from shaders.frames import turned_to_viewer

SOLIDS: dict[str, Solid] = {"box": Box(), "cylinder": Cylinder(), "ball": Ball()}
NORMALS = 0.3  # weight of the predicted normals beside the outline
FURTHEST = 1.2  # |difference of two unit normals| from which a pixel does not count more
WORKING_SIZE = 48  # least side of the reduced square in which a solid is fitted: 64 of 128
STARTS, EVALUATIONS = 4, 24  # descents, and the iterations of each
LARGEST_PERSPECTIVE = 0.45  # q that is usual: the viewer is 2.2 half squares away
AXES = 8  # directions in the picture along which extents are compared


@dataclass(frozen=True)
class PrimitiveFit:
    """A primitive in place of an object.

    normals  (H, W, 3) float32 in the frame of each pixel's viewer, as networks predict them
    overlap  intersection over union of its outline and the mask; 1 for "flat", which has none
    """

    normals: np.ndarray
    overlap: float


@dataclass(frozen=True)
class _Parameters:
    """Where a solid is: rotation (3, 3) into the view frame, sizes, centre (2,), perspective q."""

    R: np.ndarray
    sizes: np.ndarray
    centre: np.ndarray
    q: float


def fit_primitive(name: str, coverage: np.ndarray, predicted: np.ndarray) -> PrimitiveFit:
    """Return the PrimitiveFit of an object.

    name       one of PRIMITIVES
    coverage   (H, H) in [0, 1]: the mask in the network's square
    predicted  (H, H, 3) unit normals where the mask is at least a half
    Raises     ValueError for another name
    """
    if name not in PRIMITIVES:
        raise ValueError(f"primitive: expected one of {PRIMITIVES}, found {name!r}")
    inside = coverage >= 0.5
    if name == "flat":
        mean = predicted[inside].sum(0)
        n = np.broadcast_to(mean / np.linalg.norm(mean), predicted.shape)
        return PrimitiveFit(n.astype(np.float32), 1.0)
    solid = SOLIDS[name]
    mask, normals = _reduce(coverage, np.where(inside[..., None], predicted, 0), WORKING_SIZE)
    work = _Picture(mask, normals)
    begun = sorted(
        (_start(solid, R, work) for R in _rotations(name)),
        key=lambda p: float((_residuals(solid, work, p) ** 2).sum()),
    )
    best = min((_descend(solid, work, p) for p in begun[:STARTS]), key=lambda pair: pair[0])[1]
    whole = _Picture(coverage, predicted)
    shown = _coverage(solid, whole, best)
    overlap = np.minimum(shown, coverage).sum() / np.maximum(shown, coverage).sum()
    return PrimitiveFit(_normals(solid, whole, best).astype(np.float32), float(overlap))


class _Picture:
    """A mask (H, H) with predicted normals (H, H, 3), and where its pixels lie."""

    def __init__(self, mask: np.ndarray, predicted: np.ndarray):
        self.mask, self.predicted = mask, predicted
        # an object thinner than a pixel covers none by half
        self.mostly = mask >= 0.5 * mask.max()
        self.inside = self.mostly & ((predicted**2).sum(-1) > 0.5)
        g = (np.arange(len(mask)) + 0.5) / len(mask) * 2 - 1
        self.at = np.stack(np.meshgrid(g, -g), -1)


def _reduce(coverage: np.ndarray, normals: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a mask and normals averaged to about size²."""
    k = max(len(coverage) // size, 1)
    n = len(coverage) // k
    cut = n * k
    mask = coverage[:cut, :cut].reshape(n, k, n, k).mean((1, 3))
    mean = normals[:cut, :cut].reshape(n, k, n, k, 3).mean((1, 3))
    return mask, mean / np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-6)


def _rotations(name: str) -> list[np.ndarray]:
    """Return rotations (3, 3) from which a fit may start."""
    pitches = np.radians([-15, 0, 15, 30, 50, 70])
    if name == "box":
        turns = np.radians(np.arange(0, 90, 15))
        return [
            _about(2, roll) @ _about(0, pitch) @ _about(1, turn)
            for turn in turns
            for pitch in pitches
            for roll in np.radians([-20, 0, 20])
        ]
    rolls = np.radians([-60, -30, 0, 30, 60, 90])
    upright = _about(0, -np.pi / 2)  # its own z becomes the picture's y
    return [_about(2, r) @ _about(0, pitch) @ upright for pitch in pitches for r in rolls]


def _about(axis: int, angle: float) -> np.ndarray:
    """Return the rotation (3, 3) about a coordinate axis."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = np.cos(angle)
    R[k, j], R[j, k] = np.sin(angle), -np.sin(angle)
    return R


def _start(solid: Solid, R: np.ndarray, work: _Picture) -> _Parameters:
    at = work.at[work.mostly]
    angle = np.arange(AXES) * np.pi / AXES
    axes = np.stack([np.cos(angle), np.sin(angle)], 1)
    low, high = np.quantile(at @ axes.T, (0.005, 0.995), axis=0)
    return _Parameters(R, solid.sizes(R, axes, (high - low) / 2), at.mean(0), 0.15)


def _descend(solid: Solid, work: _Picture, start: _Parameters) -> tuple[float, _Parameters]:
    """Return what least squares reaches from a start: the sum of squares, and the parameters."""

    def parameters(x: np.ndarray) -> _Parameters:
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ start.R
        count = solid.count
        sizes = start.sizes * np.exp(np.clip(x[3 : 3 + count], -4, 4))
        return _Parameters(R, sizes, start.centre + x[3 + count : 5 + count], start.q + x[-1])

    x = np.zeros(3 + solid.count + 3)
    result = least_squares(
        lambda x: _residuals(solid, work, parameters(x)),
        x,
        method="trf",
        diff_step=2e-2,
        x_scale=np.r_[np.full(3, 0.3), np.full(solid.count, 0.3), 0.1, 0.1, 0.15],
        max_nfev=EVALUATIONS,
    )
    return float(result.cost), parameters(result.x)


def _residuals(solid: Solid, work: _Picture, p: _Parameters) -> np.ndarray:
    """Return what is squared and summed."""
    outline = (_coverage(solid, work, p) - work.mask) / np.sqrt(work.mask.sum())
    difference = (_normals(solid, work, p) - work.predicted)[work.inside]
    length = np.linalg.norm(difference, axis=-1, keepdims=True)
    difference *= np.minimum(1, FURTHEST / np.maximum(length, 1e-9))
    shade = np.sqrt(NORMALS / 2 / max(len(difference), 1)) * difference
    logs = np.log(p.sizes)
    plausible = np.r_[
        0.14 * p.q,
        0.55 * max(p.q - LARGEST_PERSPECTIVE, 0),
        0.55 * min(p.q, 0),
        solid.even * (logs - logs.mean()),
    ]
    return np.concatenate([outline.ravel(), shade.ravel(), plausible])


def _coverage(solid: Solid, picture: _Picture, p: _Parameters) -> np.ndarray:
    """Return how much of each pixel (H, H) the solid covers: 0 to 1 within a pixel's width."""
    V = solid.points(p.sizes) @ p.R.T
    shown = V[:, :2] / np.maximum(1 - p.q * V[:, 2:], 0.05) + p.centre
    try:
        hull = ConvexHull(shown)
    except (QhullError, ValueError):
        return np.zeros(picture.mask.shape)
    # the equations' normals point outwards; the distance inside is the least over all edges
    depth = -(picture.at @ hull.equations[:, :2].T + hull.equations[:, 2]).max(-1)
    return np.clip(depth * len(picture.mask) / 2 + 0.5, 0, 1)


def _normals(solid: Solid, picture: _Picture, p: _Parameters) -> np.ndarray:
    """Return unit normals (H, H, 3), turned so that each pixel's viewer is at +z."""
    xy = picture.at - p.centre
    d = np.concatenate([-p.q * xy, np.ones((*xy.shape[:2], 1))], -1)
    o = np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], -1)
    n = solid.normals(o @ p.R, d @ p.R, p.sizes) @ p.R.T
    return turned_to_viewer(n, d / np.linalg.norm(d, axis=-1, keepdims=True))
