"""What rendering to a limit on the error returns: a picture, and how it was made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factory.render.estimators.halves import Estimate
from manifests.schema import Estimator, Tier


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, how it was made, and how good it is.

    radiance   (height, width, 3) float32
    alpha      (height, width) the object's coverage
    estimator  its name
    samples    per pixel that were rendered, of both halves
    predicted  error by the estimator's model from the pilot
    estimated  error of the finished picture, with its standard error
    traced     tier whose light paths were traced: `direct` where the object cannot shade itself
    """

    radiance: np.ndarray
    alpha: np.ndarray
    estimator: Estimator
    samples: int
    predicted: float
    estimated: Estimate
    traced: Tier
