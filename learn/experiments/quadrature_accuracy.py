"""How near `quadrature` is to the converged integral under a sun in one texel, and how long it
takes, from broad lobes to narrow ones.

Converged is the picture of 16,384 taps; or, where lobes are broad enough that the method may sum
texels, the sum over texels split into so many of the same radiance that each is about a quarter of
what the lobe asks for, which leaves about a sixteenth of the error. How far that is itself from
converged is told by half of the taps, or of the texels' rows. That both are right is held in
tests/learn/test_integral.py, by a closed form and by texels integrated one by one.
"""

import functools
import math
import time

import torch
from tqdm import tqdm

from learn.experiments import chart_cases
from learn.layer import render
from learn.methods import quadrature

# 300: where taps take over from the sum over texels
GAMMAS = (0.01, 1.0, 30.0, 290.0, 310.0, 1.3e3, 5e3, 3e4, 1e5)
FINE, LESS_FINE = 1e-4, 4e-4  # tolerances: 16,384 and 8,192 taps
# exponent up to which a fine tolerance splits texels instead of placing taps
BY_TEXELS = quadrature.BROAD * max(quadrature.SPLITS) ** 2
ROUNDS = 3


def measure(tolerance, threads, gammas=GAMMAS, size=256):
    """Rows of γ, seconds (the best of ROUNDS, forward, on so many threads and on one) and errors:
    mean absolute over mean.
    """
    light = torch.as_tensor(chart_cases.computed_lights()["sun in a texel"]).float()[None]
    n, rows = chart_cases.sphere(size), []
    for gamma in tqdm(gammas, unit="lobe", desc="integral"):
        m = material(gamma)
        right, nearly = converged(n, m, light, gamma)
        level = right.mean()
        row = {"gamma": gamma, "converged to": ((nearly - right).abs().mean() / level).item()}
        for method in ("quadrature", "exact"):
            picture = render(n, m, light, method=method, tolerance=tolerance)
            row[method] = {"error": ((picture - right).abs().mean() / level).item()}
            for count in (threads, 1):
                work = functools.partial(render, n, m, light, method=method, tolerance=tolerance)
                row[method][f"seconds, threads: {count}"] = best(work, count)
        rows.append(row)
    return rows


def material(gamma):
    """(1, 108) of one lobe, κ = 1."""
    m = torch.tensor([0.0, 1.0])[:, None].repeat(3, 3, 1, 6)
    m[:, 1, 0], m[:, 1, 1] = 1.0, gamma
    return m.reshape(1, 108)


def converged(n, m, light, gamma):
    """The picture by the finest means, and by the next."""
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


def best(work, threads):
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    results = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        results.append(time.perf_counter() - start)
    torch.set_num_threads(before)
    return min(results)
