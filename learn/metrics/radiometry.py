"""Summaries of a light and of a material: radiance under broad lobes, and albedo along the normal.

B lights; all arguments and results are tensors.
"""

import numpy as np
import torch

from shaders import envmap
from shaders.dsbrdf import SHAPE
from shaders.spline import basis

GLOSS = (1.0, 12.0, 120.0)  # exponents of cos: irradiance, and two spheres of growing gloss
DIRECTIONS = 96
KAPPA_CEILING = 12.0  # of κ c^γ, so that expm1 of a wild prediction stays finite
_NODES = 48

_LOBES: dict[tuple[int, int, torch.device], torch.Tensor] = {}


def log_rendered(light: torch.Tensor) -> torch.Tensor:
    """Return log(0.05 + mean of L under lobes cos^g), (B, 3, 3 · DIRECTIONS).

    The lobes are normalised, and their directions spread evenly over the sphere.

    light  (B, 3, Hl, Wl)
    """
    H, W = light.shape[-2:]
    if (key := (H, W, light.device)) not in _LOBES:
        w, omega = envmap.directions(H, W)
        k = np.arange(DIRECTIONS) + 0.5
        y, turn = 1 - 2 * k / DIRECTIONS, np.pi * (1 + 5**0.5) * k
        centre = np.stack(
            [np.sqrt(1 - y * y) * np.cos(turn), y, np.sqrt(1 - y * y) * np.sin(turn)], -1
        )
        cosine = np.clip(w.reshape(-1, 3) @ centre.T, 0, None)
        lobes = np.concatenate([cosine**g * omega.reshape(-1, 1) for g in GLOSS], 1)
        _LOBES[key] = torch.as_tensor(lobes / lobes.sum(0), dtype=torch.float32).to(light.device)
    return torch.log(0.05 + light.reshape(-1, H * W) @ _LOBES[key]).reshape(len(light), 3, -1)


def log_albedo(label: torch.Tensor) -> torch.Tensor:
    """Return log ∫ f cos dw (…, 3) of a surface that is seen along its normal.

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
    ).sum(-2)
    weight = torch.as_tensor(weight, dtype=label.dtype).to(label.device)
    return torch.log((lobes * weight).sum(-1) + 1e-3)


def irradiance(light: torch.Tensor) -> torch.Tensor:
    """Return radiance (B, 3, DIRECTIONS) leaving white matte surfaces that face each direction."""
    values = log_rendered(light).exp() - 0.05
    return values[..., : values.shape[-1] // 3]
