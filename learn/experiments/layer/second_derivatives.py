"""Time second derivatives of the exact sum against first ones.

The picture is a sphere under a light map of 64 × 128 texels with lobes from matte to sharp, with
derivatives by n, material, light and view. Both cameras, in float32 (the kernels) and float64
(plain torch), on one thread, each in a process of its own; medians of processor seconds:

    forward   the picture
    backward  derivatives of a weighted sum of it, without a graph
    kept      the same with its graph kept
    second    derivatives of a weighted sum of those first derivatives
    memory    MiB by which the process grew with first derivatives, and from these to second ones
"""

from __future__ import annotations

import argparse

from learn.commands import options
from learn.experiments import runner

ROUNDS = {"float32": 9, "float64": 1}  # plain torch is slow, and varies little


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the size of the picture."""
    options.add_size(parser, 96)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"lights", "threads", "cases": {name: seconds of each pass, memory and ratio}}."""
    import json
    import subprocess
    import sys

    from manifests.progress import tqdm

    cases = {}
    todo = [(d, r, p) for d, r in ROUNDS.items() for p in (False, True)]
    for dtype, rounds, perspective in tqdm(todo, unit="case"):
        command = [sys.executable, "-m", "learn.experiments.layer.derivative_timing"]
        command += [dtype, str(int(perspective)), str(rounds), str(arguments.size)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        result = json.loads(done.stdout)
        name = f"{dtype}, {'view per pixel' if perspective else 'orthographic'}"
        cases[name] = result | {"second ÷ backward": result["second"] / result["backward"]}
    return {"lights": 64 * 128, "threads": 1, "cases": cases}


def tables(report: runner.Report) -> str:
    """Return seconds of each pass and the ratio of second to first derivatives."""
    phases = ("forward", "backward", "kept", "second")
    head = ["case", "pixels", *(f"{name}, s" for name in phases), "second ÷ backward"]
    rows = [
        [
            name,
            case["pixels"],
            *(f"{case[each]:.2f}" for each in phases),
            f"{case['second ÷ backward']:.2f}",
            ", ".join(f"{mib:.0f}" for mib in case["memory"]),
        ]
        for name, case in report["cases"].items()
    ]
    return (
        "# Second derivatives of the exact sum\n\n"
        f"{report['lights']} texels, {report['threads']} thread; the memory is what first"
        " derivatives add, and then what second ones add.\n\n"
        + runner.table([*head, "memory, MiB"], rows)
    )
