"""`lights`: list, preview, add and make the environment maps that light the scenes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from factory.commands.actions import add_action, add_command, add_library, add_picture_output
from factory.planning.shape_names import OWN_LICENCE
from manifests.option_types import positive, whole
from manifests.wording import number_of

if TYPE_CHECKING:
    import numpy as np

    from factory.lights.light import Light

EPILOG = """examples:
  python -m factory lights list
  python -m factory lights preview city softboxes-3 --out lights.png
  python -m factory lights add ~/Downloads/harbour.exr --library my-lights --licence CC0
  python -m factory lights add maps.npz --library my-lights --licence CC0
  python -m factory lights make --count 20 --library my-lights

A light is a name from the list or an .hdr, .exr or .npz file, twice as wide as it is high. The name
of a computed light takes a seed: softboxes-3. An .npz file holds one map per array."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `lights`."""
    actions = add_command(
        subparsers,
        "lights",
        "list, preview, add and make the environment maps that light the scenes",
        "Lists, previews, adds and makes the environment maps that light the scenes. Every map is"
        " scaled to a mean luminance of 1 over the sphere.",
        EPILOG,
    )
    one = add_action(
        actions,
        "list",
        run_list,
        "print the name, size, contrast and licence of each light",
        "python -m factory lights list my-lights",
    )
    one.add_argument(
        "folder",
        nargs="?",
        type=Path,
        metavar="FOLDER",
        help="a folder of your own .hdr and .exr files, which are listed with the built-in lights",
    )

    one = add_action(
        actions,
        "preview",
        run_preview,
        "draw each light: its map, and a diffuse and a mirror sphere under it",
        "python -m factory lights preview city softboxes-3 --out lights.png",
    )
    one.add_argument(
        "lights",
        nargs="*",
        metavar="LIGHT",
        help="names or files of lights (default: all built-in lights)",
    )
    one.add_argument(
        "--library",
        type=Path,
        metavar="DIR",
        help="a folder of your own maps, in which names are looked up too",
    )
    one.add_argument(
        "--size",
        type=int,
        default=128,
        metavar="N",
        help="height of each row in pixels (default: %(default)s)",
    )
    add_picture_output(one)

    one = add_action(
        actions,
        "add",
        run_add,
        "check light maps and copy them into a folder of your own",
        "python -m factory lights add harbour.exr --library my-lights --licence CC0",
    )
    one.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help=(
            "an .hdr or .exr file, twice as wide as it is high, or an .npz file with one array per"
            " map"
        ),
    )
    add_library(one)

    one = add_action(
        actions,
        "make",
        run_make,
        "render rooms and open skies, drawn from seeds, as light maps of 64×128 (needs Blender)",
        "python -m factory lights make --count 20 --library my-lights --workers 2",
    )
    one.add_argument(
        "--count", type=positive, default=20, metavar="N", help="number of maps (default 20)"
    )
    one.add_argument(
        "--first", type=whole, default=0, metavar="SEED", help="seed of the first map (default 0)"
    )
    one.add_argument(
        "--library",
        required=True,
        type=Path,
        metavar="DIR",
        help="the folder of the maps, created if it does not exist; maps it has are not made again",
    )
    one.set_defaults(result_folders=("library",))
    one.add_argument(
        "--workers", type=positive, default=1, metavar="N", help="number of processes (default 1)"
    )


def run_make(options: argparse.Namespace) -> None:
    """Render the maps that the library lacks and add them to it, each as soon as it is done."""
    import concurrent.futures
    import contextlib
    import multiprocessing

    from factory.lights import interiors, library
    from manifests import subprocesses
    from manifests.progress import tqdm

    names = {
        f"interior-{seed}": seed for seed in range(options.first, options.first + options.count)
    }
    known = library.read_list(options.library)
    options.library.mkdir(parents=True, exist_ok=True)  # before the maps are rendered
    missing = {name: seed for name, seed in names.items() if name not in known}
    # in processes of their own: Blender's memory and its exit stay away from this one
    total = 0.0
    context = multiprocessing.get_context("spawn")
    pool = concurrent.futures.ProcessPoolExecutor(
        options.workers, context, subprocesses.end_with_parent
    )
    remedy = "give the same command with fewer --workers: it makes the maps that are missing"
    made = subprocesses.results_of(pool, _render, missing.values(), str(options.library), remedy)
    names_of = {seed: name for name, seed in missing.items()}
    with contextlib.closing(made):  # where a map cannot be written, no further ones are rendered
        for seed, (L, seconds) in tqdm(made, total=len(missing), unit="map", disable=None):
            total += seconds
            library.add_made(names_of[seed], L, options.library, OWN_LICENCE, interiors.SOURCE)
    there = len(names) - len(missing)
    line = f"{options.library}: {number_of(len(missing), 'map')} made"
    print(f"{line}, {there} {'was' if there == 1 else 'were'} there")
    if missing:
        print(f"{total / len(missing):.1f} seconds of processor time per map")


def _render(seed: int) -> tuple[np.ndarray, float]:
    """Return the light map of a seed and the seconds of processor time that it took.

    It is called in a process of its own.
    """
    import time

    start = time.process_time()
    from factory.lights import interiors
    from factory.render import panorama

    L = panorama.render(interiors.draw(seed), seed)
    return L, time.process_time() - start


def run_list(options: argparse.Namespace) -> int:
    """Print one line for each light; return 1 if a file could not be read, else 0."""
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
        "brightest: radiance of the brightest texel, relative to the mean; its share: the part of"
        " all light that comes from the brightest texel of the 64×128 map"
    )
    return 1 if failed else 0


def _line(light: Light) -> str:
    from shaders import envmap, tone

    energy = (light.L64 @ tone.LUMINANCE) * envmap.row_solid_angles(*light.L64.shape[:2])[:, None]
    size = f"{light.L_full.shape[1]}×{light.L_full.shape[0]}"
    peak, share = float((light.L_full @ tone.LUMINANCE).max()), float(energy.max() / energy.sum())
    return (
        f"{light.name:<16} {size:>10} {peak:>10.1f} {share:>10.1%}  {light.licence:<12}"
        f" {light.source}"
    )


def run_preview(options: argparse.Namespace) -> None:
    """Write one picture with a row for each light."""
    import numpy as np

    from factory.lights import load, names
    from factory.lights.preview import picture
    from manifests.errors import InputError
    from manifests.files import write_image
    from manifests.progress import tqdm

    if not 8 <= options.size <= 1024:
        raise InputError("--size", "8 to 1024 pixels", str(options.size), "128 suits most")
    requested = options.lights or names(options.library)
    rows = [
        picture(load(name, options.library), options.size)
        for name in tqdm(requested, unit="light", leave=False, disable=None)
    ]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_image(options.out, np.concatenate(rows), "PNG")
    shown = ", ".join(map(str, requested))
    print(f"{options.out}: {number_of(len(rows), 'light')}, from the top: {shown}")


def run_add(options: argparse.Namespace) -> None:
    """Copy each file, and each map of an .npz file, into the folder."""
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
                outcome = f"{name} in {options.library}" if added else f"{name} again, left out"
                print(f"{path}: {inner}: {outcome}")
            continue
        print(f"{path}: {add(path, options.library, options.licence)} in {options.library}")
