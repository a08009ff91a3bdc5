"""`learn edit`: change the material of an object in a photograph."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from learn.commands import editing_options, options
from manifests import collection, other_threads
from manifests.errors import InputError
from manifests.help_format import HelpFormatter

EPILOG = """examples:
  python -m learn edit photo.jpg --mask mask.png --material brass red-fabric --out edited
  python -m learn edit cut-out.png --material other-photo.png --out edited
  python -m learn edit example:espresso-cup --material dark-blue-paint+keep --out cup
  python -m learn edit carton.jpg --mask mask.png --shape box --material walnut --out carton"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "edit",
        help="change what the object of a photograph is made of",
        description=(
            "Changes the material of one object in a photograph. A network estimates the object's"
            " normals, its material and the light, and refinement adjusts them until a rendering of"
            " them looks like the photograph. The object is then rendered in each material that you"
            " name, and put back in front of its background. Writes the edited pictures, the"
            " decomposition, and one contact sheet (sheet.png)."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "photo",
        type=Path,
        metavar="PHOTO",
        help="PNG, JPEG, TIFF, EXR …, of any size; a data set's folder; or example:espresso-cup",
    )
    parser.add_argument(
        "--mask",
        action="append",
        default=[],
        metavar="FILE",
        help=(
            "a picture that is white where the object is (default, also written 'alpha': the"
            " photograph's transparency). Repeat the option to give the object several regions, one"
            " mask each, which can then have different materials"
        ),
    )
    parser.add_argument(
        "--regions",
        type=Path,
        metavar="FILE",
        help=(
            "instead of several masks: one picture with a grey or a colour for each region of the"
            " object, black elsewhere"
        ),
    )
    editing_options.add_fit_mask(parser)
    editing_options.add_shape(parser)
    parser.add_argument(
        "--material",
        nargs="+",
        action="extend",
        required=True,
        metavar="MATERIAL",
        help=(
            "one or more materials, each of which makes one edit: a name (`python -m factory"
            " materials list` prints them; edits brighten those of the database MERL, and"
            " 'measured(NAME)' is as dark as it was measured); a description in quotes, such as"
            " 'principled(base_color=#a03020, roughness=.35, metallic=0)', 'lambert(#c0c0c0)' or"
            " 'ggx(f0=.9, roughness=.2)'; a material.json; or a picture whose material is to be"
            " used (with transparency, or with its mask in NAME.mask.png in the same folder). For"
            " an object with regions, write A+B to give the first region A and the second B;"
            " 'keep' leaves a region as it is"
        ),
    )
    editing_options.add_brightness(parser)
    options.add_out(parser)
    parser.add_argument(
        "--record",
        metavar="ID",
        help=(
            "if PHOTO is a data set's folder: the id of the record to edit (default: the first"
            " held-out record that is not already in one of the materials)"
        ),
    )
    parser.add_argument(
        "--interactive",
        action="store_true",
        help=(
            "also write interactive.html, a single page on which anyone can try all materials of"
            " the catalogue, blends of them and other lights, in a browser and without a network."
            " This takes some minutes. Example: python -m learn edit example:espresso-cup"
            " --material brass --interactive --out edited"
        ),
    )
    editing_options.add(parser)
    parser.set_defaults(run=run, continues=False)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    other_threads.let_waiting_threads_sleep()
    with collection.hold_while_loading():
        from learn.editing import decomposition, edit

    masks = editing_options.mask_files(arguments.mask)
    _require_masks_with_effect(arguments)
    editing_options.check_brightness(arguments.brightness)
    edit_options = replace(
        editing_options.edit_options(arguments),
        shape=arguments.shape,
        stops=arguments.brightness,
    )
    report = edit.run(
        arguments.photo,
        masks,
        arguments.regions,
        arguments.material,
        arguments.out,
        edit_options,
        arguments.record,
        arguments.overwrite,
        arguments.interactive,
    )
    for text, error in report["display_l2"].items():
        print(
            f"{text}: display L2 {error['mask']:.1f} over the object, {error['frame']:.1f} over the"
            " frame, against the rendered truth"
        )
    warning = decomposition.shape_warning(
        arguments.shape, report["shape_overlap"], editing_options.WITHOUT_SHAPE
    )
    if warning:
        print(warning)
    print(f"See {arguments.out / 'sheet.png'}")
    if arguments.interactive:
        print(f"Open {arguments.out / 'interactive.html'} in a browser")


def _require_masks_with_effect(arguments: argparse.Namespace) -> None:
    """Raise InputError if several masks are given together with something that overrides them."""
    if len(arguments.mask) < 2:
        return
    if editing_options.ALPHA in arguments.mask:
        rule = "no other mask beside the photograph's transparency"
        raise InputError("--mask alpha", rule, f"{len(arguments.mask)} masks", "leave it out")
    if arguments.regions is not None:
        rule = "one mask at most, as this file has the regions"
        remedy = "give one of --regions and several masks"
        raise InputError("--regions", rule, f"{len(arguments.mask)} masks", remedy)
