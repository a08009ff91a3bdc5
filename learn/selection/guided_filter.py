"""A filter that smooths maps and lets their edges follow those of a picture.

Superpixels have edges of their own where the picture has none, and mix colours at edges that it
has, so that what is made of them has teeth. Around each pixel, a map is therefore replaced by the
linear function of the picture's colours that fits it best (He, Sun and Tang, "Guided Image
Filtering", PAMI 2013).
"""

import numpy as np
from scipy.ndimage import uniform_filter

RADIUS = 8 / 512  # of the square in which functions are fitted, as a share of the longer side
NOISE = 1e-3  # variance of colours, CIELAB / 100, that is too small to be followed


class GuidedFilter:
    """The filter of one picture, whose colours are examined once."""

    def __init__(self, lab: np.ndarray):
        """Examine colours (h, w, 3), CIELAB."""
        self._side = 2 * max(1, round(RADIUS * max(lab.shape[:2]))) + 1
        self._colours = (lab / 100).astype(np.float32)
        self._mean = self._average(self._colours)
        products = self._colours[..., :, None] * self._colours[..., None, :]
        spread = self._average(products) - self._mean[..., :, None] * self._mean[..., None, :]
        self._inverse = np.linalg.inv(spread + NOISE * np.eye(3, dtype=np.float32))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return a map (h, w) float32 whose edges are moved to those of the picture."""
        values = values.astype(np.float32)
        mean = self._average(values)
        product = self._average(self._colours * values[..., None])
        covariance = product - self._mean * mean[..., None]
        slope = np.einsum("yxij,yxj->yxi", self._inverse, covariance)
        offset = mean - (slope * self._mean).sum(-1)
        return (self._average(slope) * self._colours).sum(-1) + self._average(offset)

    def _average(self, values: np.ndarray) -> np.ndarray:
        """Return the mean of values (h, w, …) over the square around each pixel."""
        sides = (self._side, self._side, *[1] * (values.ndim - 2))
        return uniform_filter(values, sides, mode="nearest")
