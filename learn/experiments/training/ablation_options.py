"""Options that the ablations of the layer, of normals, of losses and of the light share."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from learn.commands import options
from manifests.option_types import above_zero


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
    options.add_count(parser, "--seeds", 3, "number of seeds")
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
    options.add_count(
        parser, "--batches", 12, "batches of 16 pictures that variants are measured on"
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
    options.add_count(parser, "--steps", 600, "of each variant")


def add_variants(parser: argparse.ArgumentParser, names: Iterable[str], reference: str) -> None:
    """Add which variants are trained; the reference must be among them."""
    parser.add_argument(
        "--variants",
        nargs="*",
        metavar="NAME",
        help=f'of {", ".join(names)}; "{reference}" must be among them (default: all)',
    )
