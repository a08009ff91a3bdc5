"""`learn join-weights`: one file of two weights, whose normals are averaged."""

from __future__ import annotations

import argparse
from pathlib import Path


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "join-weights",
        help="join weights that predict normals with others that predict all parts",
        description=(
            "Writes weights whose normals are the mean of those of a network of type"
            " compact-pretrained and of one of type compact-wrapped, which predicts material and"
            " light as well. Example: python -m learn"
            " join-weights --normals normals/weights.safetensors --others run/weights.safetensors"
            " --out joined.safetensors"
        ),
    )
    parser.add_argument(
        "--normals", type=Path, required=True, metavar="FILE", help="weights that predict normals"
    )
    parser.add_argument(
        "--others",
        type=Path,
        required=True,
        metavar="FILE",
        help="weights that predict normals, material and light",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="the new weights; a file of that name is replaced",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the joined weights."""
    from learn.networks import joining

    joining.join(arguments.normals, arguments.others, arguments.out)
    print(f"See {arguments.out}")
    return 0
