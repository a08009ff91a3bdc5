"""How far predicted normals, materials and lights are from the true ones, in meaningful units.

normals    angles over the mask in degrees: mean, median, and the shares below 11.25°, 22.5° and
           30°; mean cosine (the paper's Table 2)
material   brdf_log: root mean square of log((f' + ε)/(f + ε)) over half and difference angles,
           weighted by the light's cosine; log_l2: mean squared difference of the 108 logarithms;
           code_l2: of the codes that networks predict. Regions have equal weights
light      direction_deg: between the brightest directions, seen through a lobe of 10°; irradiance:
           relative root mean square error over 96 directions; spheres_l2: display L2 of three
           spheres, matte, glossy and sharp, under the true light's exposure; and the figures of
           learn.metrics.light_probes. No map is rescaled
"""

from functools import cache, lru_cache

import numpy as np
import torch

from learn.data.devices import to_numpy
from learn.figures.spheres import sphere_normals
from learn.layer import predictions
from learn.metrics import light_probes
from learn.metrics.pictures import display_l2
from learn.metrics.radiometry import irradiance_error
from learn.networks.coding import Ranges
from shaders import dsbrdf, envmap, tone

LIMITS_DEG = (11.25, 22.5, 30.0)
FLOOR = 1e-3  # ε in 1/sr: what lies below a thousandth of a white matte surface's f looks black
GRID = (90, 45, 36)  # θ_h, θ_d, φ_d; MERL's, every second angle
LOBE = 45.0  # of exp(LOBE (cos − 1)): half its peak at 10°
COARSE = (32, 64)
SPHERE = 32  # pixels
# exponent, albedo about the normal
SPHERES = {"matte": (1e-6, 0.8), "glossy": (30.0, 0.8), "sharp": (300.0, 0.8)}


def normals(n: torch.Tensor, true: torch.Tensor, inside: torch.Tensor) -> dict[str, float]:
    """Return {figure: value} of unit normals (3, H, W) over inside (H, W) bool."""
    cosine = (n * true).sum(0)[inside].double().clamp(-1, 1)
    degrees = to_numpy(cosine.arccos().rad2deg())
    result = {
        "mean_deg": float(degrees.mean()),
        "median_deg": float(np.median(degrees)),
        "cosine": float(cosine.mean()),
    }
    return result | {f"below_{limit:g}": float((degrees < limit).mean()) for limit in LIMITS_DEG}


def material(label: torch.Tensor, true: torch.Tensor, ranges: Ranges) -> dict[str, float]:
    """Return {figure: value} of the labels (S, 108) of S regions."""
    pairs = zip(to_numpy(label.double()), to_numpy(true.double()), strict=True)
    return {
        "brdf_log": float(np.mean([brdf_log_error(a, b) for a, b in pairs])),
        "log_l2": float(((label - true) ** 2).mean()),
        "code_l2": float(((ranges.code(label) - ranges.code(true)) ** 2).mean()),
    }


def brdf_log_error(label: np.ndarray, true: np.ndarray) -> float:
    """Return brdf_log of two labels (108,), natural logarithms."""
    cos_h, theta_d, weight = _grid()
    f, right = (dsbrdf.evaluate(np.exp(x), cos_h, theta_d) for x in (label, true))
    error = (np.log((f + FLOOR) / (right + FLOOR)) ** 2).mean(-1)
    return float(np.sqrt((error * weight).sum() / weight.sum()))


@cache
def _grid() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """cos θ_h and θ_d (P,) of the grid's points, and their weights.

    A weight is the mean over φ_d of the light's cosine where light and view are above the surface.
    θ_h = (π/2) u²: points crowd at the highlight, as MERL's do. cos_i, cos_o = cos_h cos_d ∓ sin_h
    sin_d cos φ_d.
    """
    half = np.pi / 2 * ((np.arange(GRID[0]) + 0.5) / GRID[0]) ** 2
    difference = np.pi / 2 * (np.arange(GRID[1]) + 0.5) / GRID[1]
    turn = np.pi * (np.arange(GRID[2]) + 0.5) / GRID[2]
    theta_h, theta_d = (x.reshape(-1) for x in np.meshgrid(half, difference, indexing="ij"))
    along = (np.cos(theta_h) * np.cos(theta_d))[:, None]
    across = (np.sin(theta_h) * np.sin(theta_d))[:, None] * np.cos(turn)
    cos_i, cos_o = along - across, along + across
    weight = np.where((cos_i > 0) & (cos_o > 0), cos_i, 0.0).mean(-1)
    visible = weight > 0
    return np.cos(theta_h)[visible], theta_d[visible], weight[visible]


def light(L: torch.Tensor, true: torch.Tensor, elevation: float) -> dict[str, float]:
    """Return {figure: value} of light maps (3, 64, 128), light frame."""
    cosine = float(np.clip(brightest(L) @ brightest(true), -1, 1))
    mine, right = (
        _pictures(to_numpy(light.float()).tobytes(), light.shape, elevation, light.device)
        for light in (L, true)
    )
    shown = {
        name: display_l2(mine[name], right[name], to_numpy(_sphere(name)[1][0])) for name in SPHERES
    }
    return {
        "direction_deg": float(np.degrees(np.arccos(cosine))),
        "irradiance": float(irradiance_error(L[None], true[None])),
        "spheres_l2": float(np.mean(list(shown.values()))),
        **{f"{name}_sphere_l2": value for name, value in shown.items()},
        **light_probes.compare(L, true, elevation),
    }


def brightest(L: torch.Tensor) -> np.ndarray:
    """Return the unit direction (3,) from which most luminance comes through a lobe of 10°.

    L  (3, H, W); both in the light frame
    """
    w, lobes = _lobes()
    luminance = (
        envmap.resize(to_numpy(L.movedim(0, -1).double()), *COARSE).reshape(-1, 3) @ tone.LUMINANCE
    )
    top = int((lobes @ luminance).argmax())
    centre = (lobes[top] * luminance) @ w  # between texels: where the light within the lobe lies
    return centre / max(np.linalg.norm(centre), 1e-12)


@cache
def _lobes() -> tuple[np.ndarray, np.ndarray]:
    w, solid_angle = envmap.directions(*COARSE)
    w = w.reshape(-1, 3)
    return w, np.exp(LOBE * (w @ w.T - 1)) * solid_angle.reshape(-1)


def sphere_material(name: str) -> np.ndarray:
    """Return the label (108,) float32 of one lobe f = expm1(κ c^γ) of SPHERES.

    κ is such that the albedo, seen along the normal, is as SPHERES says.
    """
    gamma, albedo = SPHERES[name]
    theta = (np.arange(2000) + 0.5) / 2000 * np.pi / 2
    weight = 2 * np.pi * np.sin(theta) * np.cos(theta) * (np.pi / 2) / 2000
    power = np.cos(theta / 2) ** gamma
    low, high = 0.0, 20.0
    for _ in range(60):
        kappa = 0.5 * (low + high)
        low, high = (
            (kappa, high) if (np.expm1(kappa * power) * weight).sum() < albedo else (low, kappa)
        )
    m = np.full(dsbrdf.SHAPE, 1e-9)
    m[:, 0, 0], m[:, 0, 1] = kappa, gamma
    return np.log(m).reshape(-1).astype(np.float32)


@cache
def _sphere(name: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Normals (1, 3, H, W), where they are used (1, H, W) bool, and a label (1, 1, 108)."""
    n = torch.from_numpy(sphere_normals(SPHERE, margin=1.0)).movedim(-1, 0)[None]
    label = torch.from_numpy(sphere_material(name))[None, None]
    return n, n[:, 2] > 0.1, label  # not the rim, where a pixel holds many normals


@lru_cache(maxsize=4)
def _pictures(
    content: bytes, shape: tuple[int, ...], elevation: float, device: torch.device
) -> dict[str, np.ndarray]:
    """Radiance {sphere: (H, W, 3)} under the light map whose float32 values are `content`.

    By content, because many lights are compared with one true light.
    """
    light = torch.frombuffer(bytearray(content), dtype=torch.float32).reshape(shape).to(device)
    result = {}
    for name in SPHERES:
        n, inside, label = (tensor.to(device) for tensor in _sphere(name))
        result[name] = to_numpy(
            predictions.picture(
                n, label, light[None], inside.long(), elevation, predictions.TEXEL_SUM
            )[0]
        )
    return result
