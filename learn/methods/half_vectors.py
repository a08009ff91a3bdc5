"""Samples of the integral in half-vector space, which follow narrow lobes about a pixel's normal.

    h_i = cos θ_i n + sin θ_i (cos φ_i t₁ + sin φ_i t₂),   w_i = 2 (v·h) h − v,   dω_i = 4 (v·h)
    dω_h

They lie on a spiral φ_i = i · golden angle whose radii θ_i follow the lobes' roots (equal shares of
√f's energy: a lobe's tail then has samples too, and midpoints are right to second order), so that
no lobe is too narrow. L is the mean over a sample's footprint, the square of its solid angle: the
sum then does not jump where a sample crosses a texel's border, and the error falls as 1/N instead
of N^−¾.

Sample directions are constants in the backward pass: I = Σ_i f(w_i, v, n) L(w_i) μ(w_i, n) dω_i is
differentiated with w_i and dω_i held (learn.engines.sample_derivatives does so, and
`chunk_radiance` in plain torch is its reference), which estimates the true derivative
∫ ∂(f μ) L dω; moving the samples with n instead would lose the jumps of L between texels.

N samples, p pixel, i sample, k channel, s lobe; shapes (p, i, k, s).
"""

import math

import numpy as np
import torch

from shaders.dsbrdf import MAX_EXPONENT, differentiable_half_angles
from shaders.spline import basis

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
# θ_h grid on which the lobes' energy is added up
RADII = np.concatenate([[0.0], np.geomspace(1e-5, np.pi / 2, 1024)])
THETA_D = np.linspace(0, np.pi / 2, 13)
WIDE = 3.0  # times a ring's inner radius: beyond, its sample lies where half of its solid angle is


def sample_radii(m: torch.Tensor, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Radii of the samples about the normal, and the solid angle of half vectors of each.

    m        (3, 3, 2, 6) with κ = 0 in lobes that do not count
    Returns  θ (N,) radians; dω_h (N,) sr, sums to 2π
    """
    curves = np.einsum("ksjb,ab->jksa", m.double().cpu().numpy(), basis(THETA_D)).reshape(2, -1, 1)
    kappa, gamma = curves[:, curves[0, :, 0] > 0]
    with np.errstate(divide="ignore", under="ignore"):
        log_c = np.log(np.maximum(np.cos(RADII), 1e-30))
        profile = (
            np.sqrt(np.expm1(np.minimum(kappa * np.exp(gamma * log_c), MAX_EXPONENT)))
            * np.sin(RADII)
            * np.cos(RADII)
        )
    step = np.diff(RADII) * 0.5
    energy = np.cumsum(np.pad((profile[:, 1:] + profile[:, :-1]) * step, ((0, 0), (1, 0))), axis=1)
    # each lobe counts alike, however little it reflects
    share = (energy / np.maximum(energy[:, -1:], 1e-300)).mean(0)
    share = 0.95 * share / share[-1] + 0.05 * np.sin(RADII) ** 2  # and the whole hemisphere is seen
    halves = np.interp(np.arange(2 * samples + 1) / (2 * samples), share, RADII)
    edges, middle = halves[::2], halves[1::2]
    # the ring at a lobe's foot is nearly all outside, where half of its energy is not half of it
    wide = edges[1:] > WIDE * edges[:-1]
    cosines = np.cos(edges)
    outer = np.arccos((cosines[1:] + cosines[:-1]) / 2)
    return np.where(wide, outer, middle), 2 * np.pi * -np.diff(cosines)


def spiral(m: torch.Tensor, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Half vectors (N, 3) about the z axis that follow m's lobes, and their solid angles (N,).

    m  (3, 3, 2, 6)
    """
    theta, solid_angle = sample_radii(m, samples)
    phi = GOLDEN_ANGLE * np.arange(samples)
    return (
        np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1),
        solid_angle,
    )


def place_samples(
    n: torch.Tensor,
    view: torch.Tensor,
    around: torch.Tensor,
    solid_angle: torch.Tensor,
    camera_from_light: torch.Tensor,
    size: tuple[int, int],
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The samples of each pixel: directions w (p, N, 3), weights dω_i (p, N) in sr, texels (p, N).

    n (p, 3), view (p | 1, 3), around (N, 3) samples about the z axis, solid_angle (N,) of half
    vectors, size (Hl, Wl); texels are flat indices into the light. Below the horizon the weight is
    0 and w is n, a direction where c and θ_d are finite.
    """
    h = torch.einsum("pab,ib->pia", frame_about(n), around)
    cos_d = (h * view[:, None]).sum(-1)
    w = torch.nn.functional.normalize(2 * cos_d[..., None] * h - view[:, None], dim=-1)
    seen = (cos_d > 0) & ((w * n[:, None]).sum(-1) > 0)
    weight = torch.where(seen, 4 * cos_d * solid_angle, 0.0)
    return (
        torch.where(seen[..., None], w, n[:, None]),
        weight,
        texel_of(w @ camera_from_light.to(w), *size),
    )


def chunk_radiance(
    n: torch.Tensor,
    view: torch.Tensor,
    m: torch.Tensor,
    light: torch.Tensor,
    around: torch.Tensor,
    solid_angle: torch.Tensor,
    camera_from_light: torch.Tensor,
) -> torch.Tensor:
    """Return radiance (p, 3) of a chunk of pixels by the samples of `place_samples`."""
    with torch.no_grad():
        w, weight, _ = place_samples(
            n, view, around, solid_angle, camera_from_light, (light.shape[0], light.shape[1])
        )
        texel, share = footprint(w @ camera_from_light.to(w), weight, *light.shape[:2])
    seen = torch.einsum("pic,pick->pik", share, light.reshape(-1, 3)[texel])
    mu = (w * n[:, None]).sum(-1) * weight
    return torch.einsum("pik,pi,pik->pk", reflectance(n, view, w, m), mu, seen)


def reflectance(
    n: torch.Tensor, view: torch.Tensor, w: torch.Tensor, m: torch.Tensor
) -> torch.Tensor:
    """The BRDF f (p, i, k) of each pixel in its own directions w (p, i, 3); view (p | 1, 3)."""
    h, theta_d = differentiable_half_angles(w, view[:, None])
    log_c = torch.log1p(-(0.5 * ((h - n[:, None]) ** 2).sum(-1)).clamp(max=0.999999))
    kappa, gamma = torch.einsum("pib,ksjb->jpiks", basis(theta_d), m)
    exponent = (kappa * torch.exp(gamma * log_c[..., None, None])).clamp(max=MAX_EXPONENT)
    return torch.expm1(exponent).sum(-1)


def footprint(
    w: torch.Tensor, solid_angle: torch.Tensor, height: int, width: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the texels under each sample's footprint, and the part of it in each.

    The footprint is the square of the solid angle, at most a texel wide each way.

    w (…, 3) light frame, solid_angle (…) sr
    Returns  texel (…, 4) flat indices; share (…, 4), sums to 1
    """
    side = solid_angle.sqrt()
    sine = torch.hypot(w[..., 0], w[..., 2])
    theta, phi = torch.atan2(sine, w[..., 1]), torch.atan2(w[..., 2], w[..., 0])
    row, below = border(theta * (height / math.pi), side * (height / math.pi))
    column, right = border(
        phi * (width / (2 * math.pi)), side * (width / (2 * math.pi)) / sine.clamp(min=1e-15)
    )
    # they end at the poles
    rows = torch.stack([row - 1, row - 1, row, row], -1).clamp(0, height - 1)
    columns = torch.stack([column - 1, column, column - 1, column], -1) % width
    share = torch.stack(
        [(1 - below) * (1 - right), (1 - below) * right, below * (1 - right), below * right], -1
    )
    return (rows * width + columns).long(), share


def border(x: torch.Tensor, width: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The nearest border k between texels, and the part of [x − width/2, x + width/2] beyond it.

    Texel k begins at x = k.
    """
    k = x.round()
    return k, ((x - k) / width.clamp(1e-15, 1.0) + 0.5).clamp(0, 1)


def frame_about(n: torch.Tensor) -> torch.Tensor:
    """Return rotations (p, 3, 3) that take z to n and turn smoothly with n (Duff et al. 2017)."""
    x, y, z = n.unbind(-1)
    sign = torch.where(z < 0, -1.0, 1.0).to(n.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    t1 = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    t2 = torch.stack([b, sign + y * y * a, -y], -1)
    return torch.stack([t1, t2, n], -1)


def texel_of(w: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Return the flat index of the texel that holds each direction w (..., 3), light frame.

    As shaders.envmap.texel, for tensors.
    """
    row = (
        (torch.atan2(torch.hypot(w[..., 0], w[..., 2]), w[..., 1]) * (height / math.pi))
        .floor()
        .clamp(0, height - 1)
    )
    column = (torch.atan2(w[..., 2], w[..., 0]) * (width / (2 * math.pi))).floor() % width
    return (row * width + column).long()
