"""Direct light by the closed form of the material, without shadows, interreflection or noise.

what      shaders.direct_light at the normals inside each pixel
bias      all light that the object blocks or reflects onto itself: none in the tier `direct`, and
          in the others none where a shape cannot shade itself, as seen from this side
checked   against the samples of both halves, in every tier: the estimate contains the bias. Where
          it is above a third of the limit a share of the samples is blended in (`blends`). In the
          tier `direct` what is expected by the differences of its points counts too (`weighed`)
cost      none but its own, for the samples of the pilot are there already
fails     few: edges and mirror-like materials that the points miss, and materials whose lobes at
          grazing angles are not quite Cycles'
"""

import math
from collections.abc import Sequence

import numpy as np

from factory.render.estimators.halves import (
    CONFIDENCE,
    DirectPicture,
    DirectWork,
    Estimate,
    mean_over,
)
from manifests.schema import Estimator
from shaders import tone

NAME: Estimator = "closed-form"
# points per pixel, by the least limit for which they do on many shots
POINTS = ((4.0, 16), (0.0, 32))
MOST_POINTS = 1 << 21  # of the object, beyond which a pixel has no more than those
ENOUGH = 0.3  # of the limit: doubt about the points' own part of the error that needs no more
# the error that is expected: LEFT times the points' `differences`, since their grids lie between
# each other, and OTHER. Measured on own shapes and other meshes (docs/log.md)
LEFT, OTHER = 0.2, 0.1
# how much it differs between shots, in the same units
LEFT_SPREAD, OTHER_SPREAD = 0.25, 0.2
# standard errors by which a measurement must be above what is expected to count alone: one of few
# samples is above it by two now and then
SURPRISING = 3.0
USUAL = 2.5  # differences of many shots, before any is computed
# samples of each half that take as long: FIXED, for each point of a pixel, for each direction that
# is sampled per pixel, and MAPS times the maps' size / pixels, if two views share them
FIXED, EACH_POINT, SAMPLED, MAPS = 3.0, 0.18, 0.003, 120.0


def points(error: float) -> int:
    """Return the points per pixel whose own error is small beside a limit on many shots."""
    return next(count for limit, count in POINTS if error >= limit)


def more_points(direct: DirectPicture, mask: np.ndarray, points: int, error: float) -> int | None:
    """Return the points per pixel whose own error is small beside a limit, or None: `points` are.

    direct  by `points` per pixel. Their part of its error falls in proportion to their number
    """
    own = differences(direct, mask)
    needed = points * (LEFT + CONFIDENCE * LEFT_SPREAD) * own / (ENOUGH * error)
    most = MOST_POINTS / max(int(mask.sum()), 1)
    count = points
    while count < needed and 2 * count <= most:
        count *= 2
    return count if count > points else None


def cost(pixels: int, work: DirectWork) -> float:
    """Return the samples of each half that take as long as the closed form of so many pixels."""
    maps = MAPS * work.maps / max(pixels, 1)
    return FIXED + EACH_POINT * work.points + SAMPLED * work.directions + maps


def differences(direct: DirectPicture, mask: np.ndarray) -> float:
    """Return the display error that a picture would have if its grids were placed at random."""
    exposure = tone.auto_exposure(direct.radiance, mask)
    slope = tone.display_slope(direct.radiance[mask], exposure)
    return float((direct.variance[mask] * slope**2).mean(dtype=np.float64))


def expected(direct: DirectPicture, mask: np.ndarray) -> Estimate:
    """Return the closed form's error in the tier `direct` before samples measure it."""
    return _expected(differences(direct, mask))


def hoped(error: float) -> Estimate:
    """Return the same before direct light is computed by as many points as a limit needs."""
    return _expected(min(USUAL, ENOUGH * error / (LEFT + CONFIDENCE * LEFT_SPREAD)))


def _expected(own: float) -> Estimate:
    return Estimate(LEFT * own + OTHER, LEFT_SPREAD * own + OTHER_SPREAD)


def measured(direct: np.ndarray, unblocked: Sequence[np.ndarray], mask: np.ndarray) -> Estimate:
    """Return the closed form's error by two independent pictures of the tier `direct`.

    Differences are taken of radiance and scaled by the display curve's slope (tone.display_slope).

    direct     (height, width, 3) by the closed form
    unblocked  two such pictures of equally many samples
    """
    exposure = tone.auto_exposure(direct, mask)
    exact = direct[mask]
    slope = tone.display_slope(exact, exposure)
    one, other = ((each[mask] - exact) * slope for each in unblocked)
    return mean_over((one * other).mean(-1))


def weighed(measured: Estimate, expected: Estimate) -> Estimate:
    """Return the closed form's error in the tier `direct` by a measurement and by what is expected.

    Both count as their certainty: few samples say less than the points' differences. What is
    beyond doubt not as expected counts as it was measured.
    """
    if measured.error - SURPRISING * measured.standard_error > expected.bound:
        return measured
    spread = expected.standard_error
    weight = spread**2 / (spread**2 + measured.standard_error**2)
    error = expected.error + weight * (measured.error - expected.error)
    return Estimate(max(error, 0.0), math.sqrt(weight) * measured.standard_error)


def is_out(estimate: Estimate, error: float) -> bool:
    """Whether an estimate is above the limit beyond doubt, whatever more samples would say."""
    return estimate.error - CONFIDENCE * estimate.standard_error > error


def needed(estimate: Estimate, samples: int, error: float) -> int | None:
    """Return the samples of each half that show whether the error is kept, or None if it is not.

    estimate  by `samples` of each half; its uncertainty falls in proportion to 1/samples
    """
    if is_out(estimate, error):
        return None
    if estimate.bound <= error:  # its bias may be too large: a look that is twice as close
        return 2 * samples
    left = error - max(estimate.error, 0.0)
    if left <= 0:  # above the limit, but not beyond doubt: a closer look decides
        left = error / 4
    return max(samples + 1, math.ceil(samples * CONFIDENCE * estimate.standard_error / left))
