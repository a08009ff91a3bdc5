"""Path tracing and Open Image Denoise, with albedo and normal as guides.

what      each half is denoised by itself, and the picture is the mean of both, with a share of the
          noisy one (`blends`)
bias      detail that noise hides is smoothed; the estimate includes it, because each denoised half
          is compared with the other half's noisy pixels. It is at most a third of the limit
cost      the samples, and a fixed time per half, here as the samples that take as long
fails     sharp reflections, whose detail no guide shows: there it saves no samples
"""

import math

from factory.render.estimators.halves import Estimate
from manifests.schema import Estimator

NAME: Estimator = "denoised"
# error of the picture: SCALE · (error of the same samples without denoiser)^POWER,
# measured by factory.render.validation.error_target
SCALE, POWER = 1.2, 0.69
LEAST = 4  # samples of each half that are worth denoising
MOST_TRIES = 3
# samples that take as long as denoising one half
COST = {"direct": 10, "shadow": 8, "full": 5}


def predicted(pilot: Estimate, pilot_samples: int, samples: int) -> float:
    """Return the error of two denoised halves of `samples` each, by the noise of a pilot."""
    return float(SCALE * (pilot.noise * pilot_samples / samples) ** POWER)


def needed(pilot: Estimate, pilot_samples: int, error: float) -> int:
    """Return the samples of each half whose denoised mean keeps an error, by the law above."""
    noise = (error / SCALE) ** (1 / POWER)
    return max(LEAST, math.ceil(pilot_samples * pilot.noise_bound / noise))


def needed_after(tried: Estimate, samples: int, error: float) -> int:
    """Return the same number, by the estimate of denoised halves of `samples` that failed."""
    return max(samples + 1, math.ceil(1.1 * samples * (tried.bound / error) ** (1 / POWER)))
