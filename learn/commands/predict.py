"""`learn predict`: the decomposition of one picture into normals, light and material."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import editing_options, options
from manifests import other_threads


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "predict",
        help="decompose one picture into normals, light and material",
        description=(
            "Predicts normals, light and material of the object in one picture, and renders it"
            " again from them. Writes normals, light and the rendering as EXR and PNG, the material"
            " as JSON, and one contact sheet (sheet.png). Example: python -m learn predict"
            " photo.jpg --mask mask.png --out parts"
        ),
    )
    parser.add_argument(
        "image",
        type=Path,
        metavar="IMAGE",
        help=(
            "a picture of any size (PNG, JPEG, TIFF, EXR …), or a data set's folder, of which a"
            " held-out record is taken"
        ),
    )
    parser.add_argument(
        "--mask",
        type=Path,
        metavar="FILE",
        help="a picture that is white where the object is (default: the picture's transparency)",
    )
    options.add_weights(parser)
    options.add_exposure(parser, "picture")
    options.add_out(parser)
    options.add_device(parser)
    options.add_overwrite(parser)
    parser.set_defaults(run=run, continues=False)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    other_threads.let_waiting_threads_sleep()
    from learn.data import devices
    from learn.editing import predict

    editing_options.check_exposure(arguments.exposure)
    predict.run(
        arguments.image,
        arguments.mask,
        arguments.weights,
        arguments.out,
        arguments.exposure,
        arguments.overwrite,
        devices.choose(arguments.device),
    )
    print(f"See {arguments.out / 'sheet.png'}")
