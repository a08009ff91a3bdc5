"""The paper's sum itself, every texel for every pixel: the reference of all other methods.

    I_k(p) = Σ_t f_k(p, t) E_tk μ_pt        E = L Ω, μ = max(0, n·w)        supplement, Eq. 8
    f_k    = Σ_s expm1(x_ks),   x = min(κ c^γ, MAX_EXPONENT),   c = h·n

p pixel, t texel, k channel, s lobe, b spline control value. Arrays of one chunk are (p, t, k, s);
what depends on the texel alone (h, θ_d, κ and γ, when the viewer is distant) has a leading 1 in
place of p, so that both cameras run through the same lines.

The backward pass is derived by hand and computes each chunk again instead of storing it, so that
memory stays bounded. With g = ∂loss/∂I:

    ∂E_tk = Σ_p g f μ              ∂μ_pt = Σ_k g E f             A = g E μ exp(x)
    ∂κ = A c^γ                     ∂γ = A x ln c                 ∂ln c = Σ_ks A x γ,   ∂c/∂n = h
    ∂h/∂v = (1 − h hᵀ)/|w + v|     ∂θ_d/∂v = −(|w + v| d + |w − v| h)/4,   d = (w − v)/|w − v|

It is a step of its own, which learn/methods/exact_second.py differentiates.

The factor h of ∂c/∂n is missing in print, and ln c is needed only where c > 0
(tests/test_misprints.py).
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch

from learn.engines.derivatives import THIRD, Context, Step, require_one_gradient
from learn.methods import Batch, Card, radiance_by_group
from shaders.dsbrdf import MAX_EXPONENT, half_angles
from shaders.envmap import directions
from shaders.spline import basis, basis_slope

CARD = Card(
    name="exact",
    approximates="nothing: the paper's sum, texel by texel",
    error=0.0,
    cost="pixels × texels",
    memory=(
        "below 64 MiB at any size: chunks of 32,768 pixel–texel pairs, computed again in the"
        " backward pass"
    ),
)
LEAST_COSINE = 1e-12
# of one chunk; the largest temporary is 9 × PAIRS numbers, 2.4 MB in float64
TEXELS, PAIRS = 2048, 32768


def texels(
    light: torch.Tensor, camera_from_light: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return w (T, 3), camera frame, the direction of each texel, and E (T, 3).

    E is radiance × solid angle.

    light  (Hl, Wl, 3)
    """
    centres, areas = directions(*light.shape[:2])
    w = (torch.as_tensor(centres).reshape(-1, 3) @ camera_from_light.T).to(light)
    solid_angle = torch.as_tensor(areas, dtype=light.dtype, device=light.device)
    return w, (light * solid_angle[..., None]).reshape(-1, 3)


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    if batch.n.dtype == torch.float32:
        from learn.methods import exact_operator  # here: a process that never renders pays nothing

        if exact_operator.serves(batch):
            return exact_operator.radiance(batch)

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        w, E = texels(light, batch.camera_from_light)
        return ExactSum.apply(n, view, m, E, w)

    return radiance_by_group(batch, one_group)


class Half(NamedTuple):
    """All that depends on the half vector, with p|1 in place of p for a distant viewer.

    h, s = w + v, d = w − v (p|1, t, 3); θ_d (p|1, t); B (p|1, t, 6); κ and γ (p|1, t, 3, 3)
    """

    h: torch.Tensor
    s: torch.Tensor
    d: torch.Tensor
    theta_d: torch.Tensor
    B: torch.Tensor
    kappa: torch.Tensor
    gamma: torch.Tensor


def half(v: torch.Tensor, w: torch.Tensor, m: torch.Tensor) -> Half:
    """Return the `Half` of views v (p, 1, 3) or (1, 1, 3) and lights w (t, 3); m (3, 3, 2, 6)."""
    h, theta_d = half_angles(w[None], v)
    B = basis(theta_d)
    curves = torch.einsum("ptb,ksjb->jptks", B, m)
    return Half(h, w + v, w - v, theta_d, B, curves[0], curves[1])


class Lobes(NamedTuple):
    """The terms of f.

    μ, c, ln c (p, t); power c^γ, exponent κ c^γ before its bound (p, t, 3, 3); f (p, t, 3)
    """

    mu: torch.Tensor
    c: torch.Tensor
    log_c: torch.Tensor
    power: torch.Tensor
    exponent: torch.Tensor
    f: torch.Tensor


def lobes(n: torch.Tensor, w: torch.Tensor, at: Half) -> Lobes:
    """Return the BRDF of each pixel and texel; below the horizon μ is 0 and c is set to 1.

    n (p, 3), w (t, 3)
    """
    mu = (n @ w.T).clamp(min=0)
    # a map's node may look away from the viewer (learn/methods/reflectance_map.py): c is held above
    # 0 there
    c = torch.where(mu > 0, (at.h * n[:, None]).sum(-1).clamp(min=LEAST_COSINE), 1.0)
    # at a sharp lobe's peak 1 − c cancels: take it from |h − n|² there
    gap = 0.5 * ((at.h - n[:, None]) ** 2).sum(-1)
    near = torch.where((mu > 0) & (c > 0.5), gap, 0.0)
    log_c = torch.where(c > 0.5, torch.log1p(-near), torch.log(c))
    # torch.exp is slow where it underflows
    power = torch.exp2(at.gamma * (log_c / math.log(2))[..., None, None])
    exponent = at.kappa * power
    f = torch.expm1(exponent.clamp(max=MAX_EXPONENT)).sum(-1)
    return Lobes(mu, c, log_c, power, exponent, f)


def chunks(pixels: int, total: int, pairs: int = PAIRS) -> Iterator[tuple[slice, slice]]:
    """Return slices (of texels, of pixels) that cover all pairs, at most `pairs` at a time."""
    step = max(1, pairs // min(TEXELS, max(total, 1)))
    for t in range(0, total, TEXELS):
        for p in range(0, pixels, step):
            yield slice(t, t + TEXELS), slice(p, p + step)


class ExactSum(Step):
    """The sum, for autograd.

    n (P, 3), view (P, 3) or None, m (3, 3, 2, 6), E (T, 3), w (T, 3) constant → radiance (P, 3)
    """

    @staticmethod
    def forward(
        ctx: Context,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        E: torch.Tensor,
        w: torch.Tensor,
    ) -> torch.Tensor:
        ctx.save_for_backward(n, view, m, E, w)
        out = torch.zeros_like(n)
        for t, p, at in walk(view, m, w, len(n)):
            part = lobes(n[p], w[t], at)
            out[p] += torch.einsum("ptk,pt,tk->pk", part.f, part.mu, E[t])
        return out

    @staticmethod
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        require_one_gradient(g)
        return *ExactGradients.apply(g, *ctx.saved_tensors), None


class ExactGradients(Step):
    """The backward pass of `ExactSum`.

    g (P, 3), and the arguments of ExactSum → derivatives of Σ g·radiance by n, view (None without
    one), m and E
    """

    @staticmethod
    def forward(
        ctx: Context,
        g: torch.Tensor,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        E: torch.Tensor,
        w: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor | None, torch.Tensor, torch.Tensor]:
        ctx.save_for_backward(g, n, view, m, E, w)
        grad_n, grad_m, grad_E = torch.zeros_like(n), torch.zeros_like(m), torch.zeros_like(E)
        grad_view = None if view is None else torch.zeros_like(view)
        for t, p, at in walk(view, m, w, len(n)):
            part = lobes(n[p], w[t], at)
            grad_E[t] += torch.einsum("pk,ptk,pt->tk", g[p], part.f, part.mu)
            by_mu = torch.einsum("pk,tk,ptk->pt", g[p], E[t], part.f) * (part.mu > 0)
            bounded = part.exponent < MAX_EXPONENT
            A = (g[p][:, None] * E[t] * part.mu[..., None])[..., None] * torch.where(
                bounded, torch.exp(part.exponent), 0.0
            )
            by_c = (A * part.exponent * at.gamma).sum((-1, -2)) / part.c
            by_kappa = A * part.power
            by_gamma = A * part.exponent * part.log_c[..., None, None]
            grad_n[p] += by_mu @ w[t] + (by_c[..., None] * at.h).sum(1)
            if view is not None and grad_view is not None:
                by_theta = slopes(by_kappa, by_gamma, at, m)
                grad_view[p] += view_gradient(by_c, by_theta, n[p], part.c, at)
            curves = torch.stack(
                [by_kappa.sum_to_size(at.kappa.shape), by_gamma.sum_to_size(at.gamma.shape)]
            )
            grad_m += torch.einsum("jptks,ptb->ksjb", curves, at.B)
        return grad_n, grad_view, grad_m, grad_E

    @staticmethod
    def backward(ctx: Context, *direction: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        require_one_gradient(*direction)
        return *Second.apply(*direction, *ctx.saved_tensors), None


class Second(Step):
    """The backward pass of `ExactGradients`.

    Derivatives of a loss by its results, and its arguments → derivatives by g, n, view (or None), m
    and E
    """

    @staticmethod
    def forward(
        ctx: Context,
        by_n: torch.Tensor,
        by_view: torch.Tensor | None,
        by_m: torch.Tensor,
        by_E: torch.Tensor,
        g: torch.Tensor,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        E: torch.Tensor,
        w: torch.Tensor,
    ) -> tuple[torch.Tensor | None, ...]:
        from learn.methods.exact_second import second  # here: it is rarely needed

        return second((by_n, by_view, by_m, by_E), g, n, view, m, E, w, radial=True)

    @staticmethod
    def backward(ctx: Context, *g: torch.Tensor) -> None:
        raise NotImplementedError(THIRD)


def walk(
    view: torch.Tensor | None, m: torch.Tensor, w: torch.Tensor, pixels: int
) -> Iterator[tuple[slice, slice, Half]]:
    """Yield each chunk's texels, pixels and `Half`.

    A distant viewer's is computed once for all pixels.
    """
    distant = w.new_tensor([[[0.0, 0.0, 1.0]]])
    last: tuple[slice, Half] | None = None
    for t, p in chunks(pixels, len(w)):
        if view is not None:
            yield t, p, half(view[p][:, None], w[t], m)
        else:
            if last is None or last[0] != t:
                last = t, half(distant, w[t], m)
            yield t, p, last[1]


def slopes(
    by_kappa: torch.Tensor, by_gamma: torch.Tensor, at: Half, m: torch.Tensor
) -> torch.Tensor:
    """∂loss/∂θ_d (p, t) through κ(θ_d) and γ(θ_d)."""
    kappa_slope, gamma_slope = torch.einsum("ptb,ksjb->jptks", basis_slope(at.theta_d), m)
    return (by_kappa * kappa_slope + by_gamma * gamma_slope).sum((-1, -2))


def view_gradient(
    by_c: torch.Tensor, by_theta: torch.Tensor, n: torch.Tensor, c: torch.Tensor, at: Half
) -> torch.Tensor:
    """∂loss/∂v (p, 3) of a chunk, through h and θ_d.

    Where w = v the direction of d is undefined and θ_d has a corner: 0 is taken. Where w = −v
    nothing is lit.
    """
    length_s, length_d = at.s.norm(dim=-1), at.d.norm(dim=-1)
    unit_d = at.d / length_d.clamp(min=1e-12)[..., None]
    through_h = (n[:, None] - c[..., None] * at.h) * (by_c / length_s.clamp(min=1e-6))[..., None]
    through_theta = (length_s[..., None] * unit_d + length_d[..., None] * at.h) * (
        -0.25 * by_theta
    )[..., None]
    return (through_h + through_theta).sum(1)
