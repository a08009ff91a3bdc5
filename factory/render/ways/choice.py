"""The choice of a way for one shot.

A pilot of a few samples of each half says how noisy the shot is. Then, until the error is kept, the
way is taken that needs the fewest further samples by its model, with the denoiser's time counted as
samples. Samples of a try that failed count for `plain`, so that only the denoiser's time is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factory.render.ways import denoised, plain
from factory.render.ways.halves import Estimate, Halves, Shown
from manifests.schema import Way

VERSION = 1  # of the rules; a change makes new pictures
PILOT = 4  # samples of each half
MOST_SAMPLES = 2048  # of each half


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, how it was made, and how good it is.

    radiance   (height, width, 3) float32
    alpha      (height, width) the object's coverage
    way        the name of one
    samples    per pixel that were rendered, of both halves
    predicted  error by the way's model from the pilot
    estimated  error of the finished picture, with its standard error
    """

    radiance: np.ndarray
    alpha: np.ndarray
    way: Way
    samples: int
    predicted: float
    estimated: Estimate


def identity() -> list[object]:
    """Return everything in these rules that alters pixels, for the fingerprint."""
    return [
        ["choice", VERSION, PILOT, MOST_SAMPLES],
        [plain.NAME, plain.AIM, plain.GROWTH],
        [denoised.NAME, denoised.SCALE, denoised.POWER, denoised.MOST_TRIES, denoised.LEAST],
        sorted(denoised.COST.items()),
    ]


def picture(shown: Shown, error: float, ways: tuple[Way, ...] = ("plain", "denoised")) -> Picture:
    """Return a picture whose estimated error is at most `error` with 95 % confidence.

    The estimate is larger if MOST_SAMPLES do not suffice.

    ways  that may be taken; "plain" is always one of them
    """
    halves = Halves(shown)
    halves.grow(PILOT)
    now = pilot = halves.estimate()
    tried: tuple[Estimate, int] | None = None
    tries = 0 if denoised.NAME in ways else denoised.MOST_TRIES
    while now.bound > error and halves.samples < MOST_SAMPLES:
        target = min(plain.needed(now, halves.samples, error), MOST_SAMPLES)
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
                    way=denoised.NAME,
                    samples=2 * halves.samples,
                    predicted=denoised.predicted(pilot, PILOT, smooth),
                    estimated=estimate,
                )
            tried = estimate, smooth
        else:
            halves.grow(min(target, plain.GROWTH * halves.samples) - halves.samples)
        now = halves.estimate()
    return Picture(
        radiance=halves.picture,
        alpha=halves.alpha,
        way=plain.NAME,
        samples=2 * halves.samples,
        predicted=plain.predicted(pilot, PILOT, halves.samples),
        estimated=now,
    )
