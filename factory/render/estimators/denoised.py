"""Path tracing and Open Image Denoise, with albedo and normal as guides.

what      each half is denoised by itself, and the picture is the mean of both, with a share of the
          noisy one (`blends`)
bias      detail that noise hides is smoothed; the estimate includes it, because each denoised half
          is compared with the other half's noisy pixels. It is at most a third of the limit
cost      the samples, and a fixed time per half, here as the samples that take as long
law       squared bias = scale · noise^POWER · what the effort leaves, where noise is the error of
          the same samples without denoiser. The scale is SCALE · (STANDARD / pixels of the
          frame)^SIZE until the first try has measured it, since more pixels show the same detail
fails     sharp reflections, whose detail no guide shows: there it saves no samples
"""

import math
from collections.abc import Sequence

from factory.render.estimators import blends
from factory.render.estimators.blends import Blend
from factory.render.estimators.lost_detail import Effect
from factory.render.estimators.renderer import STANDARD, effort
from manifests.schema import Estimator, Tier

NAME: Estimator = "denoised"
SCALE, POWER = 2.8, 0.58
SIZE = 0.47
# medians of 24 shots of 64², before lost_detail.LEAST and MOST; with them it is 0.46 and 0.09
DETAIL = Effect(bias=0.3, noise=0.22)
WITH_NOISE = 1.45  # error of denoised halves' mean, over its bias: the rest is their own noise
CAUTION = 1.4  # times the samples that the law asks for after a try that failed
MOST_SAMPLES = 1 << 20  # more never help
LEAST = 4  # samples of each half that are worth denoising
MOST_TRIES = 4
# samples that take as long as denoising one half once, in high quality
COST = {"direct": 4.5, "shadow": 5.0, "full": 4.0}


def cost_in_samples(samples: int, tier: Tier) -> float:
    """Return the samples that take as long as denoising a half of so many samples."""
    return COST[tier] * effort(samples).cost


def size_factor(pixels: int) -> float:
    """Return the error that a denoiser leaves in a frame of so many pixels.

    It is in units of what it leaves in one of STANDARD pixels.
    """
    return float((STANDARD / pixels) ** SIZE)


def expected_scale(pixels: int) -> float:
    """Return the law's scale for a frame of so many pixels before any try has measured it."""
    return SCALE * size_factor(pixels)


def measure_scale(blend: Blend, noise: float, samples: int, power: float = POWER) -> float:
    """Return the law's scale as denoised halves show it, whose blend is given.

    noise    error of the same samples without denoiser
    samples  of each half
    power    of the law
    """
    # a bias that is not seen may be as large as its uncertainty
    seen = max(blend.bias_alone, blend.estimate.standard_error)
    return seen / (max(noise, 1e-9) ** power * effort(samples).leaves)


def predict_error(
    noise: float,
    scale: float,
    samples: int,
    limit: float,
    power: float = POWER,
    shares: Sequence[float] = blends.SHARES,
    detail: Effect = DETAIL,
) -> float:
    """Return the error of the best blend whose bias a limit allows, or of the best of all.

    noise    error of the same samples without denoiser
    samples  of each half
    power    of the law
    shares   of the noisy picture that are tried
    detail   what putting it back does
    """
    known = blends_of(noise, scale, samples, power, shares, detail)
    allowed = [error for error, bias in known if bias <= blends.MOST_BIAS * limit]
    return min(allowed or [error for error, _ in known])


def needed_samples(
    noise: float, samples: int, scale: float, limit: float, least: int = LEAST
) -> int:
    """Return the samples of each half whose blend keeps a limit on error and bias, by the law.

    noise  error of `samples` of each half without denoiser
    least  samples that are worth a try
    """
    count = least
    while count <= MOST_SAMPLES and not any(
        error <= limit and bias <= blends.MOST_BIAS * limit
        for error, bias in blends_of(noise * samples / count, scale, count)
    ):
        count = math.ceil(1.1 * count)
    return count


def blends_of(
    noise: float,
    scale: float,
    samples: int,
    power: float = POWER,
    shares: Sequence[float] = blends.SHARES,
    detail: Effect = DETAIL,
) -> list[tuple[float, float]]:
    """Return error and squared bias of each blend of so many samples of each half, by the law."""
    bias = scale * noise**power * effort(samples).leaves
    return blends.predict_blends(bias, noise, WITH_NOISE, detail, shares)
