"""Second derivatives of the exact sum in plain torch, chunk by chunk.

They are the gradient of its derivative along a direction. Letters as in learn/methods/exact.py. A
second backward pass receives the derivatives n', view',
m', E' of some loss by the results of the first pass, which was given g. It differentiates what they
pair to,

    S = n'·∂n + view'·∂view + m'·∂m + E'·∂E = Σ_pk g_pk I'_pk,    I' the derivative of I along (n',
    view', m', E'),

    I'_k = Σ_t (f'_k μ + f_k μ') E_k + f_k μ E'_k       x' = c^γ κ' + x (γ' ln c + γ c'/c)      c' =
    h·n' + h'·n
    h' = (v' − h (h·v'))/|w + v|                        θ_d' = −(|w + v| d + |w − v| h)·v'/4    κ' =
    Σ_b B_b m'_b + θ_d' Σ_b Ḃ_b m_b

by g, n, view, m and E: I' is written out, its gradient is autograd's. Everything is summed in
float64, since second derivatives of a lobe grow as γ², and so does what rounding does to them.

The spline has a second derivative but at its knots, max(0, n·w) but on the horizon, min(κ c^γ,
MAX_EXPONENT) but where they meet: there one side's is taken. Where w = v, θ_d has a corner and its
second derivative no bound: it is left out within CORNER.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch

from learn.methods.exact import chunks, texels
from shaders.dsbrdf import MAX_EXPONENT, half_angles
from shaders.spline import basis, basis_slope

# by g, n, view (None without one), m and E
Derivatives = tuple[torch.Tensor, torch.Tensor, torch.Tensor | None, torch.Tensor, torch.Tensor]
PAIRS = 16384  # of one chunk; autograd keeps about 40 arrays of 9 × PAIRS numbers, 50 MB
CORNER = 1e-6  # length of w − v: radians between light and view


def second(
    direction: Sequence[torch.Tensor | None],
    g: torch.Tensor,
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    E: torch.Tensor,
    w: torch.Tensor,
    radial: bool,
) -> Derivatives:
    """Return gradients of S by g, n, view (None without one), m and E, in their shapes and dtypes.

    No graph is kept.

    direction  n' (P, 3), view' (P, 3) or None, m' (3, 3, 2, 6), E' (T, 3)
    radial     whether the first pass took ∂c/∂n = h, or else h − n. Both are right on the sphere;
               their difference, along n, does not pass through scaling to unit length, but that
               step's second derivative needs it
    """
    dtypes = [x.dtype for x in (g, n, m, E)]
    view_dtype = None if view is None else view.dtype
    g, n, m, E, w = (x.detach().double() for x in (g, n, m, E, w))
    view = None if view is None else view.detach().double()
    along_n, along_view, along_m, along_E = (
        torch.zeros(()) if x is None else x.detach().double() for x in direction
    )
    by_g, by_n, by_m, by_E = (torch.zeros_like(x) for x in (g, n, m, E))
    by_view = None if view is None else torch.zeros_like(view)
    for t, p in chunks(len(n), len(w), PAIRS):
        lit = (n[p] @ w[t].T > 0).any(0).nonzero().squeeze(-1)
        if not len(lit):
            continue
        lights = w[t][lit]
        with torch.enable_grad():
            leaves = [
                x.clone().requires_grad_()
                for x in (g[p], n[p], m, E[t][lit], *(() if view is None else (view[p],)))
            ]
            g_leaf, n_leaf, m_leaf, E_leaf, *view_leaf = leaves
            if view is None:
                half = distant_half(lights, m_leaf, along_m)
            else:
                half = turning_half(view_leaf[0], along_view[p], lights, m_leaf, along_m)
            change = derivative(n_leaf, E_leaf, lights, half, along_n[p], along_E[t][lit], radial)
            by = torch.autograd.grad((g_leaf * change).sum(), leaves)
        by_g[p] += by[0]
        by_n[p] += by[1]
        by_m += by[2]
        by_E[t].index_add_(0, lit, by[3])
        if by_view is not None:
            by_view[p] += by[4]
    by_g, by_n, by_m, by_E = (
        x.to(dtype) for x, dtype in zip((by_g, by_n, by_m, by_E), dtypes, strict=True)
    )
    return by_g, by_n, None if by_view is None else by_view.to(view_dtype), by_m, by_E


def of_groups(
    direction: Sequence[torch.Tensor | None],
    g: torch.Tensor,
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Sequence[float],
    counts: Sequence[int],
    light_of: Sequence[int],
) -> tuple[torch.Tensor | None, ...]:
    """As `second`, with radial=False, for the groups of a batch (arguments of learn.engines.cpu).

    Returns  derivatives by g, n, view, m (G, …) and light (B, …)
    """
    by_n, by_view, by_m, by_light = direction
    if by_m is None or by_light is None:
        raise ValueError("direction: expected tensors for m and light, found None")
    parts = [
        [None] * len(counts) if x is None else [*x.split(list(counts))]
        for x in (by_n, by_view, g, n, view)
    ]
    result: list[tuple] = []
    over_light = torch.zeros_like(light, dtype=torch.float64)
    camera_from_light = torch.tensor(rotation, dtype=torch.float64).reshape(3, 3)
    for k, (part_by_n, part_by_view, part_g, part_n, part_view) in enumerate(
        zip(*parts, strict=True)
    ):
        w, E = texels(light[light_of[k]].double(), camera_from_light)
        along_E = texels(by_light[light_of[k]].double(), camera_from_light)[1]
        by_g, by_n, by_view, group_by_m, by_E = second(
            (part_by_n, part_by_view, by_m[k], along_E),
            part_g,
            part_n,
            part_view,
            m[k],
            E,
            w,
            radial=False,
        )
        result.append((by_g, by_n, by_view, group_by_m))
        by_radiance = texels(by_E.reshape(light.shape[1:]), camera_from_light)[1]
        over_light[light_of[k]] += by_radiance.reshape(light.shape[1:])
    by_gs, by_ns, by_views, by_ms = zip(*result, strict=True)
    return (
        torch.cat(by_gs),
        torch.cat(by_ns),
        None if view is None else torch.cat(by_views),
        torch.stack(by_ms),
        over_light.to(light.dtype),
    )


class HalfChange(NamedTuple):
    """Half vectors, κ and γ of a chunk, and how they change along the direction.

    h, along_h (p|1, t, 3); curves, along_curves (2, p|1, t, 3, 3): κ and γ
    """

    h: torch.Tensor
    along_h: torch.Tensor
    curves: torch.Tensor
    along_curves: torch.Tensor


def distant_half(w: torch.Tensor, m: torch.Tensor, along_m: torch.Tensor) -> HalfChange:
    """Return the `HalfChange` for a distant viewer."""
    h, theta_d = half_angles(w[None], w.new_tensor([0.0, 0.0, 1.0]))
    B = basis(theta_d)
    return HalfChange(h, torch.zeros_like(h), curves(B, m), curves(B, along_m))


def turning_half(
    v: torch.Tensor, along_v: torch.Tensor, w: torch.Tensor, m: torch.Tensor, along_m: torch.Tensor
) -> HalfChange:
    """Return the `HalfChange` for a view v (p, 3) that changes along v' (p, 3)."""
    s, d = w + v[:, None], w - v[:, None]
    length_s = s.square().sum(-1, keepdim=True).clamp(min=1e-12).sqrt()  # w = −v is never lit
    square = d.square().sum(-1, keepdim=True)
    away = square > CORNER**2  # from the corner
    length_d = torch.where(away, square, 1.0).sqrt()
    h, d = s / length_s, torch.where(away, d / length_d, 0.0)
    length_d = torch.where(away, length_d, 0.0)
    v = along_v[:, None]
    along_h = (v - h * (h * v).sum(-1, keepdim=True)) / length_s
    along_theta = -0.25 * ((length_s * d + length_d * h) * v).sum(-1)
    theta_d = torch.atan2(length_d, length_s).squeeze(-1)
    B = basis(theta_d)
    return HalfChange(
        h,
        along_h,
        curves(B, m),
        curves(B, along_m) + curves(basis_slope(theta_d), m) * along_theta[..., None, None],
    )


def curves(B: torch.Tensor, m: torch.Tensor) -> torch.Tensor:
    """κ and γ (2, p, t, 3, 3) of m at the weights B (p, t, 6)."""
    return torch.einsum("ptb,ksjb->jptks", B, m)


def derivative(
    n: torch.Tensor,
    E: torch.Tensor,
    w: torch.Tensor,
    half: HalfChange,
    along_n: torch.Tensor,
    along_E: torch.Tensor,
    radial: bool,
) -> torch.Tensor:
    """I' (p, 3) of a chunk."""
    h, along_h, (kappa, gamma), (along_kappa, along_gamma) = half
    cosine = n @ w.T
    lit = cosine > 0
    mu, along_mu = torch.where(lit, cosine, 0.0), torch.where(lit, along_n @ w.T, 0.0)
    offset = h - n[:, None]
    # 1 − c, which is what a sharp lobe's peak needs
    gap = torch.where(lit, 0.5 * offset.square().sum(-1), 0.0).clamp(max=1 - 1e-12)
    c, log_c = (1 - gap)[..., None, None], torch.log1p(-gap)[..., None, None]
    along_c = ((h if radial else offset) * along_n[:, None] + along_h * n[:, None]).sum(-1)[
        ..., None, None
    ]
    power = torch.exp2(gamma * (log_c / math.log(2)))  # torch.exp is slow where it underflows
    x = kappa * power
    along_x = power * along_kappa + x * (log_c * along_gamma + gamma * (along_c / c))
    bounded = x < MAX_EXPONENT
    f = torch.expm1(x.clamp(max=MAX_EXPONENT))
    along_f = torch.where(bounded, (f + 1) * along_x, 0.0).sum(-1)
    f = f.sum(-1)
    return torch.einsum(
        "ptk,tk->pk", along_f * mu[..., None] + f * along_mu[..., None], E
    ) + torch.einsum("ptk,pt,tk->pk", f, mu, along_E)
