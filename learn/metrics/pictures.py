"""How far a picture stands from the true one, as people see them.

Both are brought to display values in [0, 255]: times one exposure, that brings the 99th percentile
of the truth's luminance over the mask to 1, clipped, and through the sRGB curve (shaders.tone). All
figures are of display values.

l2          the paper's: mean over the mask's pixels of the mean over channels of the squared
difference; l2_frame: over the full frame
ssim        structural similarity, windows of 7 (scikit-image), mean over the mask; ssim_frame: over
the full frame
psnr        10 log₁₀ (255² / l2) in dB, at most 68: rounding to whole display values alone is 59
flip        FLIP (Andersson et al. 2020; package flip-evaluator) at 67 pixels a degree, mean over
the mask: 0 alike, 1 at most
lpips       only with weights (learn.metrics.lpips)
"""

import numpy as np
from skimage.metrics import structural_similarity

from shaders import tone

LEAST_L2 = 0.01  # of PSNR


def compare(picture, truth, mask, perceptual=None):
    """{figure: value} of radiance against true radiance (H, W, 3); mask (H, W) bool, not empty.
    ssim is None below 7 × 7 pixels.

    perceptual  display values, display values → float, or None
    """
    exposure = tone.auto_exposure(truth, mask)
    shown, right = tone.display(picture, exposure), tone.display(truth, exposure)
    error = squared(shown, right)
    l2, alike = float(error[mask].mean()), similarity_map(shown, right)
    result = {
        "l2": l2,
        "l2_frame": float(error.mean()),
        "ssim": None if alike is None else float(alike[mask].mean()),
        "ssim_frame": None if alike is None else float(alike.mean()),
        "psnr": float(10 * np.log10(255.0**2 / max(l2, LEAST_L2))),
        "flip": float(flip(shown, right)[mask].mean()),
    }
    return result if perceptual is None else result | {"lpips": perceptual(shown, right)}


def display_l2(picture, truth, mask):
    """`l2` alone."""
    return float(tone.display_l2(picture, truth, tone.auto_exposure(truth, mask), mask))


def flip(shown, right):
    """FLIP's error map (H, W) in [0, 1] of display values."""
    from flip_evaluator import evaluate

    test, reference = (np.ascontiguousarray(x / 255.0, np.float32) for x in (shown, right))
    errors, _, _ = evaluate(reference, test, "LDR", inputsRGB=True, applyMagma=False)
    return errors[..., 0]


def squared(a, b):
    """Mean over channels of the squared difference, (H, W)."""
    return ((a - b) ** 2).mean(-1)


def shared(errors):
    """Mean over channels and over pairs of seeds of the product of two seeds' errors (seeds, …, 3):
    what is not noise.
    """
    total, own = errors.sum(0), (errors**2).sum(0)
    count = len(errors)
    return ((total**2 - own) / (count * (count - 1))).mean(-1)


def similarity(a, b, mask):
    """SSIM of display values, mean over the mask; None where the picture is smaller than the
    window.
    """
    values = similarity_map(a, b)
    return None if values is None else float(values[mask].mean())


def similarity_map(a, b):
    """SSIM (H, W) of display values at each pixel, window 7; None where the picture is smaller than
    the window.
    """
    if min(a.shape[:2]) < 7:
        return None
    return structural_similarity(a, b, data_range=255.0, channel_axis=-1, full=True)[1].mean(-1)
