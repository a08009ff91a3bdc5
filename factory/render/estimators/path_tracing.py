"""Path tracing with the number of samples that the shot needs.

what      both halves grow until the error that their difference shows is at most the limit
bias      of the picture none; its display values are those of a noisy mean, which the tone curve
          darkens. The estimate has a part for that (`Halves.estimate`)
cost      the samples
fails     light that few paths find: if neither half has met it, their difference does not show it
"""

import math

from factory.render.estimators.halves import Estimate
from manifests.schema import Estimator

NAME: Estimator = "path-tracing"
AIM = 1.03  # times the samples that the model asks for, so that a second step is rare


def predict_error(pilot: Estimate, pilot_samples: int, samples: int) -> float:
    """Return the error at `samples` of each half.

    Noise is in proportion to 1/samples, and the display curve's part to its square.
    """
    share = pilot_samples / samples
    return pilot.noise * share + pilot.curve * share**2


def needed_samples(now: Estimate, samples: int, error: float) -> int:
    """Return the samples of each half that keep an error, by the estimate at `samples`."""
    # noise_bound / growth + curve / growth² = error
    root = math.sqrt(now.noise_bound**2 + 4 * error * now.curve)
    growth = (now.noise_bound + root) / (2 * error)
    return max(samples + 1, math.ceil(AIM * samples * growth))
