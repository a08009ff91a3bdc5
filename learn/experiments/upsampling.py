"""How an edit gets to the photograph's own size, tried: ways to upsample, and detail carried over,
against rendered truth.

The network sees an object at 128², its photograph may show it at a thousand. Painter enlarges
normals and renders at the photograph's size. Tried beside it:

detail D                  Painter's, D of 1: what the photograph shows finer than the network's
pixels
picture, bilinear         the edit rendered at the network's size, enlarged
picture, joint bilateral  the same, weighed by how like the photograph is (Kopf et al. 2007, Eq. 4)
picture, guided filter    the same, as a local linear function of the photograph (He et al. 2010,
Eq. 5 to 8)
normals, joint bilateral  normals enlarged so, and rendered at the photograph's size

h, w network; H, W photograph; the guide is the photograph's compressed luminance
(learn.networks.coding.compressed)
"""

from functools import partial

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import uniform_filter

from learn.data import photographs
from learn.editing.decomposition import Painter, dilated, enlarged_normals, nearest
from shaders.tone import LUMINANCE

DETAILS = (0.25, 0.5, 1.0)
# network pixels; network pixels, and units of the guide at which a neighbour counts e^-½
REACH, NEAR, ALIKE = 2, 1.0, 0.1
WINDOW, FLAT = 5, 1e-3  # network pixels; variance of the guide below which nothing follows it


def joint_bilateral(low, guide_low, guide):
    """(H, W, C) of low (h, w, C): each pixel the mean of the nearest (2 REACH + 1)², by distance
    and by guides (h, w), (H, W).
    """
    h, w = guide_low.shape
    y, x = ((np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(guide.shape, (h, w), strict=True))
    total, result = np.zeros(guide.shape), np.zeros((*guide.shape, low.shape[-1]))
    for i in range(-REACH, REACH + 1):
        for j in range(-REACH, REACH + 1):
            rows, columns = np.rint(y).astype(int) + i, np.rint(x).astype(int) + j
            near = np.exp(-((rows - y)[:, None] ** 2 + (columns - x)[None] ** 2) / (2 * NEAR**2))
            at = np.clip(rows, 0, h - 1)[:, None], np.clip(columns, 0, w - 1)[None]
            # where none is alike, the nearest
            weight = near * np.exp(-((guide - guide_low[at]) ** 2) / (2 * ALIKE**2)) + 1e-6 * near
            total += weight
            result += weight[..., None] * low[at]
    return (result / total[..., None]).astype(np.float32)


def guided(low, guide_low, guide):
    """(H, W, C) of low (h, w, C): locally a guide_low + b by least squares, a and b enlarged
    bilinearly.
    """
    mean = partial(uniform_filter, size=WINDOW, mode="nearest")
    of_guide, planes = mean(guide_low), []
    variance = mean(guide_low**2) - of_guide**2
    for p in np.moveaxis(low, -1, 0):
        a = (mean(p * guide_low) - mean(p) * of_guide) / (variance + FLAT)
        b = mean(p) - a * of_guide
        a, b = (photographs.resized(mean(each).astype(np.float32), len(guide)) for each in (a, b))
        planes.append(a * guide + b)
    return np.maximum(np.stack(planes, -1), 0).astype(np.float32)


def guides(apart, size):
    """The photograph's compressed luminance in the object's square, (h, w) and (size, size), its
    object continued beyond the mask.
    """
    square = photographs.placed(apart.photograph.balanced, apart.framed.box) * apart.framed.exposure
    mask = photographs.placed(apart.photograph.mask.astype(np.float32), apart.framed.box) > 0
    seen = nearest(np.log1p(8 * (square @ LUMINANCE.astype(np.float32))) / np.log(9), mask)
    return photographs.resized(seen, len(apart.framed.mask)), photographs.resized(seen, size)


class Remembering(Painter):
    """A Painter that renders a label once."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._known = {}

    def radiance(self, label):
        key = np.asarray(label, np.float32).tobytes()
        if key not in self._known:
            self._known[key] = super().radiance(label)
        return self._known[key]


class Small(Painter):
    """A Painter that renders at the network's size. upsample: (picture (h, w, 3), guide (h, w),
    guide (H, W)) → (H, W, 3).
    """

    def __init__(self, apart, upsample=None):
        super().__init__(apart)
        self.grid, self.upsample = len(apart.framed.mask), upsample
        self.n = enlarged_normals(apart.parts.n[0], apart.framed.mask, self.grid)
        rows = ((np.arange(self.grid) + 0.5) * self.side / self.grid).astype(int)
        wide = dilated(dilated(self.coverage[rows][:, rows] > 0))
        self.segments = torch.from_numpy(
            np.where(wide, self.filled[rows][:, rows], 0).astype(np.int64)
        )

    def enlarged(self, picture):
        return (
            super().enlarged(picture)
            if self.upsample is None
            else self.upsample(picture, *guides(self.decomposition, self.side))
        )


class GuidedNormals(Painter):
    """A Painter whose normals follow the photograph's edges."""

    def __init__(self, apart):
        super().__init__(apart)
        low = enlarged_normals(apart.parts.n[0], apart.framed.mask, len(apart.framed.mask))
        self.n = F.normalize(
            torch.from_numpy(joint_bilateral(low.numpy(), *guides(apart, self.grid))), dim=-1
        )


def painters(apart):
    """{name: Painter}: the first is the one in use."""
    plain = Remembering(apart)
    result = {"normals enlarged": plain}
    for detail in DETAILS:
        painter = Remembering(apart, plain.tolerance, detail)
        painter._known = plain._known
        result[f"detail {detail:g}"] = painter
    result["picture, bilinear"] = Small(apart)
    result["picture, joint bilateral"] = Small(apart, joint_bilateral)
    result["picture, guided filter"] = Small(apart, guided)
    result["normals, joint bilateral"] = GuidedNormals(apart)
    return result
