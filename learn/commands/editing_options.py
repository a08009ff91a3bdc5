"""Options that the commands `edit` and `transfer` share."""

import argparse
from pathlib import Path

from learn.commands import device_option

LARGEST_FACTOR = 100  # of a white balance


def add(parser):
    """Adds them to a parser."""
    parser.add_argument(
        "--refine",
        action=argparse.BooleanOptionalAction,
        default=True,
        help=(
            "adjust the predicted normals, light and material until their rendering looks like the"
            " photograph (default: yes); --no-refine saves some seconds per photograph"
        ),
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-2,
        metavar="T",
        help="relative error allowed in rendering (default 0.01)",
    )
    parser.add_argument(
        "--detail",
        type=float,
        default=0.25,
        metavar="D",
        help=(
            "share of the photograph's fine shading that is kept, from 0 to 1 (default 0.25); it"
            " includes fine highlights"
        ),
    )
    parser.add_argument(
        "--exposure",
        type=float,
        metavar="X",
        help=(
            "multiply the photograph by X to get radiance (default: estimated from the object's"
            " brightness)"
        ),
    )
    parser.add_argument(
        "--white-balance",
        default="none",
        metavar="W",
        help=(
            "none: leave the colours as they are (default); grey: make the background grey on"
            " average; or three factors R,G,B"
        ),
    )
    parser.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help=(
            "weights.safetensors of a training run (default: the weights that come with the"
            " program)"
        ),
    )
    device_option.add(parser)
    parser.add_argument(
        "--overwrite", action="store_true", help="replace earlier results in the folder"
    )


def edit_options(options):
    """learn.editing.edit.EditOptions of parsed options. Raises InputError."""
    from learn.data import devices
    from learn.editing.edit import EditOptions
    from learn.editing.predict import WEIGHTS
    from learn.refinement import RefinementSettings

    check(
        "--tolerance", 0 < options.tolerance < 1, "a number above 0 and below 1", options.tolerance
    )
    check("--detail", 0 <= options.detail <= 1, "a number from 0 to 1", options.detail)
    check_exposure(options.exposure)
    settings = RefinementSettings() if options.refine else None
    balance = balance_of(options.white_balance)
    device = devices.choose(options.device)
    return EditOptions(
        options.weights or WEIGHTS,
        settings,
        options.tolerance,
        options.detail,
        options.exposure,
        balance,
        device,
    )


def check_exposure(value):
    """Raises InputError for a factor that is not above 0 and finite; None: none was given."""
    if value is not None:
        check("--exposure", 0 < value < float("inf"), "a number above 0", value)


def check(name, holds, rule, value):
    """Raises InputError where a rule does not hold of an option's value."""
    from manifests.errors import InputError

    if not holds:
        raise InputError(name, rule, f"{value:g}", "see --help")


def balance_of(text):
    """ "none", "grey", or three positive factors."""
    from manifests.errors import InputError

    if text in ("none", "grey"):
        return text
    try:
        factors = tuple(float(part) for part in text.split(","))
        if len(factors) == 3 and all(1 / LARGEST_FACTOR <= f <= LARGEST_FACTOR for f in factors):
            return factors
    except ValueError:
        pass
    raise InputError(
        "--white-balance",
        f"none, grey, or three factors from {1 / LARGEST_FACTOR:g} to {LARGEST_FACTOR:g}, as"
        " 1.2,1,0.8",
        text,
        "see --help",
    )
