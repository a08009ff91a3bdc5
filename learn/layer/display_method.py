"""Chooses the method by which a material is displayed.

It is the sum over texels, or the integral if a visible lobe is narrower than a texel.
"""

import math

import torch

from learn.methods.quadrature import BROAD
from shaders.dsbrdf import MAX_EXPONENT, SHAPE, lobe_sharpness

FAINT = 2e-3  # albedo below which a lobe is not visible


def method_for(label: torch.Tensor) -> str:
    """Return the method's name for labels (..., 108): "quadrature" or "auto"."""
    kappa, gamma = label.exp().reshape(*label.shape[:-1], *SHAPE).unbind(-2)
    kappa = kappa.clamp(max=MAX_EXPONENT)
    sharpness = lobe_sharpness(kappa, gamma)
    # of cos^g about the normal's mirror direction, seen from above
    albedo = kappa.expm1() * 8 * math.pi / (sharpness + 2)
    narrow = (sharpness > BROAD) & (albedo > FAINT)
    return "quadrature" if bool(narrow.any()) else "auto"
