"""The choice of an estimator for one shot.

A pilot of a few samples of each half says how noisy the shot is. Then the estimator
that needs the fewest further samples by its model is tried, until the error is at most the limit;
the denoiser's time counts as samples. Samples of a try that failed are kept for path tracing, so
that only the denoiser's time is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factory.render.estimators import denoised, path_tracing
from factory.render.estimators.halves import Estimate, Halves, Shown
from manifests.schema import Estimator

VERSION = 1  # of the rules; a change makes new pictures
PILOT = 4  # samples of each half
MOST_SAMPLES = 2048  # of each half


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, how it was made, and how good it is.

    radiance   (height, width, 3) float32
    alpha      (height, width) the object's coverage
    estimator  its name
    samples    per pixel that were rendered, of both halves
    predicted  error by the estimator's model from the pilot
    estimated  error of the finished picture, with its standard error
    """

    radiance: np.ndarray
    alpha: np.ndarray
    estimator: Estimator
    samples: int
    predicted: float
    estimated: Estimate


def identity() -> list[object]:
    """Return everything in these rules that alters pixels, for the fingerprint."""
    return [
        ["choice", VERSION, PILOT, MOST_SAMPLES],
        [path_tracing.NAME, path_tracing.AIM, path_tracing.GROWTH],
        [denoised.NAME, denoised.SCALE, denoised.POWER, denoised.MOST_TRIES, denoised.LEAST],
        sorted(denoised.COST.items()),
    ]


def picture(
    shown: Shown, error: float, estimators: tuple[Estimator, ...] = ("path-tracing", "denoised")
) -> Picture:
    """Return a picture whose estimated error is at most `error` with 95 % confidence.

    The estimate is larger if MOST_SAMPLES do not suffice.

    estimators  that may be chosen; "path-tracing" is always one of them
    """
    halves = Halves(shown)
    halves.grow(PILOT)
    now = pilot = halves.estimate()
    tried: tuple[Estimate, int] | None = None
    tries = 0 if denoised.NAME in estimators else denoised.MOST_TRIES
    while now.bound > error and halves.samples < MOST_SAMPLES:
        target = min(path_tracing.needed(now, halves.samples, error), MOST_SAMPLES)
        smooth = (
            denoised.needed(now, halves.samples, error)
            if tried is None
            else denoised.needed_after(*tried, error)
        )
        cost = smooth + denoised.COST[shown.tier]
        if (
            tries < denoised.MOST_TRIES
            and cost < target - halves.samples
            and smooth <= MOST_SAMPLES - halves.samples
        ):
            tries += 1
            pair = halves.grow(smooth, denoise=True)
            estimate = halves.denoised_estimate(pair)
            if estimate.bound <= error:
                return Picture(
                    radiance=(pair[0] + pair[1]) / 2,
                    alpha=halves.alpha,
                    estimator=denoised.NAME,
                    samples=2 * halves.samples,
                    predicted=denoised.predicted(pilot, PILOT, smooth),
                    estimated=estimate,
                )
            tried = estimate, smooth
        else:
            halves.grow(min(target, path_tracing.GROWTH * halves.samples) - halves.samples)
        now = halves.estimate()
    return Picture(
        radiance=halves.picture,
        alpha=halves.alpha,
        estimator=path_tracing.NAME,
        samples=2 * halves.samples,
        predicted=path_tracing.predicted(pilot, PILOT, halves.samples),
        estimated=now,
    )
