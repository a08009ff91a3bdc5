"""Light and lobes as spherical Gaussians G(w) = a e^{λ (μ·w − 1)}.

Their products and integrals are closed forms.


light   the regions of a median cut, each a Gaussian with its energy about its centre, as wide as
        the region
lobe    expm1(κ c^γ) ≈ expm1(κ) e^{g (h·n − 1)}, g the sharpness (shaders.dsbrdf.lobe_sharpness,
        written out in `chunk_radiance` for κ held above 0); over w it is a Gaussian about the
        mirror direction r with λ = g / (4 n·v), at θ_d of the mirror direction
cosine  max(0, n·w) at the product's axis

    ∫ G_a G_b dw = a b 2π (e^{d − λ_a − λ_b} − e^{−d − λ_a − λ_b}) / d,   d = |λ_a μ_a + λ_b μ_b|

Source: Wang, Ren, Gong, Snyder and Guo, All-Frequency Rendering of Dynamic, Spatially-Varying
Reflectance, 2009.
"""

import math

import torch
from torch.utils.checkpoint import checkpoint

from learn.methods import (
    HELD_LIGHTS,
    Batch,
    Card,
    forbid_second_derivatives,
    median_cut,
    radiance_by_group,
)
from shaders.dsbrdf import MAX_EXPONENT
from shaders.spline import basis

CARD = Card(
    name="spherical_gaussians",
    approximates=(
        "light by 64 spherical Gaussians, each lobe by one, the cosine by its value at their"
        " product's axis"
    ),
    error=0.2,
    cost="9 lobes × 64 lights × pixels, without a texel in sight",
    memory="below 64 MiB: chunks of pixels",
)
LIGHTS, CHUNK, WIDEST = 64, 2048, 0.25  # WIDEST: least λ of a lobe; a constant has none


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    return radiance_by_lights(
        forbid_second_derivatives(batch, CARD.name, HELD_LIGHTS)
        if batch.light.requires_grad
        else batch,
        LIGHTS,
    )


def radiance_by_lights(batch: Batch, count: int) -> torch.Tensor:
    """Return radiance (P, 3) with a light of `count` spherical Gaussians."""

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        lights, E = median_cut.cut_light(light, batch.camera_from_light, count)
        mu = torch.as_tensor(lights.w, dtype=n.dtype, device=n.device)
        # A region of 4π / count steradian; its Gaussian has the same solid angle 2π/λ.
        sharpness = n.new_full((len(mu),), 0.5 * count)
        views = [None] * math.ceil(len(n) / CHUNK) if view is None else view.split(CHUNK)
        parts = zip(n.split(CHUNK), views, strict=True)
        return torch.cat(
            [
                checkpoint(chunk_radiance, a, b, m, mu, E, sharpness, use_reentrant=False)
                for a, b in parts
            ]
        )

    return radiance_by_group(batch, one_group)


def chunk_radiance(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    mu: torch.Tensor,
    E: torch.Tensor,
    light_sharpness: torch.Tensor,
) -> torch.Tensor:
    """Return radiance (p, 3): mu (T, 3), E (T, 3), light_sharpness (T,). Shapes (p, t, k, s)."""
    view = n.new_tensor([[0.0, 0.0, 1.0]]) if view is None else view
    cosine = (n * view).sum(-1).clamp(min=1e-3)
    mirror = 2 * cosine[:, None] * n - view
    theta_d = torch.atan2((n - cosine[:, None] * view).norm(dim=-1).clamp(min=1e-6), cosine)
    kappa, gamma = torch.einsum("pb,ksjb->jpks", basis(theta_d), m)
    kappa = kappa.clamp(1e-6, MAX_EXPONENT)
    sharp = (gamma * kappa / -torch.expm1(-kappa) / (4 * cosine[:, None, None])).clamp(min=WIDEST)
    axes = (
        sharp[:, None, ..., None] * mirror[:, None, None, None]
        + (light_sharpness[:, None] * mu)[None, :, None, None]
    )
    both = sharp[:, None] * light_sharpness[:, None, None]
    total = sharp[:, None] + light_sharpness[:, None, None]
    squared_distance = ((mirror[:, None] - mu) ** 2).sum(-1)[..., None, None]
    d = (total * total - both * squared_distance).clamp(min=1e-12).sqrt()
    below = both * squared_distance / (d + total)  # λ_a + λ_b − d without its cancellation
    overlap = 2 * math.pi * torch.exp(-below) * -torch.expm1(-2 * d) / d
    at_axis = ((axes * n[:, None, None, None]).sum(-1) / d).clamp(min=0)
    light = (E * (light_sharpness / (2 * math.pi * -torch.expm1(-2 * light_sharpness)))[:, None])[
        None, :, :, None
    ]
    return (torch.expm1(kappa)[:, None] * overlap * at_axis * light).sum((1, 3))
