"""Closed-form matting in the band about a mask's edge, to compare learn.editing.mask_edges with.

After Levin, Lischinski and Weiss, "A closed-form solution to natural image matting" (PAMI 2008):
in each window of 3 × 3 pixels, coverage is taken to be linear in the colours.
"""

import numpy as np
from scipy import sparse
from scipy.ndimage import maximum_filter
from scipy.sparse.linalg import spsolve

from learn.editing import mask_edges
from shaders import tone

NOISE = 1e-5  # added to the variance of a window's display values
LEAST = 1e-9  # weight of the given mask, where no window reaches what is certain


def matted(radiance: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Return coverage (H, W), matted in those pixels that learn.editing.mask_edges.fit may change.

    radiance  (H, W, 3) linear
    coverage  (H, W) in [0, 1]: the given mask
    """
    inside = coverage >= 0.5
    band = mask_edges.band_about(inside, mask_edges.band_width(inside))
    laplacian = _laplacian(tone.display(radiance, 1.0) / 255, maximum_filter(band, 3))
    free, given = band.ravel(), inside.ravel().astype(float)
    system = laplacian[free][:, free] + LEAST * sparse.eye(int(free.sum()))
    right = LEAST * given[free] - laplacian[free][:, ~free] @ given[~free]
    result = given.copy()
    result[free] = np.clip(spsolve(system.tocsc(), right), 0, 1)
    return result.reshape(inside.shape).astype(np.float32)


def _laplacian(display: np.ndarray, centres: np.ndarray) -> sparse.csr_matrix:
    """Return the matting Laplacian (H·W, H·W) of the windows about pixels (H, W) bool."""
    height, width = centres.shape
    index = np.arange(height * width).reshape(height, width)
    centres = centres.copy()
    centres[[0, -1]] = centres[:, [0, -1]] = False
    row, column = np.nonzero(centres)
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    window = np.stack([index[row + i, column + j] for i, j in steps], 1)
    colours = display.reshape(-1, 3)[window].astype(float)
    centred = colours - colours.mean(1, keepdims=True)
    variance = np.einsum("nij,nik->njk", centred, centred) / 9 + NOISE / 9 * np.eye(3)
    like = np.einsum("nij,njk,nlk->nil", centred, np.linalg.inv(variance), centred)
    values = np.eye(9) - (1 + like) / 9
    rows, columns = np.repeat(window, 9, 1).ravel(), np.tile(window, (1, 9)).ravel()
    return sparse.csr_matrix((values.ravel(), (rows, columns)), 2 * (height * width,))
