"""A light as a picture: the map as the display shows it, and a grey diffuse and a mirror ball under
it, seen from the camera.
"""

import numpy as np

from shaders import envmap, frames, tone

BALL_LIGHT = (32, 64)  # texels of the sum for the diffuse ball; a cosine lobe is far wider than one


def sphere_normals(size):
    """Normals (size, size, 3) of a sphere that fills the picture, camera frame, and its mask; 0
    outside.
    """
    x, y = frames.pixel_grid(size, size)
    inside = x * x + y * y < 1
    z = np.sqrt(np.where(inside, 1 - x * x - y * y, 0.0))
    return np.where(inside[..., None], np.stack([x, y, z], axis=-1), 0.0), inside


def diffuse_sphere(L, size):
    """Radiance (size, size, 3) of a white Lambert sphere: the cosine-weighted mean of L over each
    normal's hemisphere.
    """
    n, mask = sphere_normals(size)
    small = envmap.resize(L, *BALL_LIGHT)
    w, solid_angle = envmap.directions(*BALL_LIGHT)
    w_camera = w.reshape(-1, 3) @ frames.camera_from_light().T
    cosine = np.maximum(n.reshape(-1, 3) @ w_camera.T, 0.0)
    E = cosine @ (small * solid_angle[..., None]).reshape(-1, 3)
    return (E / np.pi).reshape(size, size, 3) * mask[..., None]


def mirror_sphere(L, size):
    """Radiance (size, size, 3) of a perfect mirror sphere, nearest texel."""
    n, mask = sphere_normals(size)
    reflected = 2 * n[..., 2:] * n - np.array([0.0, 0.0, 1.0])
    row, column = envmap.texel(reflected @ frames.camera_from_light(), *L.shape[:2])
    return np.asarray(L, dtype=np.float64)[row, column] * mask[..., None]


def picture(light, size=128):
    """Display picture (size, 4·size, 3) uint8: map, diffuse ball, mirror ball; exposed so that the
    diffuse ball keeps below white.
    """
    diffuse, mirror = diffuse_sphere(light.L64, size), mirror_sphere(light.L_full, size)
    exposure = 0.8 / max(float((diffuse @ tone.LUMINANCE).max()), 1e-12)
    row = np.concatenate([envmap.resize(light.L_full, size, 2 * size), diffuse, mirror], axis=1)
    return np.round(tone.display(row, exposure)).astype(np.uint8)
