"""Which of the layer's methods a material is shown by: the sum over texels, or where a lobe is narrower than they are, the integral."""

import math

from learn.methods.quadrature import BROAD
from shaders.dsbrdf import SHAPE

FAINT = 1e-4  # of expm1(κ): a lobe below it is not seen


def method_for(label):
    """The method's name for labels (..., 108), a tensor."""
    kappa, log_gamma = label.reshape(*label.shape[:-1], *SHAPE).unbind(-2)
    narrow = (log_gamma.amax(-1) > math.log(BROAD)) & (kappa.exp().amax(-1) > FAINT)
    return "quadrature" if bool(narrow.any()) else "auto"
