"""The paper's sum in plain torch, as it is and compiled: two rivals of the chart's methods.

`torch` is the faster of the formulas of eager_sum; `torch.compile` is the other
one, whose elementwise operators the compiler merges. Both render a few evenly spaced pixels, and
their times are scaled to the whole picture, to which they are proportional.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import torch

from learn.experiments.layer import eager_sum
from learn.methods import Batch, exact
from learn.methods.directional import sample

CHUNK = 4  # pixels at a time: the fastest of 4, 16 and 64
PIXELS = 48
Result = TypeVar("Result")


@dataclass(frozen=True)
class Timed:
    """Seconds of a whole picture, and radiance (PIXELS, 3) at its pixels `pick` (PIXELS,)."""

    seconds: float
    forward: float
    pick: torch.Tensor
    radiance: torch.Tensor


@functools.cache
def formulas() -> dict[str, eager_sum.Formula]:
    """Return {method: formula}; without torch.compile where this machine has no compiler for it."""
    result: dict[str, eager_sum.Formula] = {"torch": eager_sum.tune}
    compiled = torch.compile(eager_sum.plain, dynamic=False)
    n, w = torch.tensor([[0.0, 0.0, 1.0]]).repeat(CHUNK, 1), torch.tensor([[0.0, 0.0, 1.0]])
    try:
        compiled(n, n, torch.ones(3, 3, 2, 6), torch.ones(1, 3), w)
    except Exception as error:  # whatever the compiler raises; its kinds depend on the version
        print(f"torch.compile is left out: {str(error).splitlines()[0]}")
        return result
    return result | {"torch.compile": compiled}


def time_formula(formula: eager_sum.Formula, batch: Batch) -> Timed:
    """Time a formula on a batch of one material under one light, forward and with backward."""
    pick = sample(len(batch.n), PIXELS)
    pick = pick[: len(pick) // CHUNK * CHUNK]  # compiled for whole chunks
    n = batch.n.detach()[pick].contiguous()
    view = torch.tensor([0.0, 0.0, 1.0]).expand_as(n)
    view = (view if batch.view is None else batch.view[pick]).contiguous()
    m = batch.m.detach().reshape(3, 3, 2, 6).float()
    w, energy = exact.texels(batch.light[0].detach(), batch.camera_from_light)
    inputs, g = (n, view, m, energy, w), torch.ones_like(n)
    both, _ = _time_once(lambda: eager_sum.forward_backward(formula, *inputs, g, CHUNK, False))
    forward, radiance = _time_once(lambda: eager_sum.forward(formula, *inputs, CHUNK))
    scale = len(batch.n) / len(pick)
    return Timed(scale * both, scale * forward, pick, radiance)


def _time_once(work: Callable[[], Result]) -> tuple[float, Result]:
    start = time.thread_time()
    result = work()
    return time.thread_time() - start, result
