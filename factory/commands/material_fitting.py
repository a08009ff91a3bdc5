"""The actions `materials fit` and `materials add`, which fit materials and write a catalogue."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from factory.commands.actions import Run, add_action
from manifests.wording import number_of

if TYPE_CHECKING:
    import numpy as np

    from factory.materials.recipe import Recipe
    from factory.materials.sources import Source
    from manifests.materials import Entry

LARGEST_MAP = 1 << 28  # bytes of FILE.npz:ARRAY; a map of 64 × 128 has 0.1 MB
SOURCE_HELP = "an npz of Neural-BRDF weights, a folder of MERL .binary files, or one such file"


def add(actions: argparse._SubParsersAction, name: str, run: Run, help: str, example: str) -> None:
    """Add an action that fits materials; arguments as factory.commands.actions.add_action has."""
    one = add_action(actions, name, run, help, example)
    one.add_argument("source", type=Path, metavar="SOURCE", help=SOURCE_HELP)
    one.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="NAME",
        help="names of the materials to fit (default: all)",
    )
    one.add_argument(
        "--workers",
        type=int,
        default=1,
        metavar="N",
        help="number of processes that fit (default %(default)s)",
    )
    one.add_argument(
        "--tolerance",
        type=float,
        metavar="X",
        help=(
            "relative L1 difference of label and mixture at which a fit is good enough (default"
            " 0.013)"
        ),
    )
    one.add_argument(
        "--closures",
        type=int,
        nargs="+",
        metavar="K",
        help="numbers of closures to try, in ascending order (default: 4 6 8)",
    )
    one.add_argument(
        "--light",
        action="append",
        metavar="LIGHT",
        help=(
            "a light map under which display errors are measured: a name, a file, or"
            " FILE.npz:ARRAY; repeat the option for several (default: none are measured)"
        ),
    )
    one.add_argument("--title", metavar="TEXT", help="the catalogue's title")
    one.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="FILE",
        help="the catalogue to write, a JSON file; single fits are kept in the folder FILE.fits",
    )
    one.set_defaults(result_files=("out",))


def _sources_and_recipe(options: argparse.Namespace) -> tuple[dict[str, Source], Recipe]:
    from dataclasses import replace

    from factory.materials import recipe, sources
    from factory.materials.node_model import dictionary
    from manifests.errors import InputError

    chosen = recipe.Recipe()
    if options.tolerance is not None:
        if not 1e-4 <= options.tolerance <= 1:
            raise InputError(
                "--tolerance", "0.0001 to 1", f"{options.tolerance:g}", "0.013 is the default"
            )
        chosen = replace(chosen, l1=options.tolerance, worst=3 * options.tolerance)
    if options.closures:
        first, last = options.closures[0], options.closures[-1]
        is_ascending = sorted(set(options.closures)) == options.closures
        if not is_ascending or not 1 <= first <= last <= len(dictionary()):
            raise InputError(
                "--closures",
                "ascending counts from 1",
                " ".join(map(str, options.closures)),
                "for example 4 6 8",
            )
        chosen = replace(chosen, closures=tuple(options.closures))
    if options.workers < 1:
        raise InputError(
            "--workers", "at least 1", str(options.workers), "give a number of processes"
        )
    return sources.load(options.source, options.only), chosen


def _light_maps(names: Iterable[str] | None) -> dict[str, np.ndarray]:
    """Return {name: map (height, width, 3) of unit mean}."""
    maps = {}
    for name in names or ():
        maps[name.rpartition(":")[2] if ".npz:" in name else name] = _light_map(name)
    return maps


def _light_map(name: str) -> np.ndarray:
    import numpy as np

    from factory.lights import load
    from manifests.archives import open_zip, read_array
    from manifests.errors import InputError, closest
    from shaders import envmap

    if ".npz:" not in name:
        return load(name).L64
    path, _, array = name.rpartition(":")
    with open_zip(path, "an .npz file of light maps", "name another file") as archive:
        known = [each.removesuffix(".npy") for each in archive.namelist()]
        if array not in known:
            raise InputError(
                path, f"an array {array!r}", "none of that name", closest(array, known)
            )
        L = read_array(archive, array, LARGEST_MAP)
    right = L.dtype.kind in "fiu" and L.ndim == 3 and L.shape[1:] == (2 * L.shape[0], 3) and L.size
    if not right or not np.isfinite(L).all():
        raise InputError(
            name, "a finite light map (H, 2H, 3)", f"{L.shape} of {L.dtype}", "name another array"
        )
    L = np.maximum(L.astype(np.float64), 0)
    if not 1e-30 < L.mean() < 1e30:
        raise InputError(
            name, "a light map of a mean from 1e-30 to 1e+30", f"{L.mean():g}", "name another array"
        )
    return envmap.unit_mean(L)[0]


def run_fit(options: argparse.Namespace) -> None:
    """Fit all materials of a source and write the catalogue."""
    from factory.materials import fitting, sources

    result, recipe = _sources_and_recipe(options)
    maps = _light_maps(options.light)
    entries = fitting.fit_all(result, recipe, maps, options.out, options.workers)
    title = (
        options.title or f"{number_of(len(entries), 'material')} fitted from {options.source.name}"
    )
    fitting.write_catalogue(entries, options.out, title, sources.credit(result), maps)
    _summary(options.out, entries)


def run_add(options: argparse.Namespace) -> None:
    """Fit materials of a source and write them into a catalogue that may hold others."""

    from factory.materials import fitting, sources
    from manifests import materials as catalogue
    from manifests.errors import InputError
    from manifests.notices import notice

    result, recipe = _sources_and_recipe(options)
    maps, title, credit = _light_maps(options.light), options.title, sources.credit(result)
    older: list[Entry] = []
    if options.out.exists():
        before = catalogue.read_catalogue(options.out)
        older, title = [e for e in before.materials if e.name not in result], title or before.title
        for entry in older:  # they are compared with the new ones, and written again
            catalogue.material(entry, options.out)
        credit = before.credit if credit in before.credit else f"{before.credit}; {credit}"
        if tuple(maps) != before.light_maps:
            same = " ".join(f"--light {n}" for n in before.light_maps) or "no --light"
            raise InputError(
                "--light",
                f"the maps of {options.out}",
                ", ".join(maps) or "none",
                f"give {same}, or another --out",
            )
    entries = fitting.fit_all(result, recipe, maps, options.out, options.workers)
    fitting.write_catalogue([*older, *entries], options.out, title or "Own materials", credit, maps)
    for names in fitting.duplicates([*older, *entries]):
        notice(f"the same fit under several names: {', '.join(names)}")
    _summary(options.out, entries)


def _summary(path: Path, entries: Sequence[Entry]) -> None:
    """Print how well the entries of a catalogue fit."""
    import numpy as np

    agreement = [e.errors.nodes_vs_label.mean for e in entries]
    drift = [e.errors.nodes_vs_source.mean for e in entries]
    print(
        f"{path}: {number_of(len(entries), 'material')}; relative L1 of label and nodes:"
        f" median {np.median(agreement):.4f}, worst {max(agreement):.4f}; of nodes and measurement:"
        f" median {np.median(drift):.4f}, worst {max(drift):.4f}"
    )
