"""Pictures of spheres: material spheres, and reflectance maps as in Figure 14.

A reflectance map is the picture of a sphere: radiance by normal. Display values are in [0, 255].
"""

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from learn.data.devices import to_numpy
from learn.figures.montage import GROUND
from learn.layer import predictions
from shaders import tone

MARGIN = 1.02  # half the width of the picture, in radii of the sphere
PREVIEW_EXPOSURE = 0.8  # of material spheres in preview lighting
HOLE = 0.06  # of the sphere's radius: farther from any pixel's normal nothing was observed


def sphere_normals(size: int, margin: float = MARGIN) -> np.ndarray:
    """Return normals (size, size, 3) float32 of a sphere, camera frame, 0 in the background."""
    at = (np.arange(size) + 0.5) / size * (2 * margin) - margin
    x, y = np.meshgrid(at, -at)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    return (np.stack([x, y, z], -1) * (z > 0)[..., None]).astype(np.float32)


def material_sphere(
    label: np.ndarray | torch.Tensor,
    light: np.ndarray | torch.Tensor,
    size: int,
    elevation: float,
    exposure: float,
) -> np.ndarray:
    """Return the display picture (size, size, 3) of a sphere in a material.

    label  (108,) natural logarithms; the sphere is rendered on its device
    light  (Hl, Wl, 3) radiance, light frame
    """
    label = torch.as_tensor(label, dtype=torch.float32).detach()
    n = torch.from_numpy(sphere_normals(size)).to(label.device)
    light = torch.as_tensor(light, dtype=torch.float32).to(label.device)
    radiance = predictions.picture(
        n.movedim(-1, 0)[None],
        label[None, None],
        light.movedim(-1, 0)[None],
        (n != 0).any(-1)[None].long(),
        elevation,
        predictions.SHOWN,
    )
    return tone.display(to_numpy(radiance[0]), exposure)


def preview_lighting() -> np.ndarray:
    """Return a plain light map (32, 64, 3) for material spheres: bright above, one window."""
    L = np.full((32, 64, 3), 0.4, np.float32)
    L[:16] = 0.9
    L[6:12, 8:16] = 12.0
    return L


def preview_sphere(label: np.ndarray | torch.Tensor, size: int, elevation: float) -> np.ndarray:
    """Return the display picture (size, size, 3) of a material sphere in preview lighting."""
    return material_sphere(label, preview_lighting(), size, elevation, PREVIEW_EXPOSURE)


def observed_reflectance(
    radiance: np.ndarray, n: np.ndarray, mask: np.ndarray, size: int, exposure: float
) -> np.ndarray:
    """Return the reflectance map that a picture shows, as a display picture (size, size, 3).

    Pixels are averaged at the place of their normals on the sphere; where there is none it is grey.

    radiance, n  (H, W, 3); mask (H, W) bool
    """
    place = ((n[mask][:, :2] * [1, -1] / MARGIN + 1) * (size / 2)).astype(int).clip(0, size - 1)
    flat = place[:, 1] * size + place[:, 0]
    count = np.bincount(flat, minlength=size * size)
    sums = np.stack([np.bincount(flat, radiance[mask][:, k], size * size) for k in range(3)], -1)
    mean = (sums / np.maximum(count, 1)[:, None]).reshape(size, size, 3)
    distance, index = distance_transform_edt(count.reshape(size, size) == 0, return_indices=True)
    near = (distance < HOLE * size / 2) & (sphere_normals(size)[..., 2] > 0)
    return np.where(near[..., None], tone.display(mean[tuple(index)], exposure), GROUND)
