"""Which of the layer's methods a material is shown by: the sum over texels, or where a lobe is
narrower than they are, the integral.
"""

import math

import torch

from learn.methods.quadrature import BROAD
from shaders.dsbrdf import SHAPE

FAINT = 2e-3  # of a lobe's albedo: one below it is not seen


def method_for(label: torch.Tensor) -> str:
    """The method's name for labels (..., 108), a tensor."""
    kappa, log_gamma = label.reshape(*label.shape[:-1], *SHAPE).unbind(-2)
    # of cos^γ about the normal's mirror direction, seen from above
    albedo = kappa.exp().expm1() * 8 * math.pi / (log_gamma.exp() + 2)
    narrow = (log_gamma > math.log(BROAD)) & (albedo > FAINT)
    return "quadrature" if bool(narrow.any()) else "auto"
