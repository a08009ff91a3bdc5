"""Smoothed pictures blended with unbiased ones, whose noise is less of a fault than their bias.

What a denoiser leaves of the error is bias for the most part: the same on every picture of a shot,
whatever its seed. A share of the noisy picture beside it takes bias away with the square of the
rest's share, and adds noise with the square of its own. All of it is known from the two halves: the
error of a blend from its comparison with the other half, and the spread of both blends, which is
noise, taken from it is the bias.

A smoothed picture is tried with lost detail put back as well, which has less bias and more noise
(factory.render.estimators.lost_detail).

pair   pictures of both halves, (height, width, 3) each
bias   squared, in display values as errors are, mean over the mask
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from factory.render.estimators import lost_detail
from factory.render.estimators.halves import CONFIDENCE, Estimate, Halves
from factory.render.estimators.renderer import NORMAL

SHARES = (0.0, 0.15, 0.3, 0.45, 0.6)  # of the unbiased pictures
UP_TO_ALL = (*SHARES, 0.8, 1.0)
MOST_BIAS = 1 / 3  # of the limit on the error
# standard errors added to an estimated bias, because what is chosen for its estimate is worse
DOUBT = 0.5


class Blend(NamedTuple):
    """Blends of both halves, the estimated error of their mean, and its squared bias.

    bias_alone  that of the smooth pictures without a share of the noisy ones or detail put back
    share       of the noisy ones
    has_detail  whether lost detail was put back
    """

    pair: list[np.ndarray]
    estimate: Estimate
    bias: float
    bias_alone: float
    share: float
    has_detail: bool = False


def bias_with_doubt(bias: float, estimate: Estimate) -> float:
    """Return the squared bias of a picture that was chosen by its estimate."""
    return bias + DOUBT * estimate.standard_error


def is_kept(estimate: Estimate, bias: float, error: float) -> bool:
    """Whether a picture has an error and a squared bias that the limit `error` allows."""
    return estimate.bound <= error and bias <= MOST_BIAS * error


def add_bias(estimate: Estimate, bias: float) -> Estimate:
    """Return an estimate by which further samples are planned.

    Its error is above the limit also where the squared bias is above its share beyond doubt.
    """
    least = bias - CONFIDENCE * estimate.standard_error
    return Estimate(max(estimate.error, least / MOST_BIAS), estimate.standard_error)


def predict_blends(
    bias: float,
    noise: float,
    with_noise: float,
    detail: lost_detail.Effect,
    shares: Sequence[float],
) -> list[tuple[float, float]]:
    """Return what error and squared bias are expected of each blend.

    bias        squared, of the smooth pictures alone
    noise       the error of the unbiased pictures' mean
    with_noise  error of the smooth pictures' mean, over its squared bias
    detail      what putting it back does
    """
    result = []
    for share in shares:
        rest = (1 - share) ** 2
        own = rest * bias * (with_noise - 1)  # noise that the smooth pictures have
        result.append((rest * bias + own + share**2 * noise, rest * bias))
        # an average of noise that is blended with the noise itself
        added = (rest + 2 * share * (1 - share)) * detail.noise + share**2
        left = rest * bias * detail.bias
        result.append((left + own + added * noise, left))
    return result


def choose_blend(
    halves: Halves,
    smooth: Sequence[np.ndarray],
    unbiased: Sequence[np.ndarray],
    error: float,
    shares: Sequence[float] = SHARES,
    exposure: float | None = None,
    known_bias: float = 0.0,
    with_detail: bool = False,
) -> Blend:
    """Return the blend of least error among those whose bias is small enough, or among all.

    smooth    pictures of both halves by a denoiser, or computed from them
    unbiased  pictures of both halves, with their noise; they may have negative radiance
    error     the limit
    shares    of the unbiased pictures that are tried; the first is 0
    exposure  under which errors count; None: as the halves say it
    known_bias  squared, which every blend has besides
    with_detail  whether the smooth pictures are tried with lost detail put back, too
    """
    blends = list(make_blends(halves, smooth, unbiased, shares, exposure, with_detail))
    most = MOST_BIAS * error - known_bias
    allowed = [each for each in blends if bias_with_doubt(each.bias, each.estimate) <= most]
    return min(allowed or blends, key=lambda each: each.estimate.bound)


def make_blends(
    halves: Halves,
    smooth: Sequence[np.ndarray],
    unbiased: Sequence[np.ndarray],
    shares: Sequence[float],
    exposure: float | None = None,
    with_detail: bool = False,
) -> Iterator[Blend]:
    """Yield the blend of each share, and then with lost detail; arguments as of `choose_blend`."""
    slope, alone = halves.slope(smooth, exposure), None
    for has_detail in (False, True) if with_detail else (False,):
        base = _put_back_detail(halves, smooth, unbiased, slope) if has_detail else smooth
        for share in shares:
            some = np.float32(share)
            pair = [
                np.maximum(s + some * (u - s), np.float32(0)) if share or has_detail else s
                for s, u in zip(base, unbiased, strict=True)
            ]
            estimate, bias = halves.error_and_bias(pair, unbiased, slope)
            alone = bias if alone is None else alone
            yield Blend(pair, estimate, bias, alone, share, has_detail)


def _put_back_detail(
    halves: Halves,
    smooth: Sequence[np.ndarray],
    unbiased: Sequence[np.ndarray],
    slope: np.ndarray,
) -> list[np.ndarray]:
    """Return smooth pictures with lost detail put back, each by what is known of its own half.

    slope  (P, 3) of the display curve
    """
    mask = halves.shown.mask
    slopes = np.zeros_like(smooth[0])
    slopes[mask] = slope
    return [
        lost_detail.put_back(s, u, mean.guides[..., NORMAL], slopes, mask)
        for s, u, mean in zip(smooth, unbiased, halves.means, strict=True)
    ]
