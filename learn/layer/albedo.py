"""Albedo of a material that is seen along its normal.

It is here and not in learn.metrics because learn.data, on which metrics depend, draws materials by
it.
"""

import numpy as np
import torch

from shaders.dsbrdf import MAX_EXPONENT, SHAPE, lobe_sharpness
from shaders.spline import basis
from shaders.tone import LUMINANCE

KAPPA_CEILING = 12.0  # of κ c^γ, so that expm1 of a wild prediction stays finite
# sharpness at which half of a lobe counts as narrow; 3 and 30 explain the brightness of edits
# (learn.editing.mirror_correction) as well
HALF_NARROW = 10.0
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


def narrow_share(label: np.ndarray) -> float:
    """Return the share, 0 to 1, of a material's albedo that lies in narrow lobes.

    label  (108,) natural logarithms
    """
    lobes = torch.as_tensor(np.asarray(label, np.float64).reshape(-1))
    kappa, gamma = np.exp(lobes.numpy()).reshape(SHAPE)[..., 0].transpose(2, 0, 1)
    sharpness = lobe_sharpness(np.minimum(kappa, MAX_EXPONENT), gamma)
    albedo = lobe_albedos(lobes).numpy() * np.asarray(LUMINANCE)[:, None]
    return float((albedo * sharpness / (sharpness + HALF_NARROW)).sum() / max(albedo.sum(), 1e-9))
