"""Direct light by the closed form of the material, without shadows, interreflection or noise.

what      shaders.direct_light at the normals inside each pixel
bias      all light that the object blocks or reflects onto itself: none in the tier `direct`, and
          in the others none where a shape cannot shade itself, as seen from this side
checked   against the samples of both halves, in every tier: the estimate contains the bias. Where
          it is above a third of the limit a share of the samples is blended in (`blends`). In the
          tier `direct` what is typical of other shots counts too (`weighed`)
cost      none but its own, for the samples of the pilot are there already
fails     few: wide lobes on coarse facets, and mirror-like materials under small lamps
"""

import math
from collections.abc import Sequence

import numpy as np

from factory.render.estimators.halves import CONFIDENCE, Estimate, mean_over
from manifests.schema import Estimator
from shaders import tone

NAME: Estimator = "closed-form"
# mean error against Cycles in the direct tier, between those of own shapes and of other meshes
# (docs/rendering.md), and how much it differs between shots
TYPICAL, SPREAD = 2.0, 3.0
# samples of each half that take as long: FIXED for the pixels, MAPS / pixels for the map of
# normals, and SAMPLED for each direction that is sampled per pixel
FIXED, MAPS, SAMPLED = 2.5, 80_000.0, 0.003


def cost(pixels: int, directions: int) -> float:
    """Return the samples of each half that take as long as the closed form of a picture."""
    return FIXED + MAPS / max(pixels, 1) + SAMPLED * directions


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


def weighed(measured: Estimate) -> Estimate:
    """Return the closed form's error in the tier `direct` by a measurement and by what is typical.

    Both count as their certainty: few samples say less than what is known of other shots. What is
    beyond doubt not typical counts as it was measured.
    """
    least = measured.error - CONFIDENCE * measured.standard_error
    if least > TYPICAL + CONFIDENCE * SPREAD:
        return measured
    weight = SPREAD**2 / (SPREAD**2 + measured.standard_error**2)
    error = TYPICAL + weight * (measured.error - TYPICAL)
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
