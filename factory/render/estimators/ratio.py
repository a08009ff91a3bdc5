"""Direct light without noise, times the denoised ratio of what is blocked or reflected on.

what      closed form · denoised picture / denoised picture without shadows and interreflection. Of
          each half both pictures have the same seed, so that most of their noise is common and
          their ratio has little (Heitz, Hill and McGuire 2018, "Combining analytic direct
          illumination and stochastic shadows")
bias      of the denoiser, where it treats the two pictures differently: the estimate contains it,
          and a share of unbiased pictures (`reduce_noise`) keeps it below a third of the limit.
          That of the closed form is added: it is measured by the samples without shadows
cost      every sample twice, both denoisings, and the closed form
fails     interreflection in strong highlights, which unoccluded light does not show. The ratio is
          cut off at MOST; where there is no light to divide by, the denoised picture stands
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from factory.render.estimators import blends, denoised
from factory.render.estimators.blends import Blend
from factory.render.estimators.halves import CONFIDENCE, Estimate
from factory.render.estimators.lost_detail import Effect
from manifests.schema import Estimator

NAME: Estimator = "ratio"
MOST = 3.0  # of the ratio: light that is reflected on raises it above 1
DARK = 1e-6  # radiance by which nothing is divided
# squared bias: scale · noise^POWER, where noise is the error of the unbiased pictures. The scale is
# SCALE by the size of the frame (denoised.size_factor) until the first try has measured it
SCALE, POWER = 1.5, 0.55
# medians of 24 shots of 64², before lost_detail.LEAST and MOST; with them it is 0.62 and 0.09
DETAIL = Effect(bias=0.5, noise=0.2)
WITH_NOISE = 1.2  # error of the mean of both halves, over its bias
UNCERTAINTY = 0.25  # of the estimate, in units of itself
LEAST = 2  # samples of each half
MOST_SAMPLES = 1 << 20  # more never help
MOST_TRIES = 4
MOST_LEFT = 0.7  # of the noise: where direct light explains less of it a ratio is not tried
AROUND = 4  # pixels to each side by whose noise β is known
# of the unbiased pictures: alone they have a third of path tracing's noise on many shots
SHARES = blends.UP_TO_ALL


def multiply_by_ratio(direct: np.ndarray, shown: np.ndarray, unblocked: np.ndarray) -> np.ndarray:
    """Return the picture (height, width, 3).

    direct     (height, width, 3) by the closed form
    shown      by all light paths of the tier, denoised
    unblocked  by direct light without shadows, of the same samples, denoised
    """
    share = np.clip(shown / np.maximum(unblocked, np.float32(DARK)), 0, MOST)
    return np.where(unblocked > DARK, direct * share, shown).astype(np.float32)


def reduce_noise(
    direct: np.ndarray,
    shown: Sequence[np.ndarray],
    unblocked: Sequence[np.ndarray],
    slope: np.ndarray,
) -> list[np.ndarray]:
    """Return unbiased pictures of both halves of less noise: shown − β · (unblocked − direct).

    What is subtracted is noise, for direct light has none. β is its regression on the noise that is
    seen, by the halves' differences in the pixels around each one: near 1 where light arrives and
    0 where it is blocked. A pixel's own noise is left out, so that the mean stays as it is.

    direct     (height, width, 3) by the closed form
    shown      both halves by all light paths of the tier
    unblocked  both halves of direct light without shadows, of the same samples
    slope      (height, width, 3) of the display curve, 0 outside the mask
    """
    noise, explained = (slope * (pair[0] - pair[1]) for pair in (shown, unblocked))
    common, own = (
        _sums_around((each * explained).sum(-1, dtype=np.float64), AROUND)
        for each in (noise, explained)
    )
    beta = np.clip(common / np.maximum(own, 1e-12), 0, 1)[..., None].astype(np.float32)
    return [s - beta * (u - direct) for s, u in zip(shown, unblocked, strict=True)]


def _sums_around(values: np.ndarray, pixels: int) -> np.ndarray:
    """Return sums of values (height, width) up to so many pixels away, without each one's own."""
    from scipy.ndimage import uniform_filter

    side = 2 * pixels + 1
    return uniform_filter(values, side, mode="constant") * side**2 - values


def share_of_noise_left(
    shown: Sequence[np.ndarray], unblocked: Sequence[np.ndarray], slope: np.ndarray
) -> float:
    """Return the share of path tracing's noise that `reduce_noise` leaves; arguments as there."""
    mean = (unblocked[0] + unblocked[1]) / np.float32(2)
    a, b = reduce_noise(mean, shown, unblocked, slope)
    left, whole = (
        float(((slope * (one - other)) ** 2).sum(dtype=np.float64))
        for one, other in ((a, b), shown)
    )
    return left / max(whole, 1e-12)


def expected_scale(pixels: int) -> float:
    """Return the law's scale for a frame of so many pixels before any try has measured it."""
    return SCALE * denoised.size_factor(pixels)


def measure_scale(blend: Blend, noise: float) -> float:
    """Return the law's scale by a try; noise: the error of its unbiased pictures' mean."""
    # a bias that is not seen may be as large as its uncertainty
    return max(blend.bias_alone, blend.estimate.standard_error) / max(noise, 1e-9) ** POWER


def predict_error(noise: float, scale: float, limit: float) -> float:
    """Return the error of the best blend whose bias a limit allows, or of the best of all."""
    known = _blends(noise, scale)
    allowed = [error for error, bias in known if bias <= blends.MOST_BIAS * limit]
    return min(allowed or [error for error, _ in known])


def needed_samples(
    noise: float,
    samples: int,
    scale: float,
    limit: float,
    direct: Callable[[int], Estimate],
    least: int = LEAST,
) -> int:
    """Return the samples of each half whose blend keeps a limit on error and bias, by the law.

    noise   error of the mean of unbiased pictures of `samples` of each half
    direct  the closed form's error in direct light as so many samples of each half will show it
    least   samples that are worth a try
    """
    count = least
    while count <= MOST_SAMPLES:
        known = direct(count)
        for error, bias in _blends(noise * samples / count, scale):
            uncertain = math.hypot(UNCERTAINTY * error, known.standard_error)
            bound = known.error + error + CONFIDENCE * uncertain
            if bound <= limit and known.error + bias <= blends.MOST_BIAS * limit:
                return count
        count = math.ceil(1.1 * count)
    return count


def _blends(noise: float, scale: float) -> list[tuple[float, float]]:
    """Return error and squared bias of each blend, by the law."""
    return blends.predict_blends(scale * noise**POWER, noise, WITH_NOISE, DETAIL, SHARES)
