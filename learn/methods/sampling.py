"""Monte Carlo estimates of the integral by light sampling, BRDF sampling or both.

Both are combined by the balance heuristic.

N samples per pixel, p pixel, i sample. A light sample is a texel drawn by its energy and a point
within it; a BRDF sample is a half vector drawn about the normal by a mixture of the three lobes'
cosine powers and a broad one, reflected.

    I ≈ Σ_i f(w_i) μ(w_i) L(w_i) / (N_light p_light(w_i) + N_brdf p_brdf(w_i))

Samples are constant in the backward pass. They are the same every time: a fixed stratified pattern
shifted by a hash of the pixel's number.
"""

import math

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint

from learn.methods import Batch, lobe_shapes, radiance_by_group
from learn.methods.half_vectors import frame_about, reflectance, texel_of
from shaders.dsbrdf import differentiable_half_angles
from shaders.envmap import directions
from shaders.tone import LUMINANCE

PAIRS = 32768  # samples of one chunk of pixels


def sample_count(tolerance: float) -> int:
    """Return the samples per pixel for a tolerance, between 16 and 1024."""
    return int(np.clip(2 ** round(math.log2(4.0 / tolerance)), 16, 1024))


def radiance_by_samples(batch: Batch, by_light: int, by_brdf: int) -> torch.Tensor:
    """Return radiance (P, 3) with `by_light` + `by_brdf` samples per pixel."""

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        lobes = Lobes(m)
        table = Texels(light, batch.camera_from_light)
        step = max(1, PAIRS // (by_light + by_brdf))
        views = (
            [n.new_tensor([[0.0, 0.0, 1.0]])] * math.ceil(len(n) / step)
            if view is None
            else view.split(step)
        )
        parts = zip(n.split(step), views, range(0, len(n), step), strict=True)
        return torch.cat(
            [
                checkpoint(
                    chunk_radiance,
                    a,
                    b,
                    m,
                    light,
                    lobes,
                    table,
                    by_light,
                    by_brdf,
                    s,
                    use_reentrant=False,
                )
                for a, b, s in parts
            ]
        )

    return radiance_by_group(batch, one_group)


class Lobes:
    """Cosine powers (4,) of h about n, and their shares (4,).

    They are the three lobes' sharpness, by strength, and a broad power of 1.
    """

    def __init__(self, m: torch.Tensor):
        strength = lobe_shapes.strength(m)
        self.power = np.append(np.clip(lobe_shapes.sharpness(m), 0.0, 1e6), 1.0)
        self.share = (
            np.append(0.9 * strength / strength.sum(), 0.1)
            if strength.sum() > 0
            else np.array([0.0, 0.0, 0.0, 1.0])
        )

    def draw(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """cos θ_h and sin θ_h for u (…,) in [0, 1), numpy; u also chooses the lobe."""
        edges = np.cumsum(self.share) / self.share.sum()
        lobe = np.minimum(np.searchsorted(edges, u, side="right"), 3)
        within = (u - np.where(lobe > 0, edges[lobe - 1], 0.0)) / np.maximum(
            self.share[lobe] / self.share.sum(), 1e-12
        )
        log_cosine = np.log1p(-np.clip(within, 0.0, 1 - 1e-9)) / (self.power[lobe] + 1)
        return np.exp(log_cosine), np.sqrt(-np.expm1(2 * log_cosine))

    def density(self, cosine: torch.Tensor) -> torch.Tensor:
        """Return the density of h (per sr) at its cosine with n, torch."""
        log_c = torch.log(cosine.clamp(min=1e-12))[..., None]
        power = torch.as_tensor(self.power, dtype=cosine.dtype, device=cosine.device)
        share = torch.as_tensor(self.share, dtype=cosine.dtype, device=cosine.device)
        return (share * (power + 1) / (2 * math.pi) * torch.exp(power * log_c)).sum(-1)


class Texels:
    """The map as a distribution: cumulative energy over texels, and density per sr of each."""

    def __init__(self, light: torch.Tensor, camera_from_light: torch.Tensor):
        self.height, self.width = light.shape[:2]
        energy = (light.detach().double().cpu().numpy() @ LUMINANCE) * (
            solid_angle := directions(*light.shape[:2])[1]
        )
        energy = (
            energy / max(energy.sum(), 1e-300) if energy.sum() > 0 else solid_angle / (4 * np.pi)
        ).reshape(-1)
        self.cumulative = np.cumsum(energy) / energy.sum()
        self.density = torch.as_tensor(
            energy / energy.sum() / solid_angle.reshape(-1), dtype=light.dtype, device=light.device
        )
        self.camera_from_light = camera_from_light.double().cpu().numpy()

    def draw(self, u: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the directions (…, 3), camera frame, numpy.

        u chooses the texel, a and b the place in it (across, and down by solid angle)
        """
        texel = np.minimum(
            np.searchsorted(self.cumulative, u, side="right"), len(self.cumulative) - 1
        )
        row, column = np.divmod(texel, self.width)
        top, bottom = np.cos(np.pi * row / self.height), np.cos(np.pi * (row + 1) / self.height)
        cosine = top + (bottom - top) * b
        sine, phi = np.sqrt(np.maximum(1 - cosine**2, 0.0)), 2 * np.pi * (column + a) / self.width
        return (
            np.stack([np.cos(phi) * sine, cosine, np.sin(phi) * sine], -1)
            @ self.camera_from_light.T
        )


def pattern(first: int, pixels: int, samples: int) -> np.ndarray:
    """Numbers (pixels, samples, 3) in [0, 1): a Kronecker sequence shifted by a hash per pixel."""
    # powers of the root of x⁴ = x + 1 (Roberts 2018)
    steps = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
    i = np.arange(samples)[None, :, None]
    pixel = np.arange(first, first + pixels, dtype=np.uint64)[:, None] * np.uint64(3) + np.arange(
        3, dtype=np.uint64
    )
    # splitmix64
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB), (31, 1)):
        pixel = (pixel ^ (pixel >> np.uint64(shift))) * np.uint64(factor) + np.uint64(
            0x9E3779B97F4A7C15
        )
    turn = (pixel >> np.uint64(11)).astype(np.float64) * 2.0**-53
    return (turn[:, None] + i * steps) % 1.0


def chunk_radiance(
    n: torch.Tensor,
    view: torch.Tensor,
    m: torch.Tensor,
    light: torch.Tensor,
    lobes: Lobes,
    table: Texels,
    by_light: int,
    by_brdf: int,
    first: int,
) -> torch.Tensor:
    """Return radiance (p, 3) of the pixels numbered from `first`."""
    with torch.no_grad():
        w = torch.cat(
            [
                part
                for part in (
                    draw_by_light(n, table, by_light, first),
                    draw_by_lobes(n, view, lobes, by_brdf, first),
                )
                if part is not None
            ],
            1,
        )
        h, _ = differentiable_half_angles(w, view[:, None])
        cos_d, cos_h = (h * view[:, None]).sum(-1), (h * n[:, None]).sum(-1)
        seen = ((w * n[:, None]).sum(-1) > 0) & (cos_d > 1e-6) & (cos_h > 0)
        texel = texel_of(
            w @ torch.as_tensor(table.camera_from_light, dtype=w.dtype, device=w.device),
            table.height,
            table.width,
        )
        density = by_light * table.density[texel] + by_brdf * lobes.density(cos_h) / (
            4 * cos_d.clamp(min=1e-6)
        )
        weight = torch.where(seen & (density > 0), 1 / density.clamp(min=1e-30), 0.0)
        w = torch.where(seen[..., None], w, n[:, None])
    mu = (w * n[:, None]).sum(-1) * weight
    f = reflectance(n, view, w, m)
    return torch.einsum("pik,pi,pik->pk", f, mu, light.reshape(-1, 3)[texel])


def draw_by_light(n: torch.Tensor, table: Texels, samples: int, first: int) -> torch.Tensor | None:
    """Return the directions (p, samples, 3) drawn by the light; None for no samples."""
    if samples == 0:
        return None
    u = pattern(first, len(n), samples)
    return torch.as_tensor(
        table.draw(u[..., 0], u[..., 1], u[..., 2]), dtype=n.dtype, device=n.device
    )


def draw_by_lobes(
    n: torch.Tensor, view: torch.Tensor, lobes: Lobes, samples: int, first: int
) -> torch.Tensor | None:
    """Return the directions (p, samples, 3) drawn by the lobes; None for no samples."""
    if samples == 0:
        return None
    u = pattern(first, len(n), samples)
    cosine, sine = lobes.draw(u[..., 0])
    around = np.stack(
        [sine * np.cos(2 * np.pi * u[..., 1]), sine * np.sin(2 * np.pi * u[..., 1]), cosine], -1
    )
    h = torch.einsum(
        "pab,pib->pia", frame_about(n), torch.as_tensor(around, dtype=n.dtype, device=n.device)
    )
    return torch.nn.functional.normalize(
        2 * (h * view[:, None]).sum(-1, keepdim=True) * h - view[:, None], dim=-1
    )
