"""The three-sphere protocol: a light seen on a diffuse, a matte silver and a mirror sphere.

It is the protocol of the literature on lighting estimation (LeGendre et al. 2019; Weber et al.
2022): the predicted and the true light are each shown on the three spheres, in linear radiance and
without exposure, and the pictures are compared.

rmse         root mean square difference over pixels and channels; maps have unit mean luminance
si_rmse      the same after the one factor on the predicted picture that makes it smallest
angular_deg  mean angle between the colours of a pixel, as vectors (R, G, B), in degrees

diffuse      f = DIFFUSE_ALBEDO / π
silver       GGX of width SILVER_ALPHA, reflectance SILVER_F0 without Fresnel's rise
mirror       reflectance 1; a pixel holds the mean of SUBPIXELS² reflected directions

The camera is orthographic and looks down by the elevation of the picture's own camera. Pixels at
the rim (n_z ≤ RIM) are left out. Figures of other builds of the three spheres are not comparable.
"""

from functools import lru_cache

import numpy as np
import torch

from learn.data.devices import to_numpy
from shaders import closures, envmap, frames

SIZE = 32
SUBPIXELS = 8  # along either axis
RIM = 0.1
DIFFUSE_ALBEDO = 0.8
SILVER_ALPHA = 0.25  # its lobe is 5 texels wide, so that a sum over texels holds
SILVER_F0 = 0.9
SPHERES = ("diffuse", "silver", "mirror")


def compare(L: torch.Tensor, true: torch.Tensor, elevation: float) -> dict[str, float]:
    """Return {f"{sphere}_{figure}": value} of light maps (3, H, W), light frame.

    elevation  of the camera, radians
    """
    mine, right = (pictures(light, elevation) for light in (L, true))
    return {
        f"{name}_{figure}": value
        for name in SPHERES
        for figure, value in errors(mine[name], right[name]).items()
    }


def errors(picture: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Return {figure: value} of radiance (P, 3) against the true radiance (P, 3)."""
    square = float((picture**2).sum())
    factor = float((picture * truth).sum()) / square if square > 0 else 0.0
    seen = picture.any(-1) & truth.any(-1)  # black has no colour
    a, b = picture[seen], truth[seen]
    # not by the arc cosine, which turns rounding into 1e-6°
    angles = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))
    return {
        "rmse": float(np.sqrt(((picture - truth) ** 2).mean())),
        "si_rmse": float(np.sqrt(((factor * picture - truth) ** 2).mean())),
        "angular_deg": float(angles.mean()) if angles.size else 90.0,
    }


def pictures(L: torch.Tensor, elevation: float) -> dict[str, np.ndarray]:
    """Return {sphere: radiance (P, 3) float64} of a light map (3, H, W) at P pixels of a sphere."""
    height, width = L.shape[-2:]
    radiance = to_numpy(L.double()).reshape(3, -1).T
    # whole degrees, so that views of nearly one elevation share the matrices of 50 MB
    tables, texels = _tables(height, width, round(float(np.degrees(elevation))))
    shown = {name: _product(table, radiance) for name, table in tables.items()}
    return shown | {"mirror": radiance[texels].mean(1)}


def _product(table: np.ndarray, radiance: np.ndarray) -> np.ndarray:
    """table (P, N) float32 times radiance (N, 3) float64; at once, the table would be converted
    into 40 MB of new memory.
    """
    blocks = range(0, len(table), 32)
    return np.concatenate([table[i : i + 32].astype(np.float64) @ radiance for i in blocks])


@lru_cache(maxsize=2)
def _tables(height: int, width: int, degrees: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """{sphere: (P, height · width) float32}, what each texel adds to each pixel of the spheres that
    are no mirror, and the texels (P, SUBPIXELS²) of which a mirror's pixels are the means.
    """
    to_light = frames.camera_from_light(np.radians(degrees)).T
    view = to_light @ np.array([0.0, 0.0, 1.0])
    fine = _normals(SIZE * SUBPIXELS)
    blocks = fine.reshape(SIZE, SUBPIXELS, SIZE, SUBPIXELS, 3).swapaxes(1, 2)
    blocks = blocks.reshape(SIZE, SIZE, -1, 3)
    n = _normals(SIZE)
    inside = (n[..., 2] > RIM) & (blocks[..., 2] > 0).all(-1)
    n, blocks = n[inside] @ to_light.T, blocks[inside] @ to_light.T
    w, solid_angle = envmap.directions(height, width)
    w, solid_angle = w.reshape(-1, 3), solid_angle.reshape(-1)
    half = w + view
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    lit = n @ w.T
    cosine = np.maximum(lit, 0.0)
    safe = np.maximum(lit, 1e-3)
    lobe = closures.ggx(
        np.float64(SILVER_ALPHA), safe, (n @ view)[:, None], np.abs(n @ half.T), half @ view
    )
    tables = {
        "diffuse": DIFFUSE_ALBEDO / np.pi * cosine * solid_angle,
        "silver": SILVER_F0 * lobe * cosine * solid_angle,
    }
    reflected = 2 * (blocks @ view)[..., None] * blocks - view
    row, column = envmap.texel(reflected, height, width)
    return {name: table.astype(np.float32) for name, table in tables.items()}, row * width + column


def _normals(size: int) -> np.ndarray:
    """Normals (size, size, 3) float64 of a sphere that fills the frame, 0 outside it."""
    at = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(at, -at)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    return np.stack([x, y, z], -1) * (z > 0)[..., None]
