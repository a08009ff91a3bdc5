"""Options that several commands and experiments share, each defined once."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from learn.networks import built_in_weights
from manifests.option_types import MATERIALS, positive, whole
from manifests.training_runs import LAYER_METHODS

# where options can be added: a parser, or a group of its options
ParserOrGroup = argparse.ArgumentParser | argparse._ArgumentGroup

# what learn.data.devices.choose takes; to import that would load torch
DEVICES = ("auto", "cpu", "cuda")
WEIGHTS_FOLDER = built_in_weights.FOLDER
EDITING_WEIGHTS = built_in_weights.EDITING
TABLE_WEIGHTS = WEIGHTS_FOLDER / "joint-compact.safetensors"  # of the published figures
DATA = "a data set that `python -m factory render` wrote"


def add_data(parser: argparse.ArgumentParser, what: str = DATA) -> None:
    """Add --data DIR, a data set; `what` says in the help what it must hold."""
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help=what)


def add_scenes(parser: argparse.ArgumentParser) -> None:
    """Add --scenes and --after, which choose scenes of a folder of rooms by their numbers."""
    parser.add_argument(
        "--scenes", type=positive, metavar="N", help="number of scenes (default: all)"
    )
    parser.add_argument(
        "--after",
        type=whole,
        default=0,
        metavar="N",
        help="number of scenes to skip before these (default 0)",
    )


def add_out(
    parser: argparse.ArgumentParser, what: str = "folder for the results; other files in it stay"
) -> None:
    """Add --out DIR, the folder that the command writes into."""
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help=what)
    parser.set_defaults(result_folders=("out",))


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Add --overwrite, without which earlier results in --out are refused."""
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help=(
            "allow replacing earlier results in the folder. Files that an earlier run wrote and"
            " this one does not are removed, unless you have changed them"
        ),
    )


def add_lights(
    parser: argparse.ArgumentParser,
    what: str = (
        "further light maps: an .npz of arrays of shape (64, 128, 3), or a folder that"
        " `python -m factory lights make` filled"
    ),
) -> None:
    """Add --lights, light maps besides those of the data set."""
    parser.add_argument("--lights", type=Path, metavar="FILE.npz|DIR", help=what)


def add_weights(parser: ParserOrGroup, default: Path = EDITING_WEIGHTS) -> None:
    """Add --weights FILE|NAME; default: a file of WEIGHTS_FOLDER."""
    parser.add_argument(
        "--weights",
        type=weights_file,
        default=default,
        metavar="FILE|NAME",
        help=(
            f"the network to use (default: {default.stem}): weights.safetensors of a training run,"
            " or the name of weights that come with the program. general-compact is for photographs"
            " and any object; joint-compact, behind most published figures, knows chairs, sofas,"
            " cars and monitors from one elevation; general-two-encoders predicts better normals"
            " than general-compact, but its edits are no better"
        ),
    )


def weights_file(text: str) -> Path:
    """Return the path of a weights file, or of the program's own weights of that name."""
    own = WEIGHTS_FOLDER / f"{text}.safetensors"
    return own if Path(text).name == text and os.path.exists(own) else Path(text)


def add_count(
    parser: argparse.ArgumentParser, name: str, default: int, what: str, least: int = 1
) -> None:
    """Add an option that takes a whole number; its help is `what` and the default.

    least  the smallest number that is accepted: 1 or 0
    """
    parser.add_argument(
        name,
        type=positive if least else whole,
        default=default,
        metavar="N",
        help=f"{what} (default {default})",
    )


def add_refinement_method(parser: ParserOrGroup) -> None:
    """Add --refinement-method, one of LAYER_METHODS; None if it is not given."""
    parser.add_argument(
        "--refinement-method",
        choices=LAYER_METHODS,
        help=(
            "how refinement renders: auto (default) sums over the texels of the light map;"
            " quadrature integrates between them, which is more accurate for narrow highlights and"
            " slower"
        ),
    )


def add_exposure(parser: ParserOrGroup, picture: str) -> None:
    """Add --exposure X; `picture` is what the help calls the picture."""
    parser.add_argument(
        "--exposure",
        type=float,
        metavar="X",
        help=(
            f"the factor by which to multiply the {picture}'s linear values before the network sees"
            " them; a larger X makes edits darker (default: estimated)"
        ),
    )


def add_materials(
    parser: argparse.ArgumentParser, what: str, default: str | None = "dataset"
) -> None:
    """Add --materials dataset|built-in; `what` says which materials, and what the default is."""
    parser.add_argument("--materials", choices=MATERIALS, default=default, help=what)


def add_seed(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --seed N, of which 0 is the default."""
    parser.add_argument("--seed", type=whole, default=0, metavar="N", help=f"{what} (default 0)")


def add_threads(
    parser: argparse.ArgumentParser, what: str = "number of threads", default: int = 2
) -> None:
    """Add --threads N."""
    parser.add_argument(
        "--threads", type=positive, default=default, metavar="N", help=f"{what} (default {default})"
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add --workers N, processes that relight pictures for the training process."""
    parser.add_argument(
        "--workers",
        type=whole,
        default=1,
        metavar="N",
        help="number of processes that relight (default 1; 0: relight in the training process)",
    )


def add_training_materials(parser: argparse.ArgumentParser, default: str) -> None:
    """Add --materials to a command that trains; `default` says in the help what None means."""
    what = "the data set's own materials, or the built-in ones of MERL and RGL"
    add_materials(parser, f"{what} (default: {default})", default=None)


def add_training_processes(parser: argparse.ArgumentParser) -> None:
    """Add --threads, --workers and --device to a command that trains."""
    what = "threads of the network; relighting runs in a process of its own"
    add_threads(parser, what, default=1)
    add_workers(parser)
    add_device(parser)


def add_ray(parser: argparse.ArgumentParser) -> None:
    """Add --ray ADDRESS, the cluster that measures."""
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help=(
            "measure on all CPUs of the Ray cluster at HOST:PORT, which shares the folders, with"
            " one thread each; or auto: on the cluster that this machine belongs to, or else on a"
            " new one here (extra ray)"
        ),
    )


def require_cpu(arguments: argparse.Namespace) -> None:
    """Raise InputError for --ray with a --device other than the CPU: workers use only CPUs."""
    from manifests.errors import InputError

    if arguments.ray is not None and arguments.device not in ("auto", "cpu"):
        remedy = "leave one of them out: --ray uses CPUs"
        raise InputError("--ray", "no --device", f"--device {arguments.device}", remedy)


def add_allow_overlap(parser: argparse.ArgumentParser) -> None:
    """Add --allow-overlap, without which pictures of what weights saw in training are refused."""
    parser.add_argument(
        "--allow-overlap",
        action="store_true",
        help=(
            "measure even if the weights saw some of the tested shapes, materials or lights in"
            " training; the report then says so at its top"
        ),
    )


def add_size(parser: argparse.ArgumentParser, default: int) -> None:
    """Add --size PIXELS, the side of square pictures."""
    parser.add_argument(
        "--size",
        type=positive,
        default=default,
        metavar="PIXELS",
        help=f"side of the pictures in pixels (default {default})",
    )


def add_device(parser: ParserOrGroup) -> None:
    """Add --device; arguments.device is then one of DEVICES."""
    parser.add_argument(
        "--device",
        choices=DEVICES,
        default="auto",
        help=(
            "where the networks and the rendering layer run (default auto: cuda if torch sees a"
            " CUDA device, else cpu)"
        ),
    )
