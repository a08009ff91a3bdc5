"""What a light and a material amount to: radiance under a few broad lobes, and albedo along the
normal. Tensors in, tensors out.
"""

import numpy as np
import torch

from shaders import envmap
from shaders.dsbrdf import SHAPE
from shaders.spline import basis

GLOSS = (1.0, 12.0, 120.0)  # exponents of cos: irradiance, and two spheres of growing gloss


DIRECTIONS = 96


KAPPA_CEILING = 12.0  # of κ c^γ, so that expm1 of a wild prediction stays finite


_LOBES = {}


def log_rendered(light):
    """(B, 3, 3 · DIRECTIONS) log(0.05 + mean of L under normalised lobes cos^g) around directions
    spread over the sphere.
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


_NODES = 48


def log_albedo(label):
    """(…, 3) log of ∫ f cos dw, lit and seen along the normal: then θ_h = θ_d = θ_i/2. label (…,
    108).
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


def irradiance(light):
    """(B, 3, D) radiance leaving white matte surfaces that face D directions."""
    values = log_rendered(light).exp() - 0.05
    return values[..., : values.shape[-1] // 3]
