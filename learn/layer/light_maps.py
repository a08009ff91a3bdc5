"""Light maps as tensors: averages them over solid angle, and returns their texels' solid angles."""

import math

import numpy as np
import torch

from shaders import envmap


def reduce_maps(light: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Return maps (B, 3, Hl, Wl) averaged over solid angle to `size` (h, w), energy preserved."""
    H, W = light.shape[-2:]
    if tuple(size) == (H, W):
        return light
    rows = torch.as_tensor(row_means(H, size[0]), dtype=light.dtype).to(light.device)
    columns = light.reshape(*light.shape[:-1], size[1], W // size[1]).mean(-1)
    return rows @ columns


def row_means(before: int, after: int) -> np.ndarray:
    """Return weights (after, before) that average rows of a map by solid angle."""
    weight = np.asarray(envmap.row_solid_angles(before, 1)).reshape(after, -1)
    weights = np.zeros((after, before))
    for r, w in enumerate(weight):
        weights[r, r * len(w) : (r + 1) * len(w)] = w / w.sum()
    return weights


def solid_angles(light: torch.Tensor) -> torch.Tensor:
    """Return each texel's share of the sphere, (Hl, Wl), which sum to 1."""
    H, W = light.shape[-2:]
    share = torch.as_tensor(
        np.asarray(envmap.row_solid_angles(H, W)).reshape(-1), dtype=light.dtype
    ).to(light.device) / (4 * math.pi)
    return share[:, None].expand(H, W)
