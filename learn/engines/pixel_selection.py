"""Differentiable steps that select pixels from pictures and scatter values back.

learn.engines.pixels does it in float32 on the CPU, torch elsewhere.

vectors  (P, 3) normals or views of all pixels;  index (N,) places of the pixels that are seen

On the way to the kernels numpy does what torch could do too: torch's operators wake OpenMP's
threads for as few as 32,768 numbers, and these wait for more work spinning, in the way of the
kernels' own threads (docs/log.md, 2026-11-21).
"""

import numpy as np
import torch

from learn.engines import machine_code, threads
from learn.engines.derivatives import Context, Step, require_one_gradient
from learn.engines.layout import (
    SHORTEST,
)

PIXEL = 6e-9  # seconds that a kernel needs for each


def has_kernels(tensor: torch.Tensor) -> bool:
    """Whether the kernels apply; under torch.compile torch's own operators do."""
    right = tensor.dtype == torch.float32 and tensor.device.type == "cpu"
    return right and not torch.compiler.is_compiling() and machine_code.is_available()


def in_order(tensor: torch.Tensor) -> np.ndarray:
    """A tensor as a numpy array in C order."""
    return np.ascontiguousarray(tensor.numpy())


def run(name: str, count: int, *arguments: int | np.ndarray | None) -> None:
    """Run a kernel over range(count), on as many threads as torch may use."""
    workers = threads.worth(torch.get_num_threads(), count * PIXEL)
    threads.run(
        lambda first, last: machine_code.call(name, first, last, *arguments),
        threads.split(count, workers),
        workers,
    )


def states(
    n: torch.Tensor,
    view: torch.Tensor | None,
    mask: torch.Tensor | None,
    tolerance: float,
    horizon: float,
) -> np.ndarray:
    """State (P,) uint8 of each pixel (learn.engines.layout).

    n, view  (…, 3) float32; view may be None
    mask     (…) bool, or None
    """
    normals = in_order(n.detach())
    views, inside = (None if x is None else in_order(x.detach()) for x in (view, mask))
    limits = np.array([tolerance, horizon], np.float32)
    result = np.empty(normals.size // 3, np.uint8)
    run(
        "pixels.look",
        len(result),
        int(views is not None),
        int(inside is not None),
        normals,
        views,
        limits,
        inside,
        result,
    )
    return result


def unit(vectors: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Vectors (N, 3) at index, scaled to unit length."""
    if has_kernels(vectors):
        return Unit.apply(vectors, index)
    return torch.nn.functional.normalize(vectors.index_select(0, index), dim=-1)


def spread(radiance: torch.Tensor, index: torch.Tensor, pixels: int) -> torch.Tensor:
    """A picture (P, 3) with radiance (N, 3) at index and 0 elsewhere."""
    if has_kernels(radiance):
        return Spread.apply(radiance, index, pixels)
    return radiance.new_zeros(pixels, 3).index_copy(0, index, radiance)


class Unit(Step):
    """`unit` by the kernels."""

    @staticmethod
    def forward(ctx: Context, vectors: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(vectors, index)
        array, places = in_order(vectors), index.numpy()
        result, length = np.empty((len(places), 3), np.float32), np.empty(len(places), np.float32)
        run("pixels.unit", len(places), array, places, result, length)
        ctx.for_backward = places, result, length, len(array)
        return torch.from_numpy(result)

    @staticmethod
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor, None]:
        require_one_gradient(g)
        if torch.is_grad_enabled():
            return tangential(g, *ctx.saved_tensors), None
        places, result, length, pixels = ctx.for_backward
        by_vectors = np.zeros((pixels, 3), np.float32)
        run("pixels.unit_backward", len(places), places, result, length, in_order(g), by_vectors)
        return torch.from_numpy(by_vectors), None


def tangential(g: torch.Tensor, vectors: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Derivatives (P, 3) by the vectors from those by the unit vectors at index, in torch.

    They can be differentiated again.
    """
    picked = vectors.index_select(0, index)
    length = picked.norm(dim=-1, keepdim=True).clamp(min=SHORTEST)
    unit = picked / length
    return torch.zeros_like(vectors).index_copy(
        0, index, (g - (g * unit).sum(-1, keepdim=True) * unit) / length
    )


class Spread(Step):
    """`spread` by the kernels."""

    @staticmethod
    def forward(
        ctx: Context, radiance: torch.Tensor, index: torch.Tensor, pixels: int
    ) -> torch.Tensor:
        ctx.places = index.numpy()
        picture = np.zeros((pixels, 3), np.float32)
        run("pixels.spread", len(ctx.places), ctx.places, in_order(radiance), picture)
        return torch.from_numpy(picture)

    @staticmethod
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        require_one_gradient(g)
        if torch.is_grad_enabled():
            return g.index_select(0, torch.from_numpy(ctx.places)), None, None
        values = np.empty((len(ctx.places), 3), np.float32)
        run("pixels.pick", len(ctx.places), ctx.places, in_order(g), values)
        return torch.from_numpy(values), None, None
