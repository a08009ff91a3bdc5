"""Direct light without noise, times the denoised ratio of what is blocked or reflected on.

what      closed form · denoised picture / denoised picture without shadows and interreflection. Of
          each half both pictures have the same seed, so that most of their noise is common and
          their ratio has little (Heitz, Hill and McGuire 2018, "Combining analytic direct
          illumination and stochastic shadows")
bias      of the denoiser, where it treats the two pictures differently: the estimate contains it,
          and a share of `unbiased` beside it keeps it below a third of the limit (`blends`).
          That of the closed form is added: it is measured by the samples without shadows
cost      every sample twice, both denoisings, and the closed form
fails     interreflection in strong highlights, which unoccluded light does not show. The ratio is
          cut off at MOST; where there is no light to divide by, the denoised picture stands
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from factory.render.estimators import denoised
from factory.render.estimators.closed_form import weighed
from factory.render.estimators.halves import CONFIDENCE, Estimate
from manifests.schema import Estimator

NAME: Estimator = "ratio"
MOST = 3.0  # of the ratio: light that is reflected on raises it above 1
DARK = 1e-6  # radiance by which nothing is divided
# error: SCALE · (error of the closed form as the picture) / (samples of each half)^POWER, and what
# a denoiser leaves by the size of the frame. Where little light is blocked or reflected on, little
# of it can be noisy
SCALE, POWER = 0.25, 0.75
UNCERTAINTY = 0.25  # of the estimate, in units of itself
LEAST = 2  # samples of each half
MOST_SAMPLES = 1 << 20  # more never help
MOST_TRIES = 4
AROUND = 4  # pixels to each side by whose noise β is known
# of the unbiased pictures: alone they have a third of path tracing's noise on many shots
SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0)
FOR_BIAS = 1.5  # times the samples of a try whose error was small enough, but not its bias


def combined(direct: np.ndarray, shown: np.ndarray, unblocked: np.ndarray) -> np.ndarray:
    """Return the picture (height, width, 3).

    direct     (height, width, 3) by the closed form
    shown      by all light paths of the tier, denoised
    unblocked  by direct light without shadows, of the same samples, denoised
    """
    share = np.clip(shown / np.maximum(unblocked, np.float32(DARK)), 0, MOST)
    return np.where(unblocked > DARK, direct * share, shown).astype(np.float32)


def unbiased(
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
    seen, taken = (slope * (pair[0] - pair[1]) for pair in (shown, unblocked))
    common, own = (
        _around((each * taken).sum(-1, dtype=np.float64), AROUND) for each in (seen, taken)
    )
    beta = np.clip(common / np.maximum(own, 1e-12), 0, 1)[..., None].astype(np.float32)
    return [s - beta * (u - direct) for s, u in zip(shown, unblocked, strict=True)]


def _around(values: np.ndarray, reach: int) -> np.ndarray:
    """Return sums of values (height, width) up to so many pixels away, without each one's own."""
    from scipy.ndimage import uniform_filter

    side = 2 * reach + 1
    return uniform_filter(values, side, mode="constant") * side**2 - values


def predicted(closed: Estimate, samples: int, pixels: int) -> float:
    """Return the error with `samples` of each half, by that of the closed form as the picture.

    pixels  of the frame
    """
    return float(SCALE * denoised.left(pixels) * max(closed.error, 0.0) / samples**POWER)


def needed(
    closed: Estimate, now: Estimate, samples: int, error: float, pixels: int, expected: Estimate
) -> int:
    """Return the samples of each half whose estimate is at most an error with 95 % confidence.

    closed    error of the closed form as the picture
    now       error of the picture of `samples` of each half: its uncertainty is taken for that of
              direct light's, of which a half alone has twice as much
    pixels    of the frame
    expected  error of the closed form in direct light
    """
    at_one, noise = predicted(closed, 1, pixels), 2 * now.standard_error * samples

    def bound(count: int) -> float:
        mine = at_one / count**POWER
        direct = weighed(Estimate(expected.error, noise / count), expected)
        uncertain = math.hypot(UNCERTAINTY * mine, direct.standard_error)
        return direct.error + mine + CONFIDENCE * uncertain

    return _least(LEAST, bound, error)


def needed_after(
    tried: Estimate,
    direct: Estimate,
    expected: Estimate,
    samples: int,
    error: float,
    more: float = 1.0,
) -> int:
    """Return the same number, by the estimate of `samples` of each half that failed.

    direct    the closed form's error in direct light, which is a part of it
    expected  the same before samples measured it: what they do not say
    more      times the samples of that try, at least
    """
    at_one = max(tried.error - direct.error, 0.0) * samples**POWER
    mine = math.sqrt(max(tried.standard_error**2 - direct.standard_error**2, 0.0)) * samples
    known = 1 / max(expected.standard_error, 1e-9) ** 2  # a precision, as what follows
    seen = max(1 / max(direct.standard_error, 1e-9) ** 2 - known, 0.0) / samples**2

    def bound(count: int) -> float:
        uncertain = math.sqrt((mine / count) ** 2 + 1 / (known + seen * count**2))
        return direct.error + at_one / count**POWER + CONFIDENCE * uncertain

    return _least(max(samples + 1, math.ceil(more * samples)), bound, error)


def _least(samples: int, bound: Callable[[int], float], error: float) -> int:
    """Return the least samples, from `samples` in steps of a tenth, whose bound is the error."""
    while samples <= MOST_SAMPLES and bound(samples) > error:
        samples = math.ceil(1.1 * samples)
    return samples
