"""`learn train-baselines`: makes what the comparison of Section 4.5 needs besides our weights."""

from __future__ import annotations

import argparse

from learn.commands import options
from manifests import RUNS
from manifests.help_format import HelpFormatter
from manifests.option_types import positive

PRESETS = {"baseline-1": "baseline-1-compact", "baseline-2": "baseline-2-compact"}

EPILOG = """example:
  python -m learn train-baselines --data geometry-data --out baselines"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "train-baselines",
        help="train the methods that the paper compares with",
        description=(
            "Makes the files of the methods that the paper compares itself with: fits the"
            " priors of the Lombardi-like method (seconds), and trains Baseline 1 and Baseline 2"
            " (an hour or so each on one processor core). Writes lombardi.safetensors,"
            " baseline-1.safetensors and baseline-2.safetensors into the folder, for `python -m"
            " learn evaluate --baselines DIR`. With --like, they train on the same split as"
            " weights that you have. Run the same command again to continue; what is finished is"
            " kept."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    options.add_data(parser)
    options.add_out(parser, "folder for the three files and for a folder per training")
    options.add_lights(parser)
    parser.add_argument(
        "--like",
        type=options.weights_file,
        metavar="FILE|NAME",
        help="hold out the lights that these weights' run held out (default: the presets')",
    )
    options.add_training_materials(parser, "as --like or the preset says")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=("lombardi", *PRESETS),
        default=("lombardi", *PRESETS),
        metavar="NAME",
        help="make only these (default: all three)",
    )
    parser.add_argument(
        "--steps",
        type=positive,
        metavar="N",
        help="steps of each training (default: as its preset says)",
    )
    options.add_training_processes(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    import torch

    from learn.baselines import training
    from learn.data import devices

    device = devices.choose(arguments.device)
    torch.set_num_threads(arguments.threads)
    for name in arguments.only:
        preset = None if name == "lombardi" else RUNS / f"{PRESETS[name]}.json"
        print(training.train_baseline(name, preset, arguments, device))
