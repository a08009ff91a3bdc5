"""Shapes near the camera and far from it: a sphere, plain or with dents (view_per_pixel)."""

from __future__ import annotations

import numpy as np
import torch

from learn.experiments.layer import chart_cases
from shaders.frames import view_vectors

COVERED = np.sqrt(1.6 / np.pi)  # radius in half pictures of a sphere that covers 40 % of it
DENTS, WAVE_NUMBER = 6, 4.0


def dent(n: np.ndarray, depth: float, seed: int) -> np.ndarray:
    """Return a unit sphere's normals (…, 3) tilted by the slopes of random waves over it.

    depth  of a wave: its slope in radians
    """
    rng = np.random.default_rng(seed)
    result = n.copy()
    for _ in range(DENTS):
        wave = WAVE_NUMBER * rng.normal(size=3)
        phase = rng.uniform(0, 2 * np.pi)
        result += depth / WAVE_NUMBER * np.cos(n @ wave + phase)[..., None] * wave
    return result / np.maximum(np.linalg.norm(result, axis=-1, keepdims=True), 1e-9)


def near(
    size: int, fov: float, depth: float = 0.0, seed: int = 0
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return normals and views (1, size, size, 3) of a sphere before a camera.

    fov  radians across the picture, of which the sphere covers 40 %. A sphere about the origin of
         radius 1 is seen from its distance D: from the camera, D = 1/sin of its angular radius.
    """
    view = np.asarray(view_vectors(size, size, fov), np.float64)
    distance = 1 / np.sin(np.arctan(COVERED * np.tan(fov / 2)))
    middle = np.array([0.0, 0.0, -distance])
    along = -(view @ middle)  # the ray −view passes the middle there
    root = along**2 - (distance**2 - 1)
    n = -(along - np.sqrt(np.maximum(root, 0.0)))[..., None] * view - middle
    if depth:
        n = dent(n, depth, seed)
    seen = (root > 0) & ((n * view).sum(-1) > 1e-3)
    n = np.where(seen[..., None], n / np.linalg.norm(n, axis=-1, keepdims=True), 0.0)
    return torch.as_tensor(n)[None].float(), torch.as_tensor(view)[None].float()


def far(size: int, depth: float = 0.0) -> torch.Tensor:
    """Return normals (1, size, size, 3) of the same sphere for a distant viewer."""
    sphere = chart_cases.sphere(size)
    if not depth:
        return sphere
    n = torch.as_tensor(dent(sphere[0].double().numpy(), depth, 0))[None].float()
    seen = (sphere != 0).any(-1, keepdim=True) & (n[..., 2:] > 1e-3)
    return torch.where(seen, n, torch.zeros(()))
