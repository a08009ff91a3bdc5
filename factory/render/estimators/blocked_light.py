"""What blocked light makes of the closed form, which knows no shadows.

blocked  the error that direct light without shadows has, measured by pictures whose noise is
         common, and so with much more certainty than that of a blend; None where it is not known
"""

from __future__ import annotations

from dataclasses import replace

from factory.render.estimators import blends
from factory.render.estimators.halves import CONFIDENCE, Estimate


def raise_error(blend: blends.Blend, blocked: Estimate | None) -> blends.Blend:
    """Return a blend of the closed form whose error is at least what blocked light makes it."""
    if blocked is None:
        return blend
    known = (1 - blend.share) ** 2 * max(blocked.error, 0.0)
    estimate = replace(blend.estimate, error=max(blend.estimate.error, known))
    return blend._replace(estimate=estimate, bias=max(blend.bias, known))


def is_too_much(blocked: Estimate | None, error: float) -> bool:
    """Whether so much light is blocked that no blend of the closed form keeps the limit `error`."""
    if blocked is None:
        return False
    # as a blend of the largest share it would have this share of its error
    least_share = (1 - max(blends.SHARES)) ** 2
    certain = blocked.error - CONFIDENCE * blocked.standard_error
    return least_share * certain > blends.MOST_BIAS * error
