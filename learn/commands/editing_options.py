"""Options that the commands `edit` and `transfer` share."""

import argparse
from pathlib import Path


def add(parser):
    """Adds them to a parser."""
    parser.add_argument(
        "--refine",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="fit what was predicted to the photograph before editing (default), or not: quicker by seconds a photograph",
    )
    parser.add_argument("--tolerance", type=float, default=1e-2, metavar="T", help="relative error that rendering may have (default 0.01)")
    parser.add_argument(
        "--detail",
        type=float,
        default=0.25,
        metavar="D",
        help="how much of the photograph's fine shading is carried over: 0 none, 1 all (default 0.25); fine highlights come along",
    )
    parser.add_argument(
        "--exposure", type=float, metavar="X", help="radiance is the picture times X (default: from the object's brightness)"
    )
    parser.add_argument(
        "--white-balance",
        default="none",
        metavar="W",
        help="none: as the camera balanced it (default); grey: as if the background were grey on average; or three factors R,G,B",
    )
    parser.add_argument("--weights", type=Path, metavar="FILE", help="weights.safetensors of a run (default: the ones that come with it)")
    parser.add_argument("--overwrite", action="store_true", help="replace what is there")


def how(options):
    """learn.editing.edit.How of parsed options. Raises Problem."""
    from learn.editing.edit import How
    from learn.prediction import WEIGHTS
    from learn.refinement import Settings

    check("--tolerance", options.tolerance, 0, 1)
    check("--detail", options.detail, -1e-9, 1 + 1e-9)
    if options.exposure is not None:
        check("--exposure", options.exposure, 0, float("inf"))
    settings = Settings() if options.refine else None
    balance = balance_of(options.white_balance)
    return How(options.weights or WEIGHTS, settings, options.tolerance, options.detail, options.exposure, balance)


def check(name, value, low, high):
    from manifests.problems import Problem

    if not low < value < high:
        raise Problem(name, f"a number above {max(low, 0):g} and below {high:g}", f"{value:g}", "see --help")


def balance_of(text):
    """ "none", "grey", or three positive factors."""
    from manifests.problems import Problem

    if text in ("none", "grey"):
        return text
    try:
        factors = tuple(float(part) for part in text.split(","))
        if len(factors) == 3 and all(0 < f < float("inf") for f in factors):
            return factors
    except ValueError:
        pass
    raise Problem("--white-balance", "none, grey, or three positive factors as 1.2,1,0.8", text, "see --help")
