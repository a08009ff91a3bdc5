"""The scene that both renderers are shown: a sphere, a lamp in a sky, three materials."""

import numpy as np

from shaders import envmap

LOBES = {
    "matte": ((0.1, 0.05, 0.01), (0.01, 0.3, 1.0)),
    "satin": ((0.1, 0.3, 0.3), (0.2, 5.0, 25.0)),
    "glossy": ((0.05, 0.4, 1.0), (0.3, 20.0, 120.0)),
}


def material(name):
    kappa, gamma = LOBES[name]
    m = np.empty((3, 3, 2, 6))
    m[:, :, 0] = np.array(kappa)[:, None] * np.array([1.0, 0.8, 0.6])[:, None, None]
    m[:, :, 1] = np.array(gamma)[:, None] * np.linspace(1.0, 1.2, 6)
    return m


def sky(size=(32, 64)):
    w, _ = envmap.directions(*size)
    lamp = 6.0 * np.exp(20 * (w @ (np.array([1.0, 1.0, 1.0]) / np.sqrt(3.0)) - 1))[..., None]
    return 0.3 + np.clip(w[..., 1:2], 0, 1) * [0.4, 0.6, 1.0] + lamp


def sphere_normals(size, sub, radius):
    """inside (size, size): pixels wholly on the sphere; n (size·sub, size·sub, 3): 0 outside."""
    x = ((np.arange(size * sub) + 0.5) / (size * sub) * 2 - 1) / radius
    x, y = np.meshgrid(x, -x)
    z2 = 1 - x * x - y * y
    n = np.where((z2 > 1e-6)[..., None], np.stack([x, y, np.sqrt(np.maximum(z2, 0))], -1), 0.0)
    return (z2 > 0.02).reshape(size, sub, size, sub).all((1, 3)), n
