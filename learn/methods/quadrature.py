"""Half-vector quadrature: the integral over the piecewise-constant map, for lobes of any width.

The paper's sum evaluates a lobe once per texel, and is wrong by a factor where the lobe is
narrower. Here the sharpness of each lobe decides its strategy: broad ones take the exact sum over
texels, narrow ones take samples about the pixel's normal in half-vector space,

    h_i = cos θ_i n + sin θ_i (cos φ_i t₁ + sin φ_i t₂),   w_i = 2 (v·h) h − v,   dω_i = 4 (v·h)
    dω_h

on a spiral φ_i = i · golden angle whose radii θ_i follow the lobes' roots (equal shares of √f's
energy: a lobe's tail then has samples too, and midpoints are right to second order), so that no
lobe is too narrow. L is the mean over a sample's footprint, the square of its solid angle: the sum
then does not jump where a sample crosses a texel's border, and the error falls as 1/N instead of
N^−¾.

Where lobes are down to half a texel wide, texels are split into 2 × 2 of the same radiance: a
measured lobe of that width is often broad at another θ_d, where samples are too far apart to see a
lamp of one texel. Only texels at a θ_d where a lobe is that narrow are split (split_texels), which
is less than a tenth of them for many. The sum leaves out a tenth of the tolerance at most, except
where it is short. Narrower ones take texels split into 4 × 4 at small tolerances, or where
derivatives are requested and there are no kernels. Maps of few texels are too coarse for any lobe,
because the horizon cuts through texels: there all lobes take split texels or samples.

Sample directions are constants in the backward pass: I = Σ_i f(w_i, v, n) L(w_i) μ(w_i, n) dω_i is
differentiated with w_i and dω_i held (learn.engines.sample_directions does so, and `chunk` in plain
torch is its reference), which estimates the true derivative ∫ ∂(f μ) L dω; moving the
samples with n instead would lose the jumps of L between texels.

N samples, p pixel, i sample, k channel, s lobe; shapes (p, i, k, s).
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint

from learn.engines import cpu, lights, machine_code, threads
from learn.engines.derivatives import Context, Step, last, require_reverse_mode
from learn.engines.layout import (
    FOOTPRINT_ROWS,
    LANES,
    NEGLIGIBLE,
    SAMPLE_CHUNKS,
    SAMPLE_SCRATCH,
    SAMPLE_TILE,
    VALUES,
)
from learn.methods import (
    HELD_SAMPLES,
    Batch,
    Card,
    by_group,
    directional,
    first_only,
    load,
    per_group,
    refusal,
    split_texels,
    wants_gradient,
)
from learn.methods.exact import PAIRS
from shaders.dsbrdf import MAX_EXPONENT, differentiable_half_angles
from shaders.spline import basis

CARD = Card(
    name="quadrature",
    approximates=(
        "the integral: narrow lobes by samples that follow them, broad ones by the exact sum over"
        " texels"
    ),
    # no claim against the paper's sum, which is itself wrong there; 1e-2 against the integral
    error=None,
    cost=(
        "pixels × (texels if a lobe is broad + 256 to 1,024 samples if one is narrow), at tolerance"
        " 1e-2"
    ),
    memory=(
        "below 64 MiB at any size: chunks of pixels, computed again in the backward pass; with the"
        " gradient of light by kernels also twelve times the light's size, and that of split texels"
    ),
)
# exponent up to which the sum over 64 rows of texels is right to about 3e-3; twice the rows serve
# four times as much
BROAD = 300.0
SPLITS = (1, 2, 4)  # parts of a texel's side; beyond, samples
# parts of a texel's side up to which texels are split at any tolerance: samples that err as little
# take longer there
ALWAYS_SPLIT = 2
# times as many samples for lobes that texels of the finest split would serve: they hold more texels
WIDER = 2
# share of split texels beyond which broad lobes are summed by themselves over whole ones: measured
# on the 66 built-in materials with a lobe for texels split in two, and on both kinds of camera
JOINT = 0.15
# tolerance from which samples serve the band of the finest split too; below, they would need more
# time than split texels
LOOSE = 5e-3
# pairs of a pixel and a part of a texel up to which split texels are summed whole, and can be
# differentiated twice
SHORT = 2**19
LEFT_OUT = 0.1  # of the tolerance: what a sum over split texels may leave out
CULLED = "whose sums over split texels have first derivatives only"
LEAST, MOST = 256, 16384  # samples
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
# κ and γ: beyond, the rounding of the kernel's spline is negative exponents. The sharpest material
# has γ 1.2e6
LARGEST_IN_KERNEL = 1e7
# θ_h grid on which the lobes' energy is added up
RADII = np.concatenate([[0.0], np.geomspace(1e-5, np.pi / 2, 1024)])
THETA_D = np.linspace(0, np.pi / 2, 13)


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Outgoing radiance (P, 3) of a batch."""
    sharp = sharpness(batch.m.detach())
    rows = min(batch.light.shape[1], batch.light.shape[2] / 2)
    if not wants_gradient(batch.m):
        # lobes that reflect nothing are skipped
        sharp = torch.where(batch.m[..., 0, :].amax(-1) > 0, sharp, -1.0)
    # Without kernels, split texels are faster where derivatives are requested. Where all of it is
    # short, they stay the sum that can be differentiated twice.
    derivatives = wants_gradient(batch.n, batch.view, batch.m, batch.light)
    kernels = has_kernels(batch.n, batch.m) and batch.m.detach()[..., 0, :].max() <= MAX_EXPONENT
    pairs = len(batch.n) * batch.light.shape[1] * batch.light.shape[2]
    short = {split: pairs * split**2 <= SHORT for split in SPLITS}
    by_texels = tolerance < LOOSE or (derivatives and (short[SPLITS[-1]] or not kernels))
    splits = tuple(split for split in SPLITS if split <= ALWAYS_SPLIT or by_texels)
    limits, limit = [], -1.0
    for split in SPLITS:
        limit = broadest(split * rows, tolerance, limit)
        limits.append(limit)
    out = 0 * batch.n

    # a lobe whose channels lie on both sides of the limit has one strategy, not two
    widest, of_lobe = limits[len(splits) - 1], sharp.amax(-2, keepdim=True)
    sharp = torch.where((of_lobe > widest) & (sharp > widest / 2), of_lobe, sharp)

    in_texels = (sharp > -1.0) & (sharp <= widest)
    sharpest = torch.where(in_texels, sharp, -1.0).amax((-1, -2))  # of each group
    narrow = in_texels & (sharpest > limits[0])[:, None, None]
    whole = in_texels & ~narrow
    if whole.any():
        out = out + load("exact").radiance(replace(batch, m=keep(batch.m, whole)), tolerance)
    finest = splits[int(np.searchsorted(limits[: len(splits) - 1], sharpest.max().item()))]
    if narrow.any() and kernels and not short[finest]:
        out = out + per_group(
            first_only(replace(batch, m=keep(batch.m, narrow)), CARD.name, CULLED),
            functools.partial(
                over_split_texels,
                lobes=narrow,
                camera_from_light=batch.camera_from_light,
                limits=limits[: len(splits)],
                left_out=LEFT_OUT * tolerance,
            ),
        )
    elif narrow.any():
        for split, lower, upper in zip(splits[1:], limits, limits[1:], strict=False):
            groups = (sharpest > lower) & (sharpest <= upper)
            if (lobes := narrow & groups[:, None, None]).any():
                light = batch.light.repeat_interleave(split, 1).repeat_interleave(split, 2)
                split_map = replace(batch, m=keep(batch.m, lobes), light=light)
                out = out + load("exact").radiance(split_map, tolerance)

    samples = sample_count_for(tolerance)
    for lower, upper, times in (
        (widest, limits[-1], WIDER),
        (limits[-1], math.inf, 1),
    ):
        lobes = (sharp > lower) & (sharp <= upper)
        if lobes.any():
            count = min(samples * times, MOST)
            out = out + by_group(
                first_only(replace(batch, m=keep(batch.m, lobes)), CARD.name, HELD_SAMPLES),
                functools.partial(
                    over_samples, camera_from_light=batch.camera_from_light, samples=count
                ),
            )
    return out


def over_split_texels(
    group: int,
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    lobes: torch.Tensor,
    camera_from_light: torch.Tensor,
    limits: Sequence[float],
    left_out: float,
) -> torch.Tensor:
    """Radiance (p, 3) of one group by the sum over texels that are split where lobes are narrow.

    lobes     (G, 3, 3) bool that count, of each group
    limits    sharpness up to which texels of each of the first SPLITS serve
    left_out  part of the mean radiance that a pixel may lack: texels where lobes are faint are
              skipped

    Broad lobes take part in the same sum where few texels are split, and else have one of their own
    over whole texels.
    """
    here = lobes[group]
    if not here.any():
        return n * 0 + 0 * (m.sum() + light.sum() + (0 if view is None else view.sum()))
    rotation = camera_from_light.double().numpy()

    def parts_of(lobes: torch.Tensor) -> np.ndarray:
        return split_texels.parts_of_texels(
            m, lobes, view, (light.shape[0], light.shape[1]), rotation, limits, SPLITS
        )

    passes = [(here, parts_of(here))]
    if (passes[0][1] > 1).mean() > JOINT:
        broad = here & (sharpness(m.detach()) <= limits[0])
        passes = [(each, parts_of(each)) for each in (broad, here & ~broad) if each.any()]
    out = 0 * n
    for each, parts in passes:
        kept = keep(m, each)
        lights, energy = split_texels.lights_of(light, camera_from_light, parts)
        lacking = 0.0
        if view is None:
            lacking = left_out / len(passes) * directional.scale(n, None, kept, energy, lights)
        out = out + directional.radiance(
            n,
            view,
            kept,
            energy,
            lights,
            lacking,
            lobes=tuple(each.any(0).nonzero().flatten().tolist()),
            method=CARD.name,
            negligible=math.log2(max(left_out, 2.0**NEGLIGIBLE)),
        )
    return out


def broadest(rows: float, tolerance: float, otherwise: float) -> float:
    """Largest sharpness for which a sum over so many rows serves; `otherwise` if for none."""
    return BROAD * (rows / 64) ** 2 if rows >= least_rows(tolerance) else otherwise


def least_rows(tolerance: float) -> float:
    """Rows of a map (half its columns, if fewer) from which its sum serves broad lobes.

    The cosine has an edge at the horizon: however broad the lobe, the sum is wrong there by 0.5 /
    rows² of the mean under random maps of 3 to 16 rows. Below tolerance 1e-3 nothing is claimed.
    """
    return math.sqrt(0.55 / max(tolerance, 1e-3))


def sample_count_for(tolerance: float) -> int:
    """Number of samples for a tolerance, a power of two in [LEAST, MOST].

    The error falls about as 1 / samples; 2.5 is half of the worst trial's need.
    """
    return int(np.clip(2 ** math.ceil(math.log2(2.5 / tolerance)), LEAST, MOST))


def sharpness(m: torch.Tensor) -> torch.Tensor:
    """The sharpness of each lobe and channel (…, 3, 3): the largest γ · max(κ, 1) along its curves.

    It is 0.63 to 1 of the largest `lobe_sharpness`, since κ / (1 − e^−κ) is 1 to 1.58 times max(κ,
    1). BROAD is calibrated for it (docs/engines.md).
    """
    return split_texels.sharpness_along(m).amax(-1)


def keep(m: torch.Tensor, lobes: torch.Tensor) -> torch.Tensor:
    """m with no reflection (κ = 0) in all lobes but those marked (G, 3, 3).

    The others' γ is set high, so that engines skip them.
    """
    nothing = torch.tensor([0.0, 1e5], dtype=m.dtype, device=m.device)[:, None]
    return torch.where(lobes[..., None, None], m, nothing)


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


def over_samples(
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
    """One group's sums by learn.engines.sample_directions; arguments as `over_samples`.

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
    """`over_samples` by kernels, with derivatives by n, view, m and light.

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
        ctx.refusal = refusal(CARD.name, HELD_SAMPLES)
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
