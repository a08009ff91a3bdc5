"""`lights`: list, look at and add environment maps."""

import argparse
from pathlib import Path

EPILOG = """examples:
  python -m factory lights list
  python -m factory lights preview city softboxes-3 --out lights.png
  python -m factory lights add ~/Downloads/harbour.exr --library my-lights --licence CC0
  python -m factory lights add maps.npz --library my-lights --licence CC0     many maps in one file of numpy
A light is a name from the list (computed ones take a seed: softboxes-3) or an .hdr, .exr or .npz file, twice as wide as high."""


def register(subparsers):
    parser = subparsers.add_parser(
        "lights",
        help="environment maps that light the scenes: list, preview, add",
        description=(
            "The environment maps that light the scenes. Every map is scaled to a mean luminance of"
            " 1 over the sphere."
        ),
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(required=True, metavar="ACTION")

    one = actions.add_parser(
        "list", help="names, sizes, how strong their brightest spot is, licences"
    )
    one.add_argument(
        "folder",
        nargs="?",
        type=Path,
        metavar="FOLDER",
        help="a folder of your own .hdr and .exr files, besides the built-in ones",
    )
    one.set_defaults(run=run_list)

    one = actions.add_parser(
        "preview", help="a picture of each light: the map, a diffuse and a mirror ball under it"
    )
    one.add_argument(
        "lights",
        nargs="*",
        metavar="LIGHT",
        help="names or files; all built-in ones if none is given",
    )
    one.add_argument(
        "--library", type=Path, metavar="DIR", help="a folder of your own maps to look names up in"
    )
    one.add_argument(
        "--size",
        type=int,
        default=128,
        metavar="N",
        help="height of a row in pixels (default: %(default)s)",
    )
    one.add_argument("--out", required=True, type=Path, metavar="PNG", help="the picture to write")
    one.set_defaults(run=run_preview)

    one = actions.add_parser("add", help="check maps and copy them into a folder of your own")
    one.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help=".hdr or .exr, twice as wide as high; or .npz of such maps by name",
    )
    one.add_argument(
        "--library",
        required=True,
        type=Path,
        metavar="DIR",
        help="the folder; made if it is not there",
    )
    one.add_argument(
        "--licence",
        default="unknown",
        help="the maps' licence, kept with every data set they light",
    )
    one.set_defaults(run=run_add)


def run_list(options):
    from factory.lights import load, names

    print(f"{'name':<16} {'size':>10} {'brightest':>10} {'its share':>10}  {'licence':<12} source")
    failed = 0
    for name in names(options.folder):
        try:
            light = load(name, options.folder)
        except ValueError as problem:
            print(f"{name:<16} {problem}")
            failed += 1
            continue
        print(_line(light))
    print(
        "brightest: radiance of the brightest texel over the mean; its share: of all the light, at"
        " 64×128"
    )
    return 1 if failed else 0


def _line(light):
    from shaders import envmap

    energy = (light.L64 @ envmap.LUMINANCE) * envmap.row_solid_angles(*light.L64.shape[:2])[:, None]
    size = f"{light.L_full.shape[1]}×{light.L_full.shape[0]}"
    peak, share = float((light.L_full @ envmap.LUMINANCE).max()), float(energy.max() / energy.sum())
    return (
        f"{light.name:<16} {size:>10} {peak:>10.1f} {share:>10.1%}  {light.licence:<12}"
        f" {light.source}"
    )


def run_preview(options):
    import numpy as np
    from tqdm import tqdm

    from factory.lights import load, names
    from factory.lights.preview import picture
    from manifests.errors import InputError
    from manifests.files import write_image

    if not 8 <= options.size <= 1024:
        raise InputError("--size", "8 to 1024 pixels", str(options.size), "choose a size within")
    requested = options.lights or names(options.library)
    rows = [
        picture(load(name, options.library), options.size)
        for name in tqdm(requested, unit="light", leave=False, disable=None)
    ]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_image(options.out, np.concatenate(rows), "PNG")
    print(f"{options.out}: {len(rows)} lights, from the top: {', '.join(map(str, requested))}")


def run_add(options):
    from factory.lights import load
    from factory.lights.catalogue import library_maps, wheel_maps
    from factory.lights.files import is_collection
    from factory.lights.library import add, add_maps

    known = None
    for path in options.files:
        if is_collection(path):
            if known is None:
                own = library_maps(options.library) if options.library.is_dir() else {}
                known = {
                    name: load(name, options.library if name in own else None).L64
                    for name in {**wheel_maps(), **own}
                }
            for inner, name, added in add_maps(path, options.library, options.licence, known):
                print(
                    f"{path}: {inner}:"
                    f" {f'{name} in {options.library}' if added else f'{name} again, left out'}"
                )
            continue
        print(f"{path}: {add(path, options.library, options.licence)} in {options.library}")
