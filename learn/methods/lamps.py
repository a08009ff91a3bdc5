"""Lamps: texels much brighter than most, which samples that follow a narrow lobe may miss.

Samples lie where a lobe is narrow; at an angle where it is broader they are far apart, and a lamp
of one texel falls between them. A sum sees every texel. What it needs is a lamp that is split into
parts as small as the lobe is narrow there, and of few lamps that are few parts. Smooth light is
left to samples.

H, W rows and columns of a map; m (3, 3, 2, 6) one material; lobes (3, 3) bool that count.
"""

import numpy as np
import torch

from learn.methods import Batch, split_texels
from shaders.envmap import centres, row_solid_angles

BRIGHT = 0.25  # of the tolerance: the share of all light beyond which a texel is a lamp
LEAST_TOLERANCE, TOLERANCE = 1e-4, 1e-2  # others count as the nearer of these
SPLITS = (1, 2, 4, 8, 16, 32, 64)  # parts of a lamp's side
# sharpness up to which whole texels of 64 rows serve at TOLERANCE; parts serve more with their
# square, and an error in proportion to the tolerance needs as much less
BROAD = 150.0
SHARE = 0.25  # parts of lamps beside the texels of the map, beyond which no more are split
MOST = 2**17  # the same at small tolerances


def are_split(batch: Batch, lobes: torch.Tensor, tolerance: float) -> torch.Tensor:
    """Return which groups have lobes (G, 3, 3) so narrow that a lamp is to be split, (G,) bool."""
    rotation = batch.camera_from_light.double().numpy()
    views = [None] * len(lobes) if batch.view is None else batch.view.split(batch.counts)
    lights = [batch.light[number] for number in batch.light_of]
    return torch.tensor(
        [
            bool(here.any() and (parts_of(light, m, here, view, rotation, tolerance) > 1).any())
            for light, m, here, view in zip(lights, batch.m, lobes, views, strict=True)
        ],
        device=lobes.device,
    )


def parts_of(
    light: torch.Tensor,
    m: torch.Tensor,
    lobes: torch.Tensor,
    view: torch.Tensor | None,
    camera_from_light: np.ndarray,
    tolerance: float,
) -> np.ndarray:
    """Return into how many parts of its side each lamp is to be split (H, W), 0 for other texels.

    It is 0 too of lamps for which the finest parts are too large, and of the fainter ones where
    there are many.

    light  (H, W, 3)
    view   (P, 3) of each pixel, or None for a distant viewer
    """
    size = light.shape[0], light.shape[1]
    tolerance = float(np.clip(tolerance, LEAST_TOLERANCE, TOLERANCE))
    place = brightest(light.detach().cpu().numpy(), BRIGHT * tolerance)
    row, column = np.divmod(place, size[1])
    w = centres(row, column, *size) @ camera_from_light.T
    finer = tolerance / TOLERANCE
    scale = finer * BROAD * (min(size[0], size[1] / 2) / 64) ** 2
    sharp = split_texels.sharpest_at(m, lobes, view, w, size)
    parts = split_texels.parts_for(sharp, [scale * split**2 for split in SPLITS], SPLITS)
    before = np.cumsum(parts**2) - parts**2
    parts = np.where(before <= min(SHARE * size[0] * size[1] / finer, MOST), parts, 0)
    result = np.zeros(size, parts.dtype)
    result[row, column] = parts
    return result


def brightest(light: np.ndarray, share: float) -> np.ndarray:
    """Return the places of lamps in a flattened map (H, W, 3), the brightest first.

    share  of all light beyond which a texel is a lamp
    """
    energy = (light.max(-1) * row_solid_angles(*light.shape[:2])[:, None]).ravel()
    lamps = np.flatnonzero(energy > share * energy.sum())
    return np.asarray(lamps[np.argsort(-energy[lamps], kind="stable")])
