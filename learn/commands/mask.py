"""`learn mask`: a mask of an object in a photograph, from a line around it."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

from manifests import collection, other_threads
from manifests.help_format import HelpFormatter

EPILOG = """examples:
  python -m learn mask photo.jpg --around 120,80 520,460 --out mask.png
  python -m learn mask photo.jpg --around 40%,10% 80%,30% 70%,90% 30%,85% --out mask.png
  python -m learn mask photo.jpg --around 120,80 520,460 --background 300,440 --out better.png"""
NEGATIVE = re.compile(r"-\.?\d")  # how a value such as -5%,10% begins, and no option
PREVIEW_SIDE = 1000  # pixels of the preview's longer side at most
PREVIEW_QUALITY = 90


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "mask",
        help="make a mask of an object from a line around it",
        description=(
            "Finds the object inside a rectangle or a polygon that you give, and writes its mask"
            " for the option --mask of other commands. Points on the object and beside it correct"
            " the mask. A picture beside it shows the object in colour: look at it. To do the same"
            " with a mouse, use `python -m learn app`."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    # argparse's own pattern accepts a negative number as a value, but no pair and no percentage
    parser._negative_number_matcher = NEGATIVE
    parser.add_argument(
        "photo",
        type=Path,
        metavar="PHOTO",
        help="PNG, JPEG, TIFF, EXR …, of any size; or example:espresso-cup",
    )
    parser.add_argument(
        "--around",
        nargs="+",
        action="append",
        default=[],
        metavar="X,Y",
        help=(
            "two opposite corners of a rectangle around the object, or three or more corners of a"
            " polygon; the closer the line is to the object, the better. Numbers are pixels from"
            " the top left corner of the photograph, or per cent of its width and height, such as"
            " 25%%,40%%. Repeat the option for an object of several pieces"
        ),
    )
    parser.add_argument(
        "--without",
        nargs="+",
        action="append",
        default=[],
        metavar="X,Y",
        help=(
            "corners of a rectangle or polygon around something that is not the object, such as"
            " what is seen through a handle. It may be repeated"
        ),
    )
    parser.add_argument(
        "--object",
        nargs="+",
        action="extend",
        default=[],
        metavar="X,Y",
        help="points on parts of the object that the mask leaves out",
    )
    parser.add_argument(
        "--background",
        nargs="+",
        action="extend",
        default=[],
        metavar="X,Y",
        help="points on what is not the object, but in the mask",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE.png",
        help="the mask; FILE.preview.jpg beside it shows the object in the photograph",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier mask")
    parser.set_defaults(run=run, continues=False)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    other_threads.let_waiting_threads_sleep()
    with collection.hold_while_loading():
        import numpy as np

        from learn.selection import overlay
        from learn.selection.points import Points, select
    from manifests import files, outputs
    from manifests.errors import InputError

    out: Path = arguments.out
    preview = out.parent / f"{out.stem}.preview.jpg"
    names = [out.name, preview.name]
    outputs.try_file(out)
    outputs.reserve_outputs(out.parent, names, arguments.overwrite, [arguments.photo])
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}", "a name that ends in .png", out.suffix or "none", "add it")
    points = Points(arguments.around, arguments.without, arguments.object, arguments.background)
    selection = select(_resolve_example(arguments.photo), points)
    mask = selection.labels() > 0
    shown = overlay.draw(selection, min(1.0, PREVIEW_SIDE / max(mask.shape)))
    out.parent.mkdir(parents=True, exist_ok=True)
    with files.transaction():
        files.write_image(out, mask.astype(np.uint8) * 255)
        files.write_image(preview, shown, quality=PREVIEW_QUALITY)
    photo, mask_file = shlex.quote(str(arguments.photo)), shlex.quote(str(out))
    print(f"The object covers {mask.mean():.0%} of the picture. Look at {preview}. If it is right:")
    print(f"brdfactory edit {photo} --mask {mask_file} --material leather --out edited")


def _resolve_example(photo: Path) -> Path:
    """Return the file of a photograph, which may be the program's example."""
    if not str(photo).startswith("example:"):
        return photo
    from learn.editing.photograph import resolve_example  # which loads torch

    return resolve_example(photo, [], None)[0]
