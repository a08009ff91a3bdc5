"""Time the exact sum by the layer's engine against the same sum in plain torch operators.

The scene is a sphere over 40 % of 256 × 256 pixels under a light map of 64 × 128 texels; forward
and backward, orthographic and with a view vector per pixel. The two take turns, and the figures
are medians, so that a busy machine slows both. Plain torch renders a part of the pixels, and its
time is scaled to all of them.
"""

from __future__ import annotations

import argparse

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

MATERIALS = ("beige-fabric", "blue-acrylic", "chrome")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the materials, thread counts, rounds and the pixels of plain torch."""
    parser.add_argument(
        "--material",
        action="append",
        metavar="NAME",
        help=f"a material of the catalogue; repeatable (default: {', '.join(MATERIALS)})",
    )
    parser.add_argument(
        "--threads",
        type=positive,
        nargs="+",
        default=[1, 2],
        metavar="N",
        help="thread counts (default: 1 2)",
    )
    options.add_count(parser, "--rounds", 5, "how often each is timed")
    options.add_count(
        parser,
        "--eager-pixels",
        96,
        "pixels that plain torch renders; the whole picture would take minutes",
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"settings", "rows": [learn.experiments.layer.engine_timing.Row as a dictionary]}."""
    import dataclasses

    from learn.experiments.layer import engine_timing

    settings = engine_timing.Settings(
        tuple(arguments.material or MATERIALS),
        tuple(arguments.threads),
        arguments.rounds,
        arguments.eager_pixels,
    )
    rows = [dataclasses.asdict(row) for row in engine_timing.time_rows(settings)]
    return {"settings": dataclasses.asdict(settings), "rows": rows}


def tables(report: runner.Report) -> str:
    """Return seconds of the engine, and ratios to it, for each case."""
    head = ["material", "camera", "task", "threads", "engine, s", "plain torch, s"]
    head += ["plain ÷ engine", "tuned ÷ engine", "by processor time"]
    names = ("torch, plain", "torch, tuned")
    rows = [
        [
            *(row[key] for key in ("material", "camera", "task", "threads")),
            f"{row['wall']['engine']:.3f}",
            f"{row['wall']['torch, plain']:.0f}",
            *(f"{row['ratio'][name]:.0f}" for name in names),
            " / ".join(f"{row['processor_ratio'][name]:.0f}" for name in names),
        ]
        for row in report["rows"]
    ]
    settings = report["settings"]
    return (
        "# The exact engine against plain torch\n\n"
        "One picture of 256 × 256, 40 % mask, 64 × 128 light, float32; medians of"
        f" {settings['rounds']} rounds in turns. Plain torch renders {settings['eager_pixels']} of"
        " the pixels, and its time is scaled to all of them. *Plain* is the general formula as"
        " `shaders.dsbrdf` writes it, *tuned* the same by log2 and exp2"
        " (`learn/experiments/layer/eager_sum.py`), both in chunks of the fastest size.\n\n"
        + runner.table(head, rows)
    )
