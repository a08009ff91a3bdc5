"""A light as a picture: the map, and a grey diffuse and a mirror sphere under it.

The spheres are seen from the camera; all are shown as a display shows them.
"""

import numpy as np

from factory.lights.light import Light
from shaders import envmap, frames, tone

DIFFUSE_SIZE = (32, 64)  # texels summed for the diffuse sphere; a cosine lobe is far wider


def sphere_normals(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (size, size, 3) of a sphere that fills the picture, and its mask.

    The normals are in the camera frame and 0 outside the mask.
    """
    x, y = frames.pixel_grid(size, size)
    inside = x * x + y * y < 1
    z = np.sqrt(np.where(inside, 1 - x * x - y * y, 0.0))
    return np.where(inside[..., None], np.stack([x, y, z], axis=-1), 0.0), inside


def diffuse_sphere(L: np.ndarray, size: int) -> np.ndarray:
    """Return the radiance (size, size, 3) of a white Lambert sphere.

    It is the cosine-weighted mean of L over each normal's hemisphere.
    """
    n, mask = sphere_normals(size)
    small = envmap.resize(L, *DIFFUSE_SIZE)
    w, solid_angle = envmap.directions(*DIFFUSE_SIZE)
    w_camera = w.reshape(-1, 3) @ frames.camera_from_light().T
    cosine = np.maximum(n.reshape(-1, 3) @ w_camera.T, 0.0)
    E = cosine @ (small * solid_angle[..., None]).reshape(-1, 3)
    return (E / np.pi).reshape(size, size, 3) * mask[..., None]


def mirror_sphere(L: np.ndarray, size: int) -> np.ndarray:
    """Return the radiance (size, size, 3) of a perfect mirror sphere, by the nearest texel."""
    n, mask = sphere_normals(size)
    reflected = 2 * n[..., 2:] * n - np.array([0.0, 0.0, 1.0])
    row, column = envmap.texel(reflected @ frames.camera_from_light(), *L.shape[:2])
    return np.asarray(L, dtype=np.float64)[row, column] * mask[..., None]


def picture(light: Light, size: int = 128) -> np.ndarray:
    """Return a display picture (size, 4·size, 3) uint8 of map, diffuse sphere and mirror sphere.

    It is exposed so that the diffuse sphere stays below white.
    """
    diffuse, mirror = diffuse_sphere(light.L64, size), mirror_sphere(light.L_full, size)
    exposure = 0.8 / max(float((diffuse @ tone.LUMINANCE).max()), 1e-12)
    row = np.concatenate([envmap.resize(light.L_full, size, 2 * size), diffuse, mirror], axis=1)
    display: np.ndarray = tone.display(row, exposure)
    return np.round(display).astype(np.uint8)
