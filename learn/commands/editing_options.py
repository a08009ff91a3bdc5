"""Options that `edit`, `transfer` and `predict` share, and the checks of their values."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from learn.commands import options
from learn.editing import DETAIL, MOST_STOPS
from learn.primitives import PRIMITIVES

if TYPE_CHECKING:
    from learn.editing.edit import EditOptions
    from learn.refinement import RefinementSettings

LARGEST_FACTOR = 100  # of white balance; the smallest is its reciprocal
ALPHA = "alpha"  # in place of a mask's file: the photograph's transparency
WITHOUT_SHAPE = "leave --shape out"  # what to do if the named shape does not suit the mask


def add(parser: argparse.ArgumentParser) -> None:
    """Add the shared options to a parser, those that few users need in a group of their own."""
    finer = parser.add_argument_group(
        "finer control",
        "The defaults suit most photographs; docs/editing-options.md explains each option.",
    )
    finer.add_argument(
        "--refine",
        action=argparse.BooleanOptionalAction,
        default=True,
        help=(
            "adjust the predicted normals, light and material until a rendering of them looks like"
            " the photograph (default: yes); --no-refine saves some seconds per photograph"
        ),
    )
    options.add_refinement_method(finer)
    finer.add_argument(
        "--tolerance",
        type=float,
        default=1e-2,
        metavar="T",
        help="largest relative error of the rendering layer (default 0.01); smaller is slower",
    )
    finer.add_argument(
        "--detail",
        type=float,
        default=DETAIL,
        metavar="D",
        help=(
            "how much to keep of the photograph's own shading, such as shadows in gaps, folds and"
            " texture: from 0 (none) to 1 (all, unless it looks like a print); default %(default)s"
        ),
    )
    options.add_exposure(finer, "photograph")
    finer.add_argument(
        "--white-balance",
        default="none",
        metavar="W",
        help=(
            "correct a colour cast before the network sees the photograph: none (default); grey,"
            " which assumes that the background is grey on average; or three factors R,G,B"
        ),
    )
    options.add_weights(finer)
    options.add_device(finer)
    options.add_overwrite(parser)


def add_fit_mask(parser: argparse.ArgumentParser, note: str = "") -> None:
    """Add --fit-mask and --no-fit-mask to a parser; note: what is appended to the help."""
    parser.add_argument(
        "--fit-mask",
        action=argparse.BooleanOptionalAction,
        help=(
            "move the edge of a mask, by a few pixels at most, to where the object ends according"
            " to the photograph's colours, or leave it where it is (default: move it if the mask is"
            f" black and white; leave grey edges and transparency){note}"
        ),
    )


def add_shape(parser: argparse.ArgumentParser, note: str = "") -> None:
    """Add --shape to a parser; note: what is appended to the help."""
    parser.add_argument(
        "--shape",
        choices=PRIMITIVES,
        help=(
            "what the object is, if it is one of these; a truncated cone counts as a cylinder. Its"
            " normals then follow from its outline, and a print on it is not taken for relief"
            f" (default: the network guesses the normals){note}"
        ),
    )


def add_brightness(parser: argparse.ArgumentParser) -> None:
    """Add --brightness to a parser."""
    parser.add_argument(
        "--brightness",
        type=float,
        default=0.0,
        metavar="STOPS",
        help=(
            "make the new material brighter, or darker with a negative number, by this many stops;"
            " one stop doubles its brightness. The program can only guess how bright a material"
            f" looks in a photograph, so correct it by eye (default 0; at most {MOST_STOPS:g})"
        ),
    )


def check_brightness(stops: float, name: str = "--brightness") -> None:
    """Raise InputError unless the brightness is at most MOST_STOPS stops; name: for messages."""
    most = f"{MOST_STOPS:g}"
    check(name, abs(stops) <= MOST_STOPS, f"a number of stops from -{most} to {most}", stops)


def edit_options(arguments: argparse.Namespace) -> EditOptions:
    """Return the EditOptions of parsed arguments. Raises InputError."""
    from learn.data import devices
    from learn.editing.edit import EditOptions

    check(
        "--tolerance",
        0 < arguments.tolerance < 1,
        "a number above 0 and below 1",
        arguments.tolerance,
    )
    check("--detail", 0 <= arguments.detail <= 1, "a number from 0 to 1", arguments.detail)
    check_exposure(arguments.exposure)
    settings = refinement_of_photographs(
        arguments.refine, arguments.refinement_method, "--refinement-method"
    )
    balance = parse_balance(arguments.white_balance)
    device = devices.choose(arguments.device)
    return EditOptions(
        arguments.weights,
        settings,
        arguments.tolerance,
        arguments.detail,
        arguments.exposure,
        balance,
        device,
        arguments.fit_mask,
    )


def refinement_of_photographs(
    refine: bool, method: str | None, name: str
) -> RefinementSettings | None:
    """Return the settings for refining photographs, or None if they are not to be refined.

    refine  whether to refine
    method  how refinement renders: one of LAYER_METHODS; None means "auto"
    name    the option or argument that gave the method, for error messages
    Raises  InputError: an unknown method, or a method although `refine` is False
    """
    from learn.refinement import PHOTOGRAPHS
    from manifests.errors import InputError, closest
    from manifests.training_runs import LAYER_METHODS

    if method is not None and method not in LAYER_METHODS:
        rule = f"one of {', '.join(LAYER_METHODS)}"
        raise InputError(name, rule, f"'{method}'", closest(method, LAYER_METHODS))
    if not refine:
        if method is not None:
            remedy = "leave it out: nothing is refined"
            raise InputError(name, "refinement", f"{method} without it", remedy)
        return None
    return PHOTOGRAPHS.with_method(method or "auto")


def mask_files(given: Iterable[str]) -> list[Path]:
    """Return the masks that are files; ALPHA, which stands for transparency, is left out."""
    return [Path(mask) for mask in given if mask != ALPHA]


def check_exposure(value: float | None) -> None:
    """Raise InputError unless the exposure is None (estimate it) or a finite number above 0."""
    if value is not None:
        check("--exposure", 0 < value < float("inf"), "a number above 0", value)


def check(name: str, holds: bool, rule: str, value: float) -> None:
    """Raise InputError if an option's value breaks its rule, that is, if `holds` is False."""
    from manifests.errors import InputError

    if not holds:
        raise InputError(name, rule, f"{value:g}", "see --help")


def parse_balance(given: str | Sequence[float]) -> str | tuple[float, ...]:
    """Parse a white balance: "none", "grey", or three positive factors as text or as numbers.

    Raises InputError for anything else.
    """
    from manifests.errors import InputError

    if isinstance(given, str) and given in ("none", "grey"):
        return given
    try:
        factors = tuple(float(x) for x in (given.split(",") if isinstance(given, str) else given))
        if len(factors) == 3 and all(1 / LARGEST_FACTOR <= f <= LARGEST_FACTOR for f in factors):
            return factors
    except (TypeError, ValueError):
        pass
    raise InputError(
        "--white-balance",
        f"none, grey, or three factors from {1 / LARGEST_FACTOR:g} to {LARGEST_FACTOR:g}, as"
        " 1.2,1,0.8",
        str(given),
        "see --help",
    )
