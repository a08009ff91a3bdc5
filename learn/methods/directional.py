"""Sums over any set of directional lights: by the compiled kernels where they apply, else by torch.

T lights, P pixels, one material.
lights    `Lights` (learn/methods/light_tables.py)
E         (T, 3) radiance × solid angle
left_out  radiance that may be missing from a pixel in a channel: blocks of lights are skipped up to
          that

The kernels serve float32 on the CPU: for a distant viewer learn.engines.culled_sums by lists
(learn/methods/block_lists.py), for a view per pixel learn.engines.general, which leaves out nothing
that counts. Elsewhere `exact.ExactSum` serves.
"""

import functools
import math

import numpy as np
import torch

from learn.engines import cpu, machine_code
from learn.engines.derivatives import Context, Step, last
from learn.engines.layout import NEGLIGIBLE
from learn.engines.lights import cutoff, general_tables, unblocked
from learn.methods import lobe_shapes, refusal
from learn.methods.block_lists import ALL_LOBES, Listing, Tables
from learn.methods.exact import ExactSum
from learn.methods.light_tables import Lights, energy_blocks
from shaders.dsbrdf import MAX_EXPONENT

LARGEST_CONTROL = (MAX_EXPONENT,), (math.inf,)  # of κ and of γ
FEW_TEXELS = 512  # of a map of 16 × 32, up to which gradients are those of the whole sum
# pairs of a pixel and a light up to which a sum leaves nothing out: it takes no longer than a plan
# with its check
WHOLE = 2**19


def has_kernels(n: torch.Tensor) -> bool:
    """Return whether the kernels serve a tensor: float32 on the CPU, with numba installed."""
    return n.dtype == torch.float32 and n.device.type == "cpu" and machine_code.is_available()


def radiance(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    E: torch.Tensor,
    lights: Lights,
    left_out: float = 0.0,
    lobes: tuple[int, ...] = ALL_LOBES,
    method: str = "directional",
    negligible: float = NEGLIGIBLE,
) -> torch.Tensor:
    """Return radiance (P, 3) of some lobes of one material m (3, 3, 2, 6) under lights of energy E.

    It is differentiable in n, view, m and E; by the kernels once.
    negligible  for a view per pixel, as in learn.engines.lights.cutoff
    method  the name under which the kernels refuse second derivatives
    """
    if has_kernels(n) and view is None:
        return ListedSum.apply(n, m, E, lights, float(left_out), lobes, method)
    if lobes != ALL_LOBES:
        m = lobe_shapes.keep_lobes(m, np.isin(ALL_LOBES, lobes))
    if has_kernels(n) and view is not None:
        clamped = torch.minimum(m, m.new_tensor(LARGEST_CONTROL))
        return ViewedSum.apply(n, view.expand_as(n), clamped, E, lights, method, negligible)
    return ExactSum.apply(n, view, m, E, torch.as_tensor(lights.w, dtype=n.dtype, device=n.device))


def is_small(pixels: int, lights: int, with_gradients: bool = False) -> bool:
    """Whether a sum should be made whole: an approximation saves no time or spoils its gradients.

    Few texels are large ones. The factor max(0, n·w) of each has a corner where the texel rises
    over a pixel's horizon, which interpolation between normals and coarser lights misplace.
    """
    return pixels * lights <= WHOLE or (with_gradients and lights <= FEW_TEXELS)


def approximate_radiance(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    E: torch.Tensor,
    lights: Lights,
    error: float,
    method: str = "directional",
) -> torch.Tensor:
    """Return radiance (P, 3) of which each pixel may lack some.

    error  the part of the picture's mean radiance that it may lack
    """
    return radiance(
        n, view, m, E, lights, error * mean_radiance(n, view, m, E, lights), method=method
    )


def mean_radiance(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    E: torch.Tensor,
    lights: Lights,
    pixels: int = 32,
) -> float:
    """Return the mean radiance of evenly chosen pixels: the measure of errors."""
    with torch.no_grad():
        pick = sample(len(n), pixels, n.device)
        return radiance(n[pick], None if view is None else view[pick], m, E, lights).mean().item()


def sample(count: int, pixels: int, device: torch.device | None = None) -> torch.Tensor:
    """Return indices (pixels,) spread evenly over range(count), the same every time."""
    return torch.from_numpy(spread_indices(count, pixels)).to(device)


@functools.lru_cache(maxsize=64)
def spread_indices(count: int, pixels: int) -> np.ndarray:
    """As `sample`, in numpy; steps of the golden ratio fall into no pattern."""
    places = (np.arange(min(pixels, count)) * ((math.sqrt(5) - 1) / 2) + 0.5) % 1.0
    return np.unique((places * count).astype(np.int64))


class ListedSum(Step):
    """Radiance for a distant viewer by learn.engines.culled_sums.

    n (P, 3), m (3, 3, 2, 6), E (T, 3), Lights, left_out, numbers of lobes, a method's name → (P, 3)
    """

    @staticmethod
    def forward(
        ctx: Context,
        n: torch.Tensor,
        m: torch.Tensor,
        E: torch.Tensor,
        lights: Lights,
        left_out: float,
        lobes: tuple[int, ...],
        method: str,
    ) -> torch.Tensor:
        ctx.refusal = refusal(method)
        ctx.save_for_backward(n, m, E)
        _, by_m, by_E, *_ = ctx.needs_input_grad
        energy = energy_blocks(E.numpy().T, lights)
        tables = Tables(m.double().numpy(), energy, lights, by_E, lobes, by_m)
        ctx.listing = Listing(n.numpy(), tables, left_out)
        return torch.from_numpy(ctx.listing.radiance)

    @staticmethod
    @last
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        by_n, by_m, by_E = ctx.listing.backward(g.numpy())
        by_m = torch.from_numpy(by_m).float()
        return torch.from_numpy(by_n), by_m, torch.from_numpy(by_E.T.copy()), *[None] * 4


class ViewedSum(Step):
    """Radiance for a view per pixel by learn.engines.general, under all lights.

    n, view (P, 3), m (3, 3, 2, 6), E (T, 3), Lights, a method's name, negligible → (P, 3)
    """

    @staticmethod
    def forward(
        ctx: Context,
        n: torch.Tensor,
        view: torch.Tensor,
        m: torch.Tensor,
        E: torch.Tensor,
        lights: Lights,
        method: str,
        negligible: float,
    ) -> torch.Tensor:
        ctx.refusal = refusal(method)
        ctx.save_for_backward(n, view, m, E)
        energy = energy_blocks(E.numpy().T, lights)
        ctx.lights, ctx.energy, ctx.cut = lights, energy, cutoff(energy, negligible)
        normals, views = (np.ascontiguousarray(a.numpy()) for a in (n, view))
        radiance = cpu.general_forward(
            normals,
            views,
            lights.general_geometry,
            general_tables(m.double().numpy()),
            ctx.energy,
            ctx.cut,
            torch.get_num_threads(),
        )
        return torch.from_numpy(radiance)

    @staticmethod
    @last
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        n, view, m, _ = ctx.saved_tensors
        normals, views, gradient = (np.ascontiguousarray(a.numpy()) for a in (n, view, g))
        group = cpu.Group(normals, gradient, ctx.energy, ctx.cut, torch.get_num_threads())
        by_n, by_view, energy_sums, by_m = group.general(
            views,
            ctx.lights.general_geometry,
            general_tables(m.double().numpy()),
            ctx.needs_input_grad[1],
        )
        by_E = unblocked(energy_sums)[:, : len(ctx.lights.w)].T
        return (
            torch.from_numpy(by_n),
            torch.from_numpy(by_view) if ctx.needs_input_grad[1] else None,
            torch.from_numpy(np.ascontiguousarray(by_m)).float(),
            torch.from_numpy(by_E).float(),
            *[None] * 3,
        )
