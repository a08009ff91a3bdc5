"""`learn train-baselines`: everything that the comparison of Section 4.5 needs besides our own
weights.
"""

from pathlib import Path

from learn.commands import device_option
from manifests import RUNS
from manifests.option_types import MATERIALS, positive, whole

PRESETS = {"baseline-1": "baseline-1-compact", "baseline-2": "baseline-2-compact"}


def register(subparsers):
    parser = subparsers.add_parser(
        "train-baselines",
        help="train the methods that the paper compares with",
        description=(
            "Fits the priors of the Lombardi-like method (seconds) and trains Baseline 1 and"
            " Baseline 2 (an hour or so each on one processor core), on the same data and the same"
            " split as weights that you have. Writes lombardi.safetensors, baseline-1.safetensors"
            " and baseline-2.safetensors into DIR: what `python -m learn evaluate --baselines DIR`"
            " reads. Run the same command again to continue; what is finished is kept."
        ),
    )
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        metavar="DIR",
        help="a dataset that `python -m factory render` wrote",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the three files and for a folder per training",
    )
    parser.add_argument(
        "--lights",
        type=Path,
        metavar="FILE.npz",
        help="further light maps, as arrays of shape (64, 128, 3)",
    )
    parser.add_argument(
        "--like",
        type=Path,
        metavar="WEIGHTS",
        help="hold out the lights that these weights' run held out (default: the presets')",
    )
    parser.add_argument(
        "--materials",
        choices=MATERIALS,
        help=(
            "the data set's own materials, or the built-in ones of MERL and RGL (default: as --like"
            " or the preset says)"
        ),
    )
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
    parser.add_argument(
        "--threads",
        type=positive,
        default=1,
        metavar="N",
        help="threads of the network (default 1)",
    )
    parser.add_argument(
        "--workers",
        type=whole,
        default=1,
        metavar="N",
        help="number of processes that relight (default 1; 0: relight in the training process)",
    )
    device_option.add(parser)
    parser.set_defaults(run=run)


def run(options):
    import torch

    from learn.baselines import training
    from learn.data import devices

    device = devices.choose(options.device)
    torch.set_num_threads(options.threads)
    for name in options.only:
        preset = None if name == "lombardi" else RUNS / f"{PRESETS[name]}.json"
        print(training.make(name, preset, options, device))
