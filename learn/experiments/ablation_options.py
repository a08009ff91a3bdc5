"""Options that the ablations of the layer, of normals, of losses and of the light share."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

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


def add_run(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the run that variants change, and their steps; `what` says what run it may be."""
    parser.add_argument(
        "--run",
        dest="run_name",
        default="general-compact",
        metavar="NAME|FILE.json",
        help=f"a preset of manifests/runs, or a run file, of {what} (default general-compact)",
    )
    parser.add_argument(
        "--steps", type=positive, default=600, metavar="N", help="of each variant (default 600)"
    )


def add_variants(parser: argparse.ArgumentParser, names: Iterable[str], reference: str) -> None:
    """Add which variants are trained; the reference must be among them."""
    parser.add_argument(
        "--variants",
        nargs="*",
        metavar="NAME",
        help=f'of {", ".join(names)}; "{reference}" must be among them (default: all)',
    )
