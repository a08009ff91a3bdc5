"""What a denoiser took away with the noise, put back where similar pixels agree on it.

what      smoothed picture + mean of (noisy − smoothed) over the similar pixels around each one.
          Averaging removes the noise of that difference, and what is left of it is detail. It is
          what statistics calls twicing (Tukey, Exploratory Data Analysis, 1977), with a filter
          that does not mix pixels across edges (Tomasi and Manduchi 1998)
similar   pixels at most `RADIUS` away whose normals and smoothed display values differ by little
bias      two fifths to two thirds of the denoiser's squared bias are left
noise     about a tenth of the noisy picture's error is added, so that it does not always pay:
          factory.render.estimators.blends takes it where the halves show less error with it
measured  docs/log/rendering.md, "What a denoiser takes away"
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SPREAD = 2.0  # pixels: standard deviation of the weights by distance
RADIUS = 4  # pixels
NORMALS = 0.3  # standard deviation of the weights by the difference of normals
VALUES = 15.0  # the same by the difference of smoothed values, in grey levels
# a weight is (1 − d²/(2 · POWER))^POWER, d² the squared distance in these units: nearly e^(−d²/2),
# but 0 beyond a distance, and the same on every machine
POWER = 4
# times the smoothed picture. Errors are known by the display curve's slope at the smoothed picture,
# which says nothing of what is far from it
LEAST, MOST = 0.5, 2.0


class Effect(NamedTuple):
    """What is expected of pictures with detail put back.

    bias   share of the squared bias that is left
    noise  share of the noisy picture's error that is added
    """

    bias: float
    noise: float


def put_back(
    smooth: np.ndarray,
    noisy: np.ndarray,
    normals: np.ndarray,
    slope: np.ndarray,
    mask: np.ndarray,
) -> np.ndarray:
    """Return the smoothed picture (height, width, 3) with detail that the noisy one shows.

    smooth, noisy  radiance (height, width, 3), the noisy one of the same samples
    normals        (height, width, 3) as guides have them: means over each pixel
    slope          (height, width, 3) of the display curve, in grey levels per unit of radiance
    mask           (height, width) bool, the pixels that may change. Where the slope is 0, because
                   the smoothed picture is overexposed, they stay as they are
    """
    # and numba, which takes half a second
    from factory.render.estimators.similar_pixels import average_similar

    mask = mask & (slope > 0).all(-1)
    features = np.concatenate([normals / NORMALS, smooth * slope / VALUES], axis=-1)
    distances = np.arange(RADIUS + 1)
    detail = average_similar(
        np.ascontiguousarray(noisy - smooth, np.float32),
        np.ascontiguousarray(features, np.float32),
        np.ascontiguousarray(mask),
        np.exp(-0.5 * (distances / SPREAD) ** 2).astype(np.float32),
        POWER,
    )
    return np.clip(smooth + detail, np.float32(LEAST) * smooth, np.float32(MOST) * smooth)
