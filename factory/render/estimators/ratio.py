"""Direct light without noise, times the denoised ratio of what is blocked or reflected on.

what      closed form · denoised picture / denoised picture without shadows and interreflection. Of
          each half both pictures have the same seed, so that most of their noise is common and
          their ratio has little (Heitz, Hill and McGuire 2018, "Combining analytic direct
          illumination and stochastic shadows")
bias      of the denoiser, where it treats the two pictures differently: the estimate contains it,
          and a share of `unbiased` beside it keeps it below a third of the limit (`blends`).
          That of the closed form is added to the estimate as it is on average
cost      every sample twice, both denoisings, and the closed form
fails     interreflection in strong highlights, which unoccluded light does not show. The ratio is
          cut off at MOST; where there is no light to divide by, the denoised picture stands
"""

import math

import numpy as np

from factory.render.estimators.closed_form import TYPICAL
from factory.render.estimators.halves import CONFIDENCE, Estimate, Portion
from manifests.schema import Estimator

NAME: Estimator = "ratio"
MOST = 3.0  # of the ratio: light that is reflected on raises it above 1
DARK = 1e-6  # radiance by which nothing is divided
# error: SCALE · (error of the same samples without denoiser)^POWER
SCALE, POWER = 0.5, 0.4
# uncertainty of the estimate, in units of that of the pilot's with the same samples
UNCERTAINTY = 0.3
LEAST = 2  # samples of each half
MOST_SAMPLES = 1 << 20  # more never help
MOST_TRIES = 3


def combined(direct: np.ndarray, shown: Portion, unblocked: Portion) -> np.ndarray:
    """Return the picture (height, width, 3).

    direct     (height, width, 3) by the closed form
    shown      by all light paths of the tier
    unblocked  by direct light without shadows, of the same samples
    """
    assert shown.denoised is not None and unblocked.denoised is not None
    share = np.clip(shown.denoised / np.maximum(unblocked.denoised, np.float32(DARK)), 0, MOST)
    lit = unblocked.denoised > DARK
    return np.where(lit, direct * share, shown.denoised).astype(np.float32)


def unbiased(direct: np.ndarray, shown: Portion, unblocked: Portion) -> np.ndarray:
    """Return an unbiased picture of less noise: what both have in common is taken out.

    It is with what a picture of the other half is compared; arguments as of `combined`.
    """
    return direct + (shown.noisy - unblocked.noisy)


def predicted(pilot: Estimate, pilot_samples: int, samples: int) -> float:
    """Return the error with `samples` of each half, by the noise of a pilot."""
    return float(SCALE * (max(pilot.error, 0.0) * pilot_samples / samples) ** POWER)


def needed(pilot: Estimate, pilot_samples: int, error: float) -> int:
    """Return the samples of each half whose estimate is at most an error with 95 % confidence."""
    uncertainty = UNCERTAINTY * pilot.standard_error * pilot_samples
    return _least(LEAST, predicted(pilot, pilot_samples, 1), uncertainty, error)


def needed_after(tried: Estimate, samples: int, error: float) -> int:
    """Return the same number, by the estimate of `samples` of each half that failed."""
    at_one = max(tried.error - TYPICAL, 0.0) * samples**POWER
    return _least(samples + 1, at_one, tried.standard_error * samples, error)


def _least(samples: int, at_one: float, uncertainty: float, error: float) -> int:
    """Return the least samples, from `samples` in steps of a tenth, that keep an error.

    at_one       error of one sample of each half, without that of the closed form
    uncertainty  of the estimate, of one sample
    """
    while samples <= MOST_SAMPLES:
        bound = TYPICAL + at_one / samples**POWER + CONFIDENCE * uncertainty / samples
        if bound <= error:
            break
        samples = math.ceil(1.1 * samples)
    return samples
