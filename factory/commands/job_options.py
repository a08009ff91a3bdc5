"""Options that `plan` and `render` share: processes, device, and where a job's assets are."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from manifests.errors import InputError
from manifests.option_types import above_zero, positive

if TYPE_CHECKING:
    from factory.planning.assets import Assets
    from manifests.schema import Job

DEVICES = ("auto", "cpu", "cuda", "optix", "hip", "metal", "oneapi")


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options to a parser."""
    parser.add_argument(
        "--workers",
        type=positive,
        default=1,
        metavar="N",
        help="number of processes that render (default 1, which uses all CPU threads)",
    )
    parser.add_argument(
        "--device",
        default="auto",
        choices=DEVICES,
        help="where Cycles renders (default auto: a GPU if Cycles can use one, else cpu)",
    )
    parser.add_argument(
        "--assets",
        metavar="DIR",
        help="the folder that a job's relative paths start from (default: the job file's folder)",
    )
    parser.add_argument(
        "--lights",
        metavar="DIR",
        help="a folder of your own light maps, which the job may then name",
    )
    parser.add_argument(
        "--catalogue",
        action="append",
        default=[],
        metavar="FILE",
        help="a catalogue of materials to add to the built-in ones; repeat the option for several",
    )


def add_error(parser: argparse.ArgumentParser) -> None:
    """Add --error, which replaces the limit that the job file sets."""
    parser.add_argument(
        "--error",
        type=above_zero,
        metavar="E",
        help=(
            "the largest error that a picture may have (display L2 over the object, noise and bias"
            " together). Each picture then gets as many samples as that takes (default: no limit;"
            " every picture gets the number of samples that the job states)"
        ),
    )


def with_error(job: Job, options: argparse.Namespace) -> Job:
    """Return the job with the error that --error names, if it names one. Raises InputError."""
    from msgspec import structs

    from manifests.schema import LARGEST_ERROR

    if options.error is None:
        return job
    if options.error > LARGEST_ERROR:
        raise InputError(
            "--error",
            f"a display L2 above 0, at most {LARGEST_ERROR}",
            f"{options.error:g}",
            "write --error 5",
        )
    return structs.replace(job, error=options.error)


def resolve_assets(job: Job, folder: str | Path | None, options: argparse.Namespace) -> Assets:
    """Return the job's assets, all shapes read; a progress bar shows where this takes long.

    folder  where the job's relative paths start, None: paths may lead anywhere
    """
    from functools import partial

    from factory.planning.assets import resolve
    from manifests.progress import tqdm
    from manifests.subprocesses import processors

    watch = partial(tqdm, leave=False, delay=1.0)
    return resolve(job, folder, options.lights, options.catalogue, watch, processors())
