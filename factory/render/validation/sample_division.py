"""What a division of samples over a picture's pixels can save, by the noise of each pixel.

variance  (P,) of the display values of the mask's pixels at one sample; σ is its root. With n
          samples in a pixel its noise is variance / n.
"""

from __future__ import annotations

import numpy as np

from shaders import tone

TILE = 16  # pixels across a square
FLOOR = 0.1  # of the mean σ: a pixel that a pilot shows without noise may have some


def display_variance(pictures: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return each pixel's variance of display values, (P,), to first order in the noise.

    pictures  (K, P, 3) independent pictures of the mask's pixels, linear radiance
    mask      (height, width) bool
    """
    mean = pictures.mean(0)
    whole_picture = np.zeros((*mask.shape, 3), np.float32)
    whole_picture[mask] = mean
    exposure = tone.auto_exposure(whole_picture, mask)
    step = 1e-4 / exposure
    rise = tone.display(mean + step, exposure) - tone.display(np.maximum(mean - step, 0), exposure)
    slope = rise / (mean + step - np.maximum(mean - step, 0))
    return np.asarray((pictures.var(0, ddof=1) * slope**2).mean(-1))


def best_gain(variance: np.ndarray) -> float:
    """Return how many times fewer samples n ∝ σ needs for the same mean error; variance (P,)."""
    return float(variance.mean() / np.sqrt(variance).mean() ** 2)


def over_tiles(variance: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the mean variance in each pixel's square of TILE pixels; both (P,)."""
    y, x = np.nonzero(mask)
    tile = y // TILE * mask.shape[1] + x // TILE
    total, count = np.bincount(tile, variance), np.bincount(tile)
    return np.asarray(total[tile] / count[tile])


def gain_of(share: np.ndarray, variance: np.ndarray) -> float:
    """Return the same of any division: below 1 it needs more samples than an equal one.

    share     (P,) in proportion to the samples of each pixel
    variance  (P,) at one sample
    """
    return float(variance.mean() / (variance * share.mean() / share).mean())


def piloted_share(variance: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return n ∝ σ, (P,), by an uncertain variance (P,): averaged over 3×3 pixels, and not 0."""
    padded = np.pad(np.zeros(mask.shape), 1)
    count = padded.copy()
    padded[1:-1, 1:-1][mask], count[1:-1, 1:-1][mask] = variance, 1
    height, width = mask.shape
    total, near = (
        sum(each[y : y + height, x : x + width] for y in range(3) for x in range(3))
        for each in (padded, count)
    )
    share = np.sqrt(np.asarray(total)[mask] / np.asarray(near)[mask])
    return np.maximum(share, FLOOR * share.mean() + 1e-30)
