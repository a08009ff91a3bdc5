"""Tone mapping, colour conversion, and the paper's distance between pictures.

radiance  linear Rec.709, any scale; exposure brings it to [0, 1]
display   values in [0, 255] after clipping and the sRGB curve (IEC 61966-2-1)
"""

import numpy as np

from shaders.arrays import Array, namespace

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709 R, G and B


def srgb(linear: Array) -> Array:
    """Return the sRGB encoding of linear values in [0, 1]; values outside are clipped."""
    xp = namespace(linear)
    x = xp.clip(linear, 0.0, 1.0)
    # the power's slope is infinite at 0, where the straight part is used
    safe = xp.clip(x, 0.0031308, 1.0)
    return xp.where(x <= 0.0031308, 12.92 * x, 1.055 * safe ** (1 / 2.4) - 0.055)


def linear_from_srgb(encoded: Array) -> Array:
    """Return the linear values of sRGB-encoded ones in [0, 1]: the inverse of `srgb`."""
    xp = namespace(encoded)
    return xp.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def display(radiance: Array, exposure: float | Array) -> Array:
    """Return display values in [0, 255] of linear radiance times exposure."""
    return 255.0 * srgb(radiance * exposure)


def display_slope(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Return the change of display values per unit of radiance, at radiance of any shape.

    Differences of radiance times the slope have no bias, whereas display values of noisy radiance
    are too dark on average, since the curve is concave. It is taken over a step of one hundredth.
    """
    step = np.float32(0.01) * radiance + np.float32(1e-4 / exposure)
    return (display(radiance + step, exposure) - display(radiance, exposure)) / step


def auto_exposure(radiance: np.ndarray, mask: np.ndarray, percentile: float = 99.0) -> float:
    """Return the factor that brings the mask's `percentile` of luminance to 1.

    radiance (height, width, 3), mask (height, width) bool. The factor is 1.0 for an empty mask or a
    black picture.
    """
    luminance = np.asarray(radiance, dtype=np.float64)[np.asarray(mask, dtype=bool)] @ LUMINANCE
    level = np.percentile(luminance, percentile) if luminance.size else 0.0
    return float(1.0 / level) if level > 0 else 1.0


def squared_difference(a: Array, b: Array) -> Array:
    """Return the mean over channels of the squared difference of display values (…, 3)."""
    return ((a - b) ** 2).mean(-1)


def display_l2(a: Array, b: Array, exposure: float | Array, mask: Array | None = None) -> Array:
    """Return the paper's L2: the mean squared difference of display values.

    a, b  (height, width, 3) linear radiance; mask (height, width) bool, None: the full frame
    """
    squared = squared_difference(display(a, exposure), display(b, exposure))
    return squared.mean() if mask is None else squared[mask].mean()
