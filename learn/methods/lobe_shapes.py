"""How sharp and how strong a material's lobes are: the numbers that decide which method serves it.

Sharpness is `shaders.dsbrdf.lobe_sharpness`. It changes with θ_d and channel; the largest counts.

m  (3, 3, 2, 6) control values: channel, lobe, (κ, γ)
"""

import numpy as np
import torch

from shaders.dsbrdf import MAX_EXPONENT, lobe_sharpness

KNOTS = np.linspace(0.0, np.pi / 2, 6)  # θ_d of the control values
LEAST_SEEN = 0.1  # the part of pixels at θ_d = 0 and 90°, where 1 is at 45°


def sharpness(m: torch.Tensor | np.ndarray, dark: bool = False) -> np.ndarray:
    """Largest sharpness of each lobe (3,), float64, over channels and control values that reflect.

    dark  whether those that reflect nothing count too, with the sharpness of their γ
    """
    kappa, gamma = controls(m)
    return np.where((kappa > 0) | dark, lobe_sharpness(kappa, gamma), 0.0).max((0, 2))


def visible_sharpness(m: torch.Tensor | np.ndarray, ignored: float) -> np.ndarray:
    """As `sharpness`, but for control values that reflect little in sum.

    ignored  the part of all lobes' light that may be narrower; control values count by how many of
             a sphere's pixels have their θ_d
    """
    kappa, gamma = controls(m)
    light = strengths(m) * np.maximum(np.sin(2 * KNOTS), LEAST_SEEN)
    allowed = ignored * light.sum()
    result = np.empty(3)
    for s in range(3):
        sharp = lobe_sharpness(kappa[:, s], gamma[:, s]).ravel()
        order = np.argsort(-sharp)
        beyond = np.flatnonzero(np.cumsum(light[:, s].ravel()[order]) > allowed)
        result[s] = sharp[order[beyond[0] if len(beyond) else -1]]
    return result


def strength(m: torch.Tensor | np.ndarray) -> np.ndarray:
    """Estimate the reflected part of each lobe (3,): height × solid angle of its highlight.

    It is the mean over channels and control values.
    """
    return strengths(m).mean((0, 2))


def strengths(m: torch.Tensor | np.ndarray) -> np.ndarray:
    """As `strength`, of each channel, lobe and control value (3, 3, 6)."""
    kappa, gamma = controls(m)
    width = np.minimum(8 * np.pi / np.maximum(lobe_sharpness(kappa, gamma), 1e-9), np.pi)
    return np.expm1(kappa) * width


def steepness(m: torch.Tensor | np.ndarray) -> np.ndarray:
    """How fast each lobe's strength (3,) changes with θ_d: mean change of its logarithm per knot.

    The last control value, at grazing θ_d, does not count.
    """
    logarithm = np.log(strengths(m).mean(0) + 1e-12)
    return np.abs(np.diff(logarithm, axis=-1))[:, :4].mean(-1)


def controls(m: torch.Tensor | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """κ and γ (3, 3, 6), numpy float64, of a tensor or an array."""
    m = m.detach().double().cpu().numpy() if isinstance(m, torch.Tensor) else m
    return np.minimum(m[:, :, 0], MAX_EXPONENT), m[:, :, 1]


def keep_lobes(m: torch.Tensor, lobes: np.ndarray) -> torch.Tensor:
    """m with κ = 0 in all lobes but those marked (3,) bool; differentiable."""
    marked = torch.as_tensor(
        np.stack([lobes, np.ones_like(lobes)], -1).astype(np.float64),
        dtype=m.dtype,
        device=m.device,
    )
    return m * marked[None, :, :, None]
