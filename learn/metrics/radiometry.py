"""Summaries of a light and of a material: radiance under broad lobes, and albedo along the normal.

B lights; all arguments and results are tensors.
"""

import numpy as np
import torch

from learn.layer.albedo import log_albedo
from shaders import envmap

__all__ = ["irradiance", "log_albedo", "log_rendered"]

GLOSS = (1.0, 12.0, 120.0)  # exponents of cos: irradiance, and two spheres of growing gloss
DIRECTIONS = 96

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


def irradiance(light: torch.Tensor) -> torch.Tensor:
    """Return radiance (B, 3, DIRECTIONS) leaving white matte surfaces that face each direction."""
    values = log_rendered(light).exp() - 0.05
    return values[..., : values.shape[-1] // 3]


def irradiance_error(light: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """Return (B,) root mean square errors of `irradiance`, relative to the true root mean square.

    light, true  (B, 3, Hl, Wl) linear radiance, light frame; neither is rescaled
    """
    right = irradiance(true.float())
    squared = (irradiance(light.float()) - right) ** 2
    return (squared.mean((1, 2)) / (right**2).mean((1, 2))).sqrt()
