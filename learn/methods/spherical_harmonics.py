"""Irradiance by nine spherical harmonics: right for a Lambertian surface, wrong for sharper lobes.

    I_k(n) = Σ_l A_kl Σ_m L_klm Y_lm(n),   l ≤ 2          L_klm = Σ_t L_tk Y_lm(w_t) Ω_t
    A_kl   = 2π ∫ f_k(θ) max(0, cos θ) P_l(cos θ) sin θ dθ  the lobe seen straight on (v = n, so θ_h
           = θ_d = θ/2), as if it were round

A is a differentiable Gauss–Legendre sum over f, so gradients in m exist; the view's place plays no
part.

Source: Ramamoorthi and Hanrahan, An Efficient Representation for Irradiance Environment Maps, 2001,
Eq. 13 with f in place of 1/π.
"""

import math

import numpy as np
import torch

from learn.methods import Batch, Card, radiance_by_group
from learn.methods.exact import texels
from shaders.dsbrdf import evaluate

CARD = Card(
    name="spherical_harmonics",
    approximates=(
        "the light by its spherical harmonics up to order 2, every lobe by a round one about the"
        " normal"
    ),
    error=1.6,
    cost="9 × (pixels + texels): nothing is cheaper",
    memory="pixels and texels only",
)


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        w, E = texels(light, batch.camera_from_light)
        of_light = harmonics(w).T @ E
        return torch.einsum(
            "pj,jk,jk->pk", harmonics(n), of_light, round_lobe(m)[:, [0, 1, 1, 1, 2, 2, 2, 2, 2]].T
        ) + zero_of_view(view)

    return radiance_by_group(batch, one_group)


def zero_of_view(view: torch.Tensor | None) -> torch.Tensor | int:
    """0 that keeps the view in the graph, with a zero gradient."""
    return 0 if view is None else 0 * view


def harmonics(d: torch.Tensor) -> torch.Tensor:
    """Real orthonormal spherical harmonics (…, 9) of unit vectors d (…, 3), orders 0 to 2."""
    x, y, z = d.unbind(-1)
    constant = torch.full_like(x, math.sqrt(1 / (4 * math.pi)))
    a, b = math.sqrt(3 / (4 * math.pi)), math.sqrt(15 / (4 * math.pi))
    second = (
        b * x * y,
        b * y * z,
        math.sqrt(5 / (16 * math.pi)) * (3 * z * z - 1),
        b * x * z,
        0.5 * b * (x * x - y * y),
    )
    return torch.stack([constant, a * y, a * z, a * x, *second], -1)


def round_lobe(m: torch.Tensor, points: int = 96) -> torch.Tensor:
    """A (3, 3): channel, order; m (3, 3, 2, 6)."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    # θ = (π/2) t³ crowds the points towards the peak, where sharp lobes have their energy
    t, weights = 0.5 * (nodes + 1), 0.5 * weights
    theta, weights = 0.5 * np.pi * t**3, weights * 1.5 * np.pi * t**2
    cosine = np.cos(theta)
    legendre = np.stack([np.ones_like(cosine), cosine, 1.5 * cosine**2 - 0.5], -1)
    weights = 2 * np.pi * (weights * np.sin(theta) * cosine)[:, None] * legendre
    half, weights = (
        torch.as_tensor(a, dtype=m.dtype, device=m.device) for a in (0.5 * theta, weights)
    )
    return evaluate(m, half.cos(), half).T @ weights
