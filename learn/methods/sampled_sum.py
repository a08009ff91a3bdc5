"""Sums over samples in half-vector space (learn.methods.half_vectors), by kernels or plain torch.

N samples, p pixels.
"""

import math
from typing import NamedTuple

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
from learn.methods import HELD_SAMPLES, half_vectors, refusal, wants_gradient
from learn.methods.exact import PAIRS
from shaders.dsbrdf import MAX_EXPONENT

METHOD = "quadrature"  # which refuses second derivatives by its name
# κ and γ: beyond, the rounding of the kernel's spline is negative exponents. The sharpest material
# has γ 1.2e6
LARGEST_IN_KERNEL = 1e7


class Samples(NamedTuple):
    """What is constant in a sum.

    camera_from_light  (3, 3)
    around             (N, 3) half vectors about the z axis
    solid_angle        (N,) of half vectors, in sr
    used               (3,) bool, lobes that reflect
    """

    camera_from_light: torch.Tensor
    around: np.ndarray
    solid_angle: np.ndarray
    used: np.ndarray


def radiance(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    camera_from_light: torch.Tensor,
    samples: int,
) -> torch.Tensor:
    """Return radiance (p, 3) of one group."""
    used = (m.detach()[..., 0, :] > 0).any(-1).any(0)
    if not used.any():
        return n * 0 + 0 * (m.sum() + light.sum() + (0 if view is None else view.sum()))
    around, solid_angle = half_vectors.spiral(m.detach()[:, used], samples)
    if has_kernels(n, m):
        chosen = Samples(camera_from_light, around, solid_angle, used.numpy())
        if wants_gradient(n, view, m, light):
            require_reverse_mode(n, view, m, light)
            return SampledSum.apply(n, view, m, light, chosen)
        return torch.from_numpy(Kernels(n, view, m, light, chosen).radiance())
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
                half_vectors.chunk_radiance,
                a,
                b,
                m,
                light,
                *constants,
                use_reentrant=False,
                preserve_rng_state=False,
            )
            for a, b in parts
        ]
    )


def has_kernels(n: torch.Tensor, m: torch.Tensor) -> bool:
    """Return whether learn.engines.sample_directions takes these tensors.

    Plain torch takes the others.
    """
    if n.dtype != torch.float32 or n.device.type != "cpu" or not machine_code.is_available():
        return False
    most = MAX_EXPONENT if torch.is_grad_enabled() and m.requires_grad else LARGEST_IN_KERNEL
    return bool(m.detach()[..., 0, :].max() <= most and m.detach().max() <= LARGEST_IN_KERNEL)


class Kernels:
    """One group's sums by learn.engines.sample_directions; arguments as `radiance`."""

    def __init__(
        self,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        light: torch.Tensor,
        samples: Samples,
    ):
        self.n, self.light, turn = (
            np.ascontiguousarray(x.detach().numpy(), np.float32)
            for x in (n, light, samples.camera_from_light)
        )
        self.view = np.ascontiguousarray(
            np.broadcast_to([0.0, 0.0, 1.0], self.n.shape)
            if view is None
            else view.detach().numpy(),
            np.float32,
        )
        around = samples.around
        rows = np.stack([*around.T, np.log2(np.maximum(around[:, 2], 1e-30)), samples.solid_angle])
        values, self.steps, smallest = lights.general_tables(m.detach().double().numpy())
        self.used = samples.used
        least = np.where(self.used, smallest, np.float32(1e9)).astype(np.float32)
        self.scene = lights.blocked(rows), values, least, turn.reshape(9), self.light
        self.sizes = len(around) // LANES, *self.light.shape[:2]
        self.workers = torch.get_num_threads()

    def radiance(self) -> np.ndarray:
        """Return radiance (p, 3)."""
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
                machine_code.call("sample_derivatives.backward", first, last, *sizes, *arrays)

            threads.run(run, threads.split(SAMPLE_CHUNKS, SAMPLE_CHUNKS), self.workers)
            if with_light:
                by_light += light_part.sum(0, dtype=np.float64)
            m_sums += m_part.sum(0, dtype=np.float64)
        by_m = lights.general_material_gradient(m_sums)
        by_m[:, ~self.used] = 0  # kernels skip blocks by lobe, and may add parts of those
        return by_n, by_view, by_m, by_light


class SampledSum(Step):
    """`radiance` by kernels, with derivatives by n, view, m and light.

    n, view (p, 3) or None, m (3, 3, 2, 6), light (Hl, Wl, 3), Samples → (p, 3)
    """

    @staticmethod
    def forward(
        ctx: Context,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        light: torch.Tensor,
        samples: Samples,
    ) -> torch.Tensor:
        ctx.refusal = refusal(METHOD, HELD_SAMPLES)
        ctx.save_for_backward(n, view, m, light)
        ctx.samples = samples
        return torch.from_numpy(Kernels(n, view, m, light, samples).radiance())

    @staticmethod
    @last
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        n, view, m, light = ctx.saved_tensors
        _, with_view, _, with_light, *_ = ctx.needs_input_grad
        kernels = Kernels(n, view, m, light, ctx.samples)
        by_n, by_view, by_m, by_light = kernels.gradients(
            g.detach().numpy().astype(np.float32), with_view, with_light
        )
        return (
            torch.from_numpy(by_n),
            torch.from_numpy(by_view) if with_view else None,
            torch.from_numpy(np.ascontiguousarray(by_m)).to(m.dtype),
            torch.from_numpy(by_light).to(light.dtype) if with_light else None,
            None,
        )
