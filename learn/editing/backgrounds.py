"""Estimates the background behind an object's edge, and fills pixels from their neighbours."""

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, maximum_filter, minimum_filter

from learn.editing.photograph import CLEAR

BEHIND_REACH = 3  # pixels on either side whose values limit those of a background
BEHIND_WIDTH = 1.0  # pixels, of the Gaussian by which a background is the mean of nearby pixels


def fill_from_nearest(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return values (H, W) or (H, W, C), outside `where` (H, W) replaced by the nearest inside."""
    if not where.any():
        return values
    index = distance_transform_edt(~where, return_distances=False, return_indices=True)
    return values[tuple(index)]


def background_behind(
    radiance: np.ndarray, coverage: np.ndarray, within: np.ndarray | None = None
) -> np.ndarray:
    """Return radiance (H, W, 3) of what is behind an object's edge in a photograph.

    In a pixel that the object covers in part, the mixture of nearby background and nearby object
    differs from the photograph. The difference is divided between the two so that the sum of their
    squared changes is least. The background is then limited to the range of nearby pixels that the
    object does not cover, so that a mask that is too small does not bring the old colour back.

    radiance  (H, W, 3) linear
    coverage  (H, W) in [0, 1]
    within    (H, W) bool: the photograph's pixels, beyond which nothing is known; None: all
    """
    share, clear, whole = coverage[..., None], coverage < CLEAR, coverage > 1 - CLEAR
    if within is not None:
        clear &= within
    behind = fill_by_nearby_mean(radiance, clear)
    if not whole.any():  # a thread, whose own colour no pixel shows
        return behind.astype(np.float32)
    object_ = fill_from_nearest(radiance, whole)
    residual = radiance - share * object_ - (1 - share) * behind
    corrected = behind + residual * (1 - share) / (share**2 + (1 - share) ** 2)
    size = (2 * BEHIND_REACH + 1, 2 * BEHIND_REACH + 1, 1)
    least = minimum_filter(np.where(clear[..., None], radiance, behind), size)
    most = maximum_filter(np.where(clear[..., None], radiance, behind), size)
    return np.clip(corrected, least, most).astype(np.float32)


def fill_by_nearby_mean(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return values (H, W, C), outside `where` (H, W) replaced by the mean of nearby ones inside.

    They are weighted by a Gaussian of BEHIND_WIDTH. Where none is near, the nearest one is used.
    """
    inside = where.astype(np.float32)
    weight = gaussian_filter(inside, BEHIND_WIDTH)[..., None]
    weighted = [
        gaussian_filter(values[..., k] * inside, BEHIND_WIDTH) for k in range(values.shape[-1])
    ]
    mean = np.stack(weighted, -1) / np.maximum(weight, 1e-6)
    filled = np.where(weight > 0.02, mean, fill_from_nearest(values, where))
    return np.where(where[..., None], values, filled)
