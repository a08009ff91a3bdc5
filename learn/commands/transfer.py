"""`learn transfer`: pictures exchange their materials."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import editing_options, options
from manifests import collection, other_threads
from manifests.errors import InputError
from manifests.help_format import HelpFormatter

EPILOG = """examples:
  python -m learn transfer a.png b.png c.png --out swapped
  python -m learn transfer a.png b.png --light room.exr --out lit"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "transfer",
        help="render each picture's object in the materials of the others",
        description=(
            "Decomposes several pictures, and renders the object of each one, under its own"
            " light, in the materials of all the others. Writes one picture per pair, and a grid"
            " with a row per object and a column per material. With --light, all objects are"
            " rendered under that light, and in their own material too."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "pictures",
        nargs="*",
        type=Path,
        metavar="PICTURE",
        help="two pictures or more, with transparency or with masks",
    )
    parser.add_argument(
        "--list",
        type=Path,
        metavar="FILE",
        help="a text file with one picture's path per line, relative to that file",
    )
    parser.add_argument(
        "--mask-dir",
        type=Path,
        metavar="DIR",
        help=(
            "folder of masks with the names of the pictures (default: NAME.mask.png beside each"
            " picture)"
        ),
    )
    editing_options.add_fit_mask(parser)
    parser.add_argument(
        "--per-grid",
        type=int,
        default=6,
        metavar="N",
        help="pictures per grid; further pictures go into further grids (default 6)",
    )
    parser.add_argument(
        "--light",
        action="append",
        default=[],
        metavar="LIGHT",
        help=(
            "render under this light instead of each picture's own: a map FILE.exr (twice as wide"
            " as high, such as light.exr of `edit`), FILE.npz#NAME, computed:SEED, or another"
            " picture with its mask; repeat the option for several"
        ),
    )
    parser.add_argument(
        "--light-rotation",
        type=float,
        default=0.0,
        metavar="DEG",
        help="rotate these lights about the vertical (default 0)",
    )
    options.add_out(parser)
    editing_options.add(parser)
    parser.set_defaults(run=run, continues=False)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    other_threads.let_waiting_threads_sleep()
    with collection.hold_while_loading():
        from learn.editing import transfer

    editing_options.check(
        "--light-rotation",
        abs(arguments.light_rotation) <= 360,
        "degrees from -360 to 360",
        arguments.light_rotation,
    )
    if arguments.light_rotation and not arguments.light:
        raise InputError(
            "--light-rotation", "--light with it", "none", "give the light that it rotates"
        )
    paths = transfer.list_pictures(arguments.pictures, arguments.list)
    transfer.run(
        paths,
        arguments.mask_dir,
        arguments.out,
        editing_options.edit_options(arguments),
        arguments.per_grid,
        arguments.overwrite,
        arguments.light,
        arguments.light_rotation,
    )
    print(f"See {arguments.out}")
