"""`learn predict`: the decomposition of one picture into normals, light and material."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import editing_options, options
from manifests import collection, other_threads
from manifests.help_format import HelpFormatter

EPILOG = """example:
  python -m learn predict photo.jpg --mask mask.png --out parts"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "predict",
        help="decompose one picture into normals, light and material",
        description=(
            "Predicts normals, light and material of the object in one picture, and renders it"
            " again from them. Writes normals, light and the rendering as EXR and PNG, the"
            " material as JSON, and one contact sheet (sheet.png)."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "image",
        type=Path,
        metavar="IMAGE",
        help=(
            "a picture of any size (PNG, JPEG, TIFF, EXR …); a data set's folder, from which one"
            " held-out record is chosen; or example:espresso-cup, whose cup and saucer count as one"
            " object here"
        ),
    )
    parser.add_argument(
        "--mask",
        metavar="FILE",
        help=(
            "a picture that is white where the object is; without it, or with 'alpha', the"
            " picture's transparency is used"
        ),
    )
    editing_options.add_fit_mask(parser)
    options.add_weights(parser)
    options.add_exposure(parser, "picture")
    options.add_out(parser)
    options.add_device(parser)
    options.add_overwrite(parser)
    parser.set_defaults(run=run, continues=False)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    other_threads.let_waiting_threads_sleep()
    with collection.hold_while_loading():
        from learn.data import devices
        from learn.editing import predict

    editing_options.check_exposure(arguments.exposure)
    masks = editing_options.mask_files([] if arguments.mask is None else [arguments.mask])
    predict.run(
        arguments.image,
        masks[0] if masks else None,
        arguments.weights,
        arguments.out,
        arguments.exposure,
        arguments.overwrite,
        devices.choose(arguments.device),
        arguments.fit_mask,
    )
    print(f"See {arguments.out / 'sheet.png'}")
