"""How wide and how strong a material's lobes are: the few numbers that decide which method serves
it.

A lobe expm1(κ c^γ) falls about its peak as c to the power γ κ e^κ / (e^κ − 1): the exponent below,
its *sharpness* g. Near the peak it is a Gaussian of half-vector angle with standard deviation 1/√g.
Sharpness changes with θ_d and channel; the largest counts.

m  (3, 3, 2, 6) control values: channel, lobe, (κ, γ)
"""

import numpy as np
import torch

from shaders.dsbrdf import MAX_EXPONENT


def sharpness(m: torch.Tensor | np.ndarray, dark: bool = False) -> np.ndarray:
    """g of each lobe (3,), numpy float64: the largest over channels and control values, among those
    that reflect anything.

    dark  whether those that reflect nothing count too, with what they would have if they did
    """
    kappa, gamma = controls(m)
    steepening = np.where(kappa > 1e-4, kappa / -np.expm1(-np.maximum(kappa, 1e-4)), 1.0)
    return (np.where((kappa > 0) | dark, gamma * steepening, 0.0)).max((0, 2))


def strength(m: torch.Tensor | np.ndarray) -> np.ndarray:
    """The reflected part of each lobe (3,), roughly: its height times the solid angle of its
    highlight, mean over channels and angles.
    """
    kappa, gamma = controls(m)
    steepening = np.where(kappa > 1e-4, kappa / -np.expm1(-np.maximum(kappa, 1e-4)), 1.0)
    width = np.minimum(8 * np.pi / np.maximum(gamma * steepening, 1e-9), np.pi)
    return (np.expm1(kappa) * width).mean((0, 2))


def controls(m: torch.Tensor | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """κ and γ (3, 3, 6), numpy float64, of a tensor or an array."""
    m = m.detach().double().cpu().numpy() if isinstance(m, torch.Tensor) else m
    return np.minimum(m[:, :, 0], MAX_EXPONENT), m[:, :, 1]


def only(m: torch.Tensor, lobes: np.ndarray) -> torch.Tensor:
    """m with κ = 0, hence no reflection, in all lobes but those marked (3,) numpy bool;
    differentiable.
    """
    marked = torch.as_tensor(
        np.stack([lobes, np.ones_like(lobes)], -1).astype(np.float64),
        dtype=m.dtype,
        device=m.device,
    )
    return m * marked[None, :, :, None]
