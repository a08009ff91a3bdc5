"""`learn transfer`: pictures exchange their materials."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import editing_options, options


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "transfer",
        help="render each picture's object in the materials of the others",
        description=(
            "Decomposes several pictures and renders the object of each, under its own light, in"
            " the material of every other one. Writes one picture per pair and a grid with a row"
            " per object and a column per material. Example: python -m learn transfer a.png b.png"
            " c.png --out swapped"
        ),
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
    parser.add_argument(
        "--per-grid",
        type=int,
        default=6,
        metavar="N",
        help="pictures per grid; further pictures go into further grids (default 6)",
    )
    options.add_out(parser)
    editing_options.add(parser)
    parser.set_defaults(run=run, continues=False)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    from learn.editing import transfer

    paths = transfer.listed(arguments.pictures, arguments.list)
    transfer.run(
        paths,
        arguments.mask_dir,
        arguments.out,
        editing_options.edit_options(arguments),
        arguments.per_grid,
        arguments.overwrite,
    )
    print(f"See {arguments.out}")
