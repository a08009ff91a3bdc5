"""Errors and seconds of quadrature against the converged integral (quadrature_accuracy).

The converged picture is that of 16,384 sample directions. Where lobes are so broad that the
method may sum texels, it is the sum over texels split into texels of the same radiance, each
about a quarter of what the lobe needs, which leaves about a sixteenth of the error. The distance
from convergence is estimated with half of the sample directions, or half of the texels' rows.
tests/learn/test_integral.py checks both by a closed form and by texels integrated one by one.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from typing import Any

import torch

from learn.experiments.layer import chart_cases
from learn.layer import render
from learn.methods import quadrature
from manifests.progress import tqdm

FINE, LESS_FINE = 1e-4, 4e-4  # tolerances: 16,384 and 8,192 sample directions
# exponent up to which a fine tolerance splits texels instead of placing sample directions
BY_TEXELS = quadrature.BROAD * max(quadrature.SPLITS) ** 2
ROUNDS = 3


def compare_lobes(
    tolerance: float, threads: int, gammas: tuple[float, ...], size: int
) -> list[dict[str, Any]]:
    """Return a row per lobe: γ, and seconds and error of both methods.

    Seconds are the best of ROUNDS, forward, on `threads` threads and on one; errors are mean
    absolute differences over the mean.
    """
    light = torch.as_tensor(chart_cases.computed_lights()["sun in a texel"]).float()[None]
    n, rows = chart_cases.sphere(size), []
    for gamma in tqdm(gammas, unit="lobe"):
        m = material(gamma)
        right, nearly = converge(n, m, light, gamma)
        level = right.mean()
        row: dict[str, Any] = {
            "gamma": gamma,
            "converged to": ((nearly - right).abs().mean() / level).item(),
        }
        for method in ("quadrature", "exact"):
            picture = render(n, m, light, method=method, tolerance=tolerance)
            row[method] = {"error": ((picture - right).abs().mean() / level).item()}
            for count in (threads, 1):
                work = functools.partial(render, n, m, light, method=method, tolerance=tolerance)
                row[method][f"seconds, threads: {count}"] = best(work, count)
        rows.append(row)
    return rows


def material(gamma: float) -> torch.Tensor:
    """Return the material (1, 108) of one lobe with κ = 1."""
    m = torch.tensor([0.0, 1.0])[:, None].repeat(3, 3, 1, 6)
    m[:, 1, 0], m[:, 1, 1] = 1.0, gamma
    return m.reshape(1, 108)


def converge(
    n: torch.Tensor, m: torch.Tensor, light: torch.Tensor, gamma: float
) -> list[torch.Tensor]:
    """Return the picture by the finest means, and by the next finest."""
    if gamma > BY_TEXELS:
        return [
            render(n, m, light, method="quadrature", tolerance=tolerance)
            for tolerance in (FINE, LESS_FINE)
        ]
    parts = 2 ** round(math.log2(4 * math.sqrt(max(gamma / quadrature.BROAD, 1.0))))
    return [
        render(n, m, light.repeat_interleave(k, 1).repeat_interleave(k, 2), method="exact")
        for k in (parts, parts // 2)
    ]


def best(work: Callable[[], object], threads: int) -> float:
    """Return the least seconds of ROUNDS; torch's number of threads is put back."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    results = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        results.append(time.perf_counter() - start)
    torch.set_num_threads(before)
    return min(results)
