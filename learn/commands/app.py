"""`learn app`: serves a page to edit photographs in, or repeats an edit that was made there."""

from __future__ import annotations

import argparse
import ipaddress
from pathlib import Path

from learn.commands import editing_options, options
from manifests import other_threads
from manifests.errors import InputError
from manifests.help_format import HelpFormatter

LOCAL = "127.0.0.1"
LARGEST_PORT = 65535

EPILOG = """examples:
  python -m learn app
  python -m learn app --host 0.0.0.0 --port 8080
  python -m learn app photo.jpg --mask mask.png --repeat edit.json --out edited"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "app",
        help="edit photographs on a page in the browser",
        description=(
            "Serves a web page for editing: choose a photograph, click on its object to make"
            " the mask, and give the object another material, a blend of two, or another light."
            " It needs the extra `app` but no network, and only this computer can open the page."
            " With --repeat it serves nothing, and repeats an edit that was made on the page."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "photo", nargs="?", metavar="PHOTO", help="with --repeat: the photograph, or example:NAME"
    )
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help=(
            "address to listen on (default 127.0.0.1: only this computer; 0.0.0.0: whoever can"
            " connect to it, without a password)"
        ),
    )
    parser.add_argument(
        "--port", type=int, metavar="N", help="port (default: a free one from 7860 on)"
    )
    parser.add_argument("--open", action="store_true", help="open the page in a browser")
    parser.add_argument(
        "--repeat", type=Path, metavar="FILE", help="edit.json of the page, to be repeated"
    )
    parser.add_argument("--mask", type=Path, metavar="FILE", help="with --repeat: the mask")
    parser.add_argument("--regions", type=Path, metavar="FILE", help="with --repeat: the regions")
    parser.add_argument("--out", type=Path, metavar="DIR", help="with --repeat: the folder")
    parser.add_argument(
        "--refine",
        action=argparse.BooleanOptionalAction,
        help="with --repeat: whether to refine, as “Improve” of the page does (default: yes)",
    )
    editing_options.add_fit_mask(parser, "; with --repeat")
    editing_options.add_shape(parser, "; with --repeat")
    options.add_weights(parser)
    options.add_device(parser)
    options.add_overwrite(parser)
    parser.set_defaults(run=run, continues=False, result_folders=("out",))


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    other_threads.let_waiting_threads_sleep()
    from learn.data import devices

    if arguments.repeat is not None:
        _repeat(arguments)
        return
    _refuse_options_of_repeat(arguments)
    host = LOCAL if arguments.host is None else arguments.host
    _require_address(host)
    if arguments.port is not None and not 1 <= arguments.port <= LARGEST_PORT:
        rule = f"a port from 1 to {LARGEST_PORT}"
        raise InputError("--port", rule, f"{arguments.port}", "leave it out")
    device = str(devices.choose(arguments.device))
    try:
        import gradio  # noqa: F401 -- whether it is there
    except ModuleNotFoundError as error:
        rule, remedy = "the extra app", "pip install '.[app]' in a checkout"
        raise InputError("brdfactory app", rule, f"no module {error.name}", remedy) from None
    from learn.app import page

    page.serve(
        arguments.weights,
        device,
        host,
        arguments.port,
        arguments.open,
    )


def _refuse_options_of_repeat(arguments: argparse.Namespace) -> None:
    """Raise InputError for an option that has a meaning only with --repeat, which is not given."""
    for name in ("photo", "mask", "regions", "out"):
        if getattr(arguments, name) is not None:
            where = "PHOTO" if name == "photo" else f"--{name}"
            raise InputError(where, "--repeat FILE with it", "none", "choose files on the page")
    for name in ("refine", "fit-mask"):
        chosen = getattr(arguments, name.replace("-", "_"))
        if chosen is not None:
            where = f"--{name}" if chosen else f"--no-{name}"
            raise InputError(where, "--repeat FILE with it", "none", "choose it on the page")
    if arguments.shape is not None:
        remedy = "choose it on the page"
        raise InputError("--shape", "--repeat FILE with it", "none", remedy)
    if arguments.overwrite:
        remedy = "leave it out: the page writes into no folder"
        raise InputError("--overwrite", "--repeat FILE with it", "none", remedy)


def _require_address(host: str) -> None:
    """Raise InputError unless `host` is an IP address or localhost."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        if host != "localhost":
            rule = "an address of this computer, such as 127.0.0.1 or 0.0.0.0"
            raise InputError("--host", rule, host, "leave it out") from None


def _require_options_of_repeat(arguments: argparse.Namespace) -> None:
    """Raise InputError if --repeat lacks an option that it needs, or has one of the page."""
    for name in ("photo", "out"):
        if getattr(arguments, name) is None:
            where = "PHOTO" if name == "photo" else f"--{name}"
            raise InputError(where, "a value with --repeat", "none", "see --help")
    given = {"host": arguments.host, "port": arguments.port, "open": arguments.open or None}
    for name, value in given.items():
        if value is not None:
            remedy = "leave it out: --repeat serves no page"
            repeated = f"--repeat {arguments.repeat}"
            raise InputError(f"--{name}", "no --repeat with it", repeated, remedy)


def _repeat(arguments: argparse.Namespace) -> None:
    """Repeat an edit that was made on the page: write edited.png and edited.exr."""
    from learn.app import edit_file
    from learn.app.composition import opacity_of
    from learn.app.viewer import Viewer
    from learn.data import devices, photographs
    from learn.editing import decomposition, photograph
    from learn.networks import weights as checkpoint
    from learn.refinement import PHOTOGRAPHS
    from manifests import files, outputs

    _require_options_of_repeat(arguments)
    inputs = [arguments.photo, arguments.repeat, arguments.mask, arguments.regions]
    outputs.reserve_outputs(
        arguments.out,
        ["edited.png", "edited.exr"],
        arguments.overwrite,
        inputs,
    )
    edit = edit_file.read(arguments.repeat)
    masks = [] if arguments.mask is None else [arguments.mask]
    opened = photograph.open_photograph(
        arguments.photo, masks, arguments.regions, fit_mask=arguments.fit_mask
    )
    if len(edit.regions) != opened.count:
        rule = f"{opened.count} regions, as the mask has"
        raise InputError(arguments.repeat, rule, f"{len(edit.regions)}", "give the page's regions")
    device = devices.choose(arguments.device)
    network, metadata = checkpoint.load_full_network(arguments.weights, device)
    settings = None if arguments.refine is False else PHOTOGRAPHS
    decomposed = decomposition.decompose(
        opened, network, metadata["size"], settings, shape=arguments.shape
    )
    linear, display = Viewer(decomposed).full(edit)
    photographs.require_finite(arguments.photo, linear)
    arguments.out.mkdir(parents=True, exist_ok=True)
    files.write_image(arguments.out / "edited.png", display, "PNG")
    opacity = opacity_of(opened, edit.hide_background)
    photographs.write_picture(arguments.out / "edited.exr", linear, opacity)
    warning = decomposition.shape_warning(
        arguments.shape, decomposed.shape_overlap, editing_options.WITHOUT_SHAPE
    )
    if warning:
        print(warning)
    print(f"See {arguments.out / 'edited.png'}")
