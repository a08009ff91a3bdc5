"""`learn join-weights`: one file of two weights, whose normals are averaged."""

from __future__ import annotations

import argparse
from pathlib import Path

from manifests.help_format import HelpFormatter

EPILOG = """example:
  python -m learn join-weights --normals normals/weights.safetensors \\
      --others run/weights.safetensors --out joined.safetensors"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "join-weights",
        help="join weights that predict normals with others that predict all parts",
        description=(
            "Joins two networks into one whose normals are the mean of both. One is of type"
            " compact-pretrained and predicts normals; the other is of type compact-wrapped and"
            " predicts material and light as well."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
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
    parser.set_defaults(run=run, result_files=("out",))


def run(arguments: argparse.Namespace) -> int:
    """Write the joined weights."""
    from learn.networks import joining

    joining.join(arguments.normals, arguments.others, arguments.out)
    print(f"See {arguments.out}")
    return 0
