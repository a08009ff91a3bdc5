"""Samples of the integral in half-vector space, which follow narrow lobes about a pixel's normal.

    h_i = cos θ_i n + sin θ_i (cos φ_i t₁ + sin φ_i t₂),   w_i = 2 (v·h) h − v,   dω_i = 4 (v·h)
    dω_h

They lie on a spiral φ_i = i · golden angle whose radii θ_i follow the lobes' roots (equal shares of
√f's energy: a lobe's tail then has samples too, and midpoints are right to second order), so that
no lobe is too narrow. L is the mean over a sample's footprint, the square of its solid angle: the
sum then does not jump where a sample crosses a texel's border, and the error falls as 1/N instead
of N^−¾.

Sample directions are constants in the backward pass: I = Σ_i f(w_i, v, n) L(w_i) μ(w_i, n) dω_i is
differentiated with w_i and dω_i held (learn.engines.sample_directions does so, and `chunk` in plain
torch is its reference), which estimates the true derivative ∫ ∂(f μ) L dω; moving the
samples with n instead would lose the jumps of L between texels.

N samples, p pixel, i sample, k channel, s lobe; shapes (p, i, k, s).
"""

import math

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint

from learn.engines import cpu, lights, machine_code, threads
from learn.engines.derivatives import Context, Step, last, require_reverse_mode
from learn.engines.layout import (
    FOOTPRINT_ROWS,
    LANES,
    SAMPLE_CHUNKS,
    SAMPLE_SCRATCH,
    SAMPLE_TILE,
    VALUES,
)
from learn.methods import HELD_SAMPLES, refusal, wants_gradient
from learn.methods.exact import PAIRS
from shaders.dsbrdf import MAX_EXPONENT, differentiable_half_angles
from shaders.spline import basis

METHOD = "quadrature"  # which refuses second derivatives by its name
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
# κ and γ: beyond, the rounding of the kernel's spline is negative exponents. The sharpest material
# has γ 1.2e6
LARGEST_IN_KERNEL = 1e7
# θ_h grid on which the lobes' energy is added up
RADII = np.concatenate([[0.0], np.geomspace(1e-5, np.pi / 2, 1024)])
THETA_D = np.linspace(0, np.pi / 2, 13)


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
    edges = np.interp(np.arange(2 * samples + 1) / (2 * samples), share, RADII)
    return edges[1::2], 2 * np.pi * np.diff(-np.cos(edges[::2]))


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


def radiance(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    camera_from_light: torch.Tensor,
    samples: int,
) -> torch.Tensor:
    """Radiance (p, 3) of one group."""
    used = (m.detach()[..., 0, :] > 0).any(-1).any(0)
    if not used.any():
        return n * 0 + 0 * (m.sum() + light.sum() + (0 if view is None else view.sum()))
    around, solid_angle = spiral(m.detach()[:, used], samples)
    if has_kernels(n, m):
        rotation = camera_from_light.to(torch.float32)
        if wants_gradient(n, view, m, light):
            require_reverse_mode(n, view, m, light)
            return SampledSum.apply(n, view, m, light, rotation, around, solid_angle, used)
        return torch.from_numpy(
            Kernels(n, view, m, light, rotation, around, solid_angle, used).radiance()
        )
    m = m[:, used]
    constants = (
        *(torch.as_tensor(x, dtype=n.dtype, device=n.device) for x in (around, solid_angle)),
        camera_from_light,
    )
    step = max(1, PAIRS // samples)
    views = (
        view.split(step)
        if view is not None
        else [n.new_tensor([[0.0, 0.0, 1.0]])] * math.ceil(len(n) / step)
    )
    parts = zip(n.split(step), views, strict=True)
    return torch.cat(
        [
            checkpoint(
                chunk, a, b, m, light, *constants, use_reentrant=False, preserve_rng_state=False
            )
            for a, b in parts
        ]
    )


def has_kernels(n: torch.Tensor, m: torch.Tensor) -> bool:
    """Whether learn.engines.sample_directions takes these tensors; plain torch takes the others."""
    if n.dtype != torch.float32 or n.device.type != "cpu" or not machine_code.is_available():
        return False
    most = MAX_EXPONENT if torch.is_grad_enabled() and m.requires_grad else LARGEST_IN_KERNEL
    return bool(m.detach()[..., 0, :].max() <= most and m.detach().max() <= LARGEST_IN_KERNEL)


class Kernels:
    """One group's sums by learn.engines.sample_directions; arguments as `radiance`.

    used  (3,) lobes that reflect
    """

    def __init__(
        self,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        light: torch.Tensor,
        rotation: torch.Tensor,
        around: np.ndarray,
        solid_angle: np.ndarray,
        used: torch.Tensor,
    ):
        self.n, self.light, turn = (
            np.ascontiguousarray(x.detach().numpy(), np.float32) for x in (n, light, rotation)
        )
        self.view = np.ascontiguousarray(
            np.broadcast_to([0.0, 0.0, 1.0], self.n.shape)
            if view is None
            else view.detach().numpy(),
            np.float32,
        )
        rows = np.stack([*around.T, np.log2(np.maximum(around[:, 2], 1e-30)), solid_angle])
        values, self.steps, smallest = lights.general_tables(m.detach().double().numpy())
        self.used = used.numpy()
        least = np.where(self.used, smallest, np.float32(1e9)).astype(np.float32)
        self.scene = lights.blocked(rows), values, least, turn.reshape(9), self.light
        self.sizes = len(around) // LANES, *self.light.shape[:2]
        self.workers = torch.get_num_threads()

    def radiance(self) -> np.ndarray:
        """Radiance (p, 3)."""
        out = np.empty_like(self.n)

        def run(first: int, last: int) -> None:
            scratch = np.empty(LANES * FOOTPRINT_ROWS, np.float32)
            arrays = self.n, self.view, *self.scene, scratch, out
            machine_code.call(
                "sample_directions.forward", first, last, len(self.n), *self.sizes, *arrays
            )

        tiles = -(-len(self.n) // SAMPLE_TILE)
        threads.run(run, threads.split(tiles, 8 * self.workers), self.workers)
        return out

    def gradients(
        self, g: np.ndarray, with_view: bool, with_light: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of Σ g · radiance by n, view, m and light, those by n and view tangential.

        with_view, with_light  whether these are computed; they are 0 otherwise
        Pixels are worked through in slices of PASS, whose sums are added in float64.
        """
        by_n, by_view = np.empty_like(self.n), np.zeros_like(self.n)
        by_light, m_sums = np.zeros(self.light.shape), np.zeros(VALUES)
        around, values, least, turn, texels = self.scene
        scratch = np.empty(SAMPLE_CHUNKS * SAMPLE_SCRATCH, np.float32)
        for start in range(0, len(self.n), cpu.PASS):
            pixels = slice(start, start + cpu.PASS)
            n, g_here = self.n[pixels], np.ascontiguousarray(g[pixels])
            shape = (SAMPLE_CHUNKS, *self.light.shape) if with_light else (1,)
            light_part = np.zeros(shape, np.float32)
            m_part = np.empty((-(-len(n) // SAMPLE_TILE), VALUES), np.float32)
            sizes = len(n), *self.sizes, int(with_view), int(with_light)
            inputs = n, self.view[pixels], around, values, self.steps, least, turn, texels
            outputs = by_n[pixels], by_view[pixels], light_part, m_part

            def run(
                first: int,
                last: int,
                sizes: tuple[int, ...] = sizes,
                arrays: tuple[np.ndarray, ...] = (*inputs, scratch, g_here, *outputs),
            ) -> None:
                machine_code.call("sample_directions.backward", first, last, *sizes, *arrays)

            threads.run(run, threads.split(SAMPLE_CHUNKS, SAMPLE_CHUNKS), self.workers)
            if with_light:
                by_light += light_part.sum(0, dtype=np.float64)
            m_sums += m_part.sum(0, dtype=np.float64)
        by_m = lights.general_material_gradient(m_sums)
        by_m[:, ~self.used] = 0  # kernels skip blocks by lobe, and may add parts of those
        return by_n, by_view, by_m, by_light


class SampledSum(Step):
    """`radiance` by kernels, with derivatives by n, view, m and light.

    n, view (p, 3) or None, m, light, rotation (3, 3), samples, solid angles, used lobes → (p, 3)
    """

    @staticmethod
    def forward(
        ctx: Context,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        light: torch.Tensor,
        rotation: torch.Tensor,
        around: np.ndarray,
        solid_angle: np.ndarray,
        used: torch.Tensor,
    ) -> torch.Tensor:
        ctx.refusal = refusal(METHOD, HELD_SAMPLES)
        ctx.save_for_backward(n, view, m, light)
        ctx.constants = rotation, around, solid_angle, used
        return torch.from_numpy(Kernels(n, view, m, light, *ctx.constants).radiance())

    @staticmethod
    @last
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        n, view, m, light = ctx.saved_tensors
        _, with_view, _, with_light, *_ = ctx.needs_input_grad
        kernels = Kernels(n, view, m, light, *ctx.constants)
        by_n, by_view, by_m, by_light = kernels.gradients(
            g.detach().numpy().astype(np.float32), with_view, with_light
        )
        return (
            torch.from_numpy(by_n),
            torch.from_numpy(by_view) if with_view else None,
            torch.from_numpy(np.ascontiguousarray(by_m)).to(m.dtype),
            torch.from_numpy(by_light).to(light.dtype) if with_light else None,
            *[None] * 4,
        )


def place(
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


def chunk(
    n: torch.Tensor,
    view: torch.Tensor,
    m: torch.Tensor,
    light: torch.Tensor,
    around: torch.Tensor,
    solid_angle: torch.Tensor,
    camera_from_light: torch.Tensor,
) -> torch.Tensor:
    """Radiance (p, 3) of a chunk of pixels by the samples of `place`."""
    with torch.no_grad():
        w, weight, _ = place(
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
    """The texels under each sample's footprint, and the part of it in each.

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
    """Rotations (p, 3, 3) that take z to n and turn smoothly with n (Duff et al. 2017)."""
    x, y, z = n.unbind(-1)
    sign = torch.where(z < 0, -1.0, 1.0).to(n.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    t1 = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    t2 = torch.stack([b, sign + y * y * a, -y], -1)
    return torch.stack([t1, t2, n], -1)


def texel_of(w: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Flat index of the texel that holds each direction w (..., 3), light frame.

    As shaders.envmap.texel, for tensors.
    """
    row = (
        (torch.atan2(torch.hypot(w[..., 0], w[..., 2]), w[..., 1]) * (height / math.pi))
        .floor()
        .clamp(0, height - 1)
    )
    column = (torch.atan2(w[..., 2], w[..., 0]) * (width / (2 * math.pi))).floor() % width
    return (row * width + column).long()
