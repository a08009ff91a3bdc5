"""Gives masks the soft edge that an edit needs: fits it to the photograph, or blurs it.

coverage  (H, W) in [0, 1]: the object's share of each pixel
"""

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from learn.data import photographs
from learn.editing import mask_edges

# a mask is black and white if its coverage is everywhere closer to 0 or 1 than this: half a step of
# 8 bits is 0.002, and white through the sRGB curve is 1 − 6e-8
GREY = 1e-3


def is_black_and_white(coverage: np.ndarray) -> bool:
    """Return whether a mask (H, W) in [0, 1] has no grey."""
    return bool((np.minimum(coverage, 1 - coverage) < GREY).all())


def soften(coverage: np.ndarray) -> np.ndarray:
    """Return a mask (H, W) in [0, 1], blurred so that its steps do not show, unless it has grey."""
    if not is_black_and_white(coverage):
        return coverage
    return gaussian_filter(coverage.astype(np.float32), mask_edges.SOFTENING)


def fit_regions(
    radiance: np.ndarray, coverage: np.ndarray, labels: np.ndarray, fixed: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return coverage and labels (H, W) whose edge is fitted to the picture.

    None if a region, such as a thread, would keep fewer than LEAST_PIXELS pixels, or if the mask
    has too much edge to be fitted.

    radiance  (H, W, 3) linear, with white at about 1
    labels    (H, W) 0 … S: the regions, 0 beyond them
    fixed     (H, W) bool: pixels that stay as they are
    """
    try:
        fitted = mask_edges.fit(radiance, coverage, fixed)
    except mask_edges.RaggedError:
        return None
    before, after = coverage >= 0.5, fitted >= 0.5
    near = distance_transform_edt(labels == 0, return_distances=False, return_indices=True)
    moved = np.where(after & ~before, labels[tuple(near)], labels * (after | ~before))
    moved = moved.astype(labels.dtype)
    counts = np.bincount(moved.ravel(), minlength=int(labels.max()) + 1)[1:]
    if (counts < photographs.LEAST_PIXELS).any():
        return None
    return fitted, moved
