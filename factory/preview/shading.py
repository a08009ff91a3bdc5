"""A record rendered from its label by the plain sum over the light's texels, at a few pixels.

This needs numpy alone; the rendering layer in learn/ does it faster and with derivatives.

P  pixels; T: texels with positive radiance
n  (P, 3), unit normals, camera frame
L  (64, 128, 3), the light as the camera sees it
v  (P, 3), towards the viewer, or None: (0, 0, 1)
"""

import numpy as np

from shaders import dsbrdf, envmap
from shaders.frames import camera_from_light

CHUNK = 1 << 21  # pixels × texels at a time: 16 MB per array of float64


def lights(L: np.ndarray, elevation: float, roll: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (T, 3), camera frame, and radiance × solid angle (T, 3) of lit texels."""
    w, solid_angle = envmap.directions(*L.shape[:2])
    power = (L * solid_angle[..., None]).reshape(-1, 3).astype(np.float64)
    lit = power.max(-1) > 0
    return w.reshape(-1, 3)[lit] @ camera_from_light(elevation, roll).T, power[lit]


def shade(
    n: np.ndarray,
    m: np.ndarray,
    L: np.ndarray,
    elevation: float,
    v: np.ndarray | None = None,
    roll: float = 0.0,
) -> np.ndarray:
    """Return the radiance (P, 3) of pixels of one material, without shadow or interreflection.

    m                (3, 3, 2, 6), control values of κ and γ
    elevation, roll  of the camera, radians
    """
    w, power = lights(L, elevation, roll)
    out = np.empty((len(n), 3))
    step = max(1, CHUNK // max(len(w), 1))
    for start in range(0, len(n), step):
        part = slice(start, start + step)
        view = np.array([0.0, 0.0, 1.0]) if v is None else v[part]
        out[part] = _sum(np.asarray(n[part], np.float64), m, w, power, view)
    return out


def _sum(
    n: np.ndarray, m: np.ndarray, w: np.ndarray, power: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Return Σ_t f(h·n, θ_d) max(0, n·w) L dω (P, 3) for a few pixels.

    v  (3,) for all pixels, or (P, 3)
    """
    cosine = np.maximum(n @ w.T, 0.0)
    if v.ndim == 1:  # a distant viewer: h and θ_d depend on the texel alone
        h, theta_d = dsbrdf.half_angles(w, v)
        kappa, gamma = (c[None] for c in dsbrdf.coefficients(m, theta_d))
        cos_h = n @ h.T
    else:
        h, theta_d = dsbrdf.half_angles(w[None], v[:, None])
        kappa, gamma = (
            c.reshape(*theta_d.shape, 3, 3) for c in dsbrdf.coefficients(m, theta_d.ravel())
        )
        cos_h = (h * n[:, None]).sum(-1)
    lit = (cosine > 0) & (cos_h > 0)
    log_c = np.log(np.where(lit, cos_h, 1.0))
    radiance = np.empty((len(n), 3))
    for k in range(3):
        f = sum(
            np.expm1(
                np.minimum(kappa[..., k, s] * np.exp(gamma[..., k, s] * log_c), dsbrdf.MAX_EXPONENT)
            )
            for s in range(3)
        )
        radiance[:, k] = np.where(lit, f * cosine, 0.0) @ power[:, k]
    return radiance


def mirror_sphere(L: np.ndarray, size: int, elevation: float, roll: float = 0.0) -> np.ndarray:
    """Return a picture (size, size, 3) of a mirror sphere under the light, black around it.

    elevation, roll  of the camera, radians
    """
    y, x = np.mgrid[0:size, 0:size]
    x, y = (2 * x + 1 - size) / size, (size - 1 - 2 * y) / size
    r2 = x**2 + y**2
    inside = r2 < 1
    z = np.sqrt(np.maximum(1 - r2, 0.0))
    n = np.stack([x, y, z], axis=-1)
    reflected = 2 * z[..., None] * n - np.array([0.0, 0.0, 1.0])
    row, column = envmap.texel(reflected @ camera_from_light(elevation, roll), *L.shape[:2])
    return np.where(inside[..., None], L[row, column], 0.0)
