"""Direct light by the closed form of the material, without shadows, interreflection or noise.

what      shaders.direct_light at the normals inside each pixel
bias      all light that the object blocks or reflects onto itself: none in the tier `direct`, and
          in the others none where a shape cannot shade itself, as seen from this side
checked   against the samples of both halves, in every tier: the estimate contains the bias. Where
          it is above a third of the limit a share of the samples is blended in (`blends`)
cost      none but its own, for the samples of the pilot are there already
fails     few: wide lobes on coarse facets, and mirror-like materials under small lamps
"""

import math

from factory.render.estimators.halves import CONFIDENCE, Estimate
from manifests.schema import Estimator

NAME: Estimator = "closed-form"
# mean error against Cycles in the direct tier: between those of own shapes and of other meshes
# (docs/rendering.md)
TYPICAL = 2.0
# samples of each half that take as long: FIXED for the pixels, MAPS / pixels for the map of
# normals, and SAMPLED for each direction that is sampled per pixel
FIXED, MAPS, SAMPLED = 4.0, 80_000.0, 0.015


def cost(pixels: int, directions: int) -> float:
    """Return the samples of each half that take as long as the closed form of a picture."""
    return FIXED + MAPS / max(pixels, 1) + SAMPLED * directions


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
