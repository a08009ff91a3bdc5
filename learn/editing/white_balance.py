"""White balance: factors by which a photograph's colours are multiplied before the network."""

from collections.abc import Sequence

import numpy as np

from manifests.errors import InputError
from shaders.tone import LUMINANCE

STRONGEST_BALANCE = 8.0


def find_balance(
    requested: str | Sequence[float], radiance: np.ndarray, where: np.ndarray
) -> np.ndarray:
    """Return factors (3,) float32 for white balance that leave luminance unchanged.

    requested  "none", "grey", or three factors
    radiance   (H, W, 3) linear
    where      (H, W) bool, the pixels that "grey" assumes to be grey on average: the background, or
               the object if there is no background
    Raises     InputError: these pixels are black
    """
    if requested == "none":
        return np.ones(3, np.float32)
    if requested == "grey":
        mean = radiance[where].mean(0)
        if not mean.any():
            raise InputError(
                "--white-balance grey",
                "a background that is not black",
                "a black one",
                "give three factors R,G,B, or none",
            )
        factors = (mean @ LUMINANCE) / np.maximum(mean, 1e-6)
        return np.clip(factors, 1 / STRONGEST_BALANCE, STRONGEST_BALANCE).astype(np.float32)
    factors = np.asarray(requested, np.float32)
    return factors / float(factors @ LUMINANCE)
