"""Strategies that bring an edit from the network's size to the photograph's (upsampling).

The network sees an object at 128²; its photograph may show it at a thousand. `Compositor` upsamples
normals and renders at the photograph's size. Compared with it are:

detail D                  Compositor's; at 1, all that the photograph shows finer than the
                          network's pixels
picture, bilinear         the edit rendered at the network's size, upsampled
picture, joint bilateral  the same, weighted by the photograph's similarity (Kopf et al. 2007,
                          Eq. 4)
picture, guided filter    the same, as a local linear function of the photograph (He et al. 2010,
                          Eq. 5 to 8)
normals, joint bilateral  normals upsampled so, and rendered at the photograph's size

h, w: the network's size; H, W: the photograph's. The guide is the photograph's compressed
luminance (learn.networks.coding.compress).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import uniform_filter

from learn.data import framing
from learn.editing.backgrounds import fill_from_nearest
from learn.editing.compositor import Compositor, dilate, upsample_normals
from learn.editing.decomposition import Decomposition
from shaders.tone import LUMINANCE

DETAILS = (0.25, 0.5, 1.0)
# radius in network pixels; network pixels, and units of the guide, at which a weight is e^-½
RADIUS, SPATIAL_SIGMA, GUIDE_SIGMA = 2, 1.0, 0.1
WINDOW, FLAT = 5, 1e-3  # network pixels; variance of the guide below which nothing follows it

# (picture (h, w, C), guide (h, w), guide (H, W)) → (H, W, C)
Upsample = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def joint_bilateral(low: np.ndarray, guide_low: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Return (H, W, C) of low (h, w, C): a weighted mean of the nearest (2 RADIUS + 1)² pixels.

    Weights fall with the distance, and with the difference of guides (h, w) and (H, W).
    """
    h, w = guide_low.shape
    y, x = ((np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(guide.shape, (h, w), strict=True))
    total, result = np.zeros(guide.shape), np.zeros((*guide.shape, low.shape[-1]))
    for i in range(-RADIUS, RADIUS + 1):
        for j in range(-RADIUS, RADIUS + 1):
            rows, columns = np.rint(y).astype(int) + i, np.rint(x).astype(int) + j
            near = np.exp(
                -((rows - y)[:, None] ** 2 + (columns - x)[None] ** 2) / (2 * SPATIAL_SIGMA**2)
            )
            at = np.clip(rows, 0, h - 1)[:, None], np.clip(columns, 0, w - 1)[None]
            # where none is alike, the nearest
            weight = (
                near * np.exp(-((guide - guide_low[at]) ** 2) / (2 * GUIDE_SIGMA**2)) + 1e-6 * near
            )
            total += weight
            result += weight[..., None] * low[at]
    return (result / total[..., None]).astype(np.float32)


def upsample_guided(low: np.ndarray, guide_low: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Return (H, W, C) of low (h, w, C), locally a · guide + b.

    a and b are fitted at the network's size by least squares and upsampled bilinearly.
    """
    mean = partial(uniform_filter, size=WINDOW, mode="nearest")
    of_guide = mean(guide_low)
    planes = []
    variance = mean(guide_low**2) - of_guide**2
    for p in np.moveaxis(low, -1, 0):
        a = (mean(p * guide_low) - mean(p) * of_guide) / (variance + FLAT)
        b = mean(p) - a * of_guide
        a, b = (framing.resize_square(mean(each).astype(np.float32), len(guide)) for each in (a, b))
        planes.append(a * guide + b)
    return np.maximum(np.stack(planes, -1), 0).astype(np.float32)


def guides(parts: Decomposition, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the photograph's compressed luminance in the object's square, (h, w) and (size, size).

    The object is continued beyond the mask.
    """
    square = framing.cut_square(parts.photograph.balanced, parts.framed.box) * parts.framed.exposure
    mask = framing.cut_square(parts.photograph.mask.astype(np.float32), parts.framed.box) > 0
    seen = fill_from_nearest(
        np.log1p(8 * (square @ LUMINANCE.astype(np.float32))) / np.log(9), mask
    )
    return framing.resize_square(seen, len(parts.framed.mask)), framing.resize_square(seen, size)


class CachedCompositor(Compositor):
    """A Compositor that renders each label once."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._known: dict[bytes, Any] = {}

    def radiance(self, label: Any, read: Sequence[np.ndarray] = ()) -> Any:
        """Return what Compositor renders of a label."""
        key = b"".join(np.asarray(each, np.float32).tobytes() for each in (label, *read))
        if key not in self._known:
            self._known[key] = super().radiance(label, read)
        return self._known[key]


class NetworkSizeCompositor(Compositor):
    """A Compositor that renders at the network's size, and upsamples the picture."""

    def __init__(self, parts: Decomposition, upsample: Upsample | None = None) -> None:
        super().__init__(parts)
        self.grid, self.chosen_upsampling = len(parts.framed.mask), upsample
        self.n = upsample_normals(parts.parts.n[0], parts.framed.mask, self.grid)
        rows = ((np.arange(self.grid) + 0.5) * self.side / self.grid).astype(int)
        wide = dilate(dilate(self.coverage[rows][:, rows] > 0))
        self.segments = torch.from_numpy(
            np.where(wide, self.filled_regions[rows][:, rows], 0).astype(np.int64)
        )

    def upsample(self, picture: np.ndarray) -> np.ndarray:
        """Return a picture (h, w, 3) at the photograph's size; without a function, bilinearly."""
        return (
            super().upsample(picture)
            if self.chosen_upsampling is None
            else self.chosen_upsampling(picture, *guides(self.decomposition, self.side))
        )


class GuidedNormals(Compositor):
    """A Compositor whose normals follow the photograph's edges."""

    def __init__(self, parts: Decomposition) -> None:
        super().__init__(parts)
        low = upsample_normals(parts.parts.n[0], parts.framed.mask, len(parts.framed.mask))
        self.n = F.normalize(
            torch.from_numpy(joint_bilateral(low.numpy(), *guides(parts, self.grid))), dim=-1
        )


def painters(parts: Decomposition) -> dict[str, Compositor]:
    """Return {name: Compositor}; the first is the strategy in use."""
    plain = CachedCompositor(parts)
    result: dict[str, Compositor] = {"normals enlarged": plain}
    for detail in DETAILS:
        painter = CachedCompositor(parts, plain.tolerance, detail)
        painter._known = plain._known
        result[f"detail {detail:g}"] = painter
    result["picture, bilinear"] = NetworkSizeCompositor(parts)
    result["picture, joint bilateral"] = NetworkSizeCompositor(parts, joint_bilateral)
    result["picture, guided filter"] = NetworkSizeCompositor(parts, upsample_guided)
    result["normals, joint bilateral"] = GuidedNormals(parts)
    return result
