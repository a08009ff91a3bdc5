"""Options that layer_ablation, normals_ablation and objective_ablation share."""

from __future__ import annotations

import argparse

from learn.commands import options
from manifests.option_types import above_zero, positive


def add(parser: argparse.ArgumentParser, seconds: float) -> None:
    """Add the data, the pictures, the time of each variant (by default `seconds`) and the seeds."""
    options.add_data(parser)
    options.add_lights(parser)
    options.add_size(parser, 64)
    parser.add_argument(
        "--seconds",
        type=above_zero,
        default=seconds,
        metavar="S",
        help=f"processor time of each variant (default {seconds:g})",
    )
    parser.add_argument(
        "--seeds", type=positive, default=3, metavar="N", help="number of seeds (default 3)"
    )
    add_batches(parser)
    parser.add_argument(
        "--held-out",
        nargs="*",
        default=[],
        metavar="LIGHT",
        help="names of light maps that only testing sees",
    )
    options.add_workers(parser)


def add_batches(parser: argparse.ArgumentParser) -> None:
    """Add the number of batches that variants are measured on."""
    parser.add_argument(
        "--batches",
        type=positive,
        default=12,
        metavar="N",
        help="batches of 16 pictures that variants are measured on (default 12)",
    )
