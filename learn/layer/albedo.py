"""Albedo of a material along the normal; lower than learn.metrics, because data is drawn by it."""

import numpy as np
import torch

from shaders.dsbrdf import SHAPE
from shaders.spline import basis

KAPPA_CEILING = 12.0  # of κ c^γ, so that expm1 of a wild prediction stays finite
_NODES = 48


def log_albedo(label: torch.Tensor) -> torch.Tensor:
    """Return log ∫ f cos dw (…, 3) of a surface that is seen along its normal.

    label  (…, 108) natural logarithms
    """
    return torch.log(lobe_albedos(label).sum(-1) + 1e-3)


def lobe_albedos(label: torch.Tensor) -> torch.Tensor:
    """Return ∫ f cos dw (…, 3, 3) of each channel and lobe, seen along the normal.

    Half and difference angle are then both half of the light's angle: θ_h = θ_d = θ_i/2.

    label  (…, 108) natural logarithms
    """
    kappa_gamma = label.reshape(*label.shape[:-1], *SHAPE).exp()
    t = (np.arange(_NODES) + 0.5) / _NODES
    half = t**2 * np.pi / 4  # θ_i/2, dense about the highlight
    weight = 2 * np.pi * np.sin(2 * half) * np.cos(2 * half) * 2 * (2 * t * np.pi / 4) / _NODES
    B = torch.as_tensor(np.asarray(basis(half)), dtype=label.dtype).to(label.device)
    values = torch.einsum("tj,...nskj->...nskt", B, kappa_gamma)
    log_cos = torch.as_tensor(np.log(np.cos(half)), dtype=label.dtype).to(label.device)
    lobes = torch.expm1(
        (values[..., 0, :] * torch.exp(values[..., 1, :] * log_cos)).clamp(max=KAPPA_CEILING)
    )
    weight = torch.as_tensor(weight, dtype=label.dtype).to(label.device)
    return (lobes * weight).sum(-1)
