"""Time method="auto", forward and backward, for each material measured by MERL.

The sphere covers 40 % of 256 × 256 pixels; the light map has 64 × 128 texels. Each time is the
best of three, in seconds:

    wall     by the clock, for one picture (other programs on the machine add to it)
    cpu      of one thread that does all the work
    shared   by the clock, per picture of a batch of eight that share material and light
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import above_zero

if TYPE_CHECKING:
    import numpy as np

ROUNDS, BATCH = 3, 8
KINDS = ("wall", "cpu", "shared")
LIMITS_MS = (10, 30, 60, 150)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the tolerances, the materials, the light and the number of threads."""
    parser.add_argument(
        "--tolerance",
        type=above_zero,
        nargs="+",
        default=[1e-2, 1e-3],
        metavar="T",
        help="relative errors that are allowed (default: 0.01 0.001)",
    )
    options.add_count(parser, "--every", 1, "only each N-th material")
    parser.add_argument(
        "--light",
        default="lamps",
        metavar="NAME",
        help="sky, lamps, 'sun in a texel' or 'one texel' (default lamps)",
    )
    options.add_threads(parser)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"threads", "light", "tolerances": {tolerance: its counts, medians and rows}}."""
    from learn.experiments.layer import chart_cases
    from manifests import materials as catalogue

    light = chart_cases.lights(names=[arguments.light])[arguments.light]
    materials = list(catalogue.load_catalogue(catalogue.BUILT_IN[0]).items())[:: arguments.every]
    return {
        "threads": arguments.threads,
        "light": arguments.light,
        "tolerances": {
            f"{tolerance:g}": _summary(
                [
                    {"material": name} | _times(material.label, light, tolerance, arguments.threads)
                    for name, material in _progress(materials, tolerance)
                ]
            )
            for tolerance in arguments.tolerance
        },
    }


def _progress(materials: list, tolerance: float) -> Any:
    from manifests.progress import tqdm

    return tqdm(materials, desc=f"latency {tolerance:g}", unit="material", mininterval=2)


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    import statistics

    within = {
        f"{kind} within {ms} ms": sum(row[kind] <= ms / 1e3 for row in rows)
        for kind in KINDS
        for ms in LIMITS_MS
    }
    medians = {kind: statistics.median(row[kind] for row in rows) for kind in KINDS}
    return {"materials": len(rows), **within, "median seconds": medians, "rows": rows}


def _times(
    label: np.ndarray, light: np.ndarray, tolerance: float, threads: int
) -> dict[str, float]:
    """{kind: seconds} of one material."""
    import time

    import torch

    torch.set_num_threads(threads)
    wall = _best(label, light, tolerance, 1, time.perf_counter)
    shared = _best(label, light, tolerance, BATCH, time.perf_counter)
    torch.set_num_threads(1)
    cpu = _best(label, light, tolerance, 1, time.thread_time)
    return {"wall": wall, "cpu": cpu, "shared": shared / BATCH}


def _best(
    label: np.ndarray,
    light: np.ndarray,
    tolerance: float,
    images: int,
    clock: Callable[[], float],
) -> float:
    """The least seconds of ROUNDS, forward and backward, for so many equal pictures."""
    import torch

    from learn.experiments.layer import chart_cases
    from learn.layer import render

    m = torch.as_tensor(label, dtype=torch.float32).exp().reshape(1, 108)
    L = torch.as_tensor(light, dtype=torch.float32)[None]
    n = chart_cases.sphere(256).expand(images, -1, -1, -1).contiguous()
    by_picture, seconds = torch.ones_like(n), []
    for _ in range(ROUNDS):
        leaves = [x.detach().requires_grad_() for x in (n, m, L)]
        start = clock()
        picture = render(
            leaves[0],
            leaves[1].expand(images, -1),
            leaves[2].expand(images, -1, -1, -1),
            tolerance=tolerance,
        )
        torch.autograd.grad(picture, leaves, by_picture)
        seconds.append(clock() - start)
    return min(seconds)


def tables(report: runner.Report) -> str:
    """Return medians, and how many materials stay within each limit."""
    head = ["tolerance", "materials", "clock", "median, ms", *(f"≤ {ms} ms" for ms in LIMITS_MS)]
    rows = [
        [
            tolerance,
            result["materials"],
            kind,
            f"{1e3 * result['median seconds'][kind]:.1f}",
            *(result[f"{kind} within {ms} ms"] for ms in LIMITS_MS),
        ]
        for tolerance, result in report["tolerances"].items()
        for kind in KINDS
    ]
    return (
        '# Latency of method="auto", forward and backward\n\n'
        f"Light: {report['light']}; {report['threads']} threads, one for cpu. The columns on the"
        " right count materials.\n\n" + runner.table(head, rows)
    )
