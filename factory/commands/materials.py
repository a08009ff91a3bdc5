"""`materials`: list, look at, fit, add and report measured materials."""

import argparse
from pathlib import Path

EPILOG = """examples:
  python -m factory materials list
  python -m factory materials preview --out materials.png
  python -m factory materials add my-merl-folder --only my-wood --out my-materials.json
  python -m factory materials fit merl_nbrdf.npz --workers 2 --out materials.json
A SOURCE is an npz of Neural-BRDF weights (arrays `names` and `weights`), a folder of MERL .binary files, or one such file."""
LARGEST_MAP = 1 << 28  # bytes of FILE.npz:ARRAY; a map of 64 × 128 has 0.1 MB
SOURCE_HELP = "npz of Neural-BRDF weights, folder of MERL .binary files, or one such file"


def register(subparsers):
    parser = subparsers.add_parser(
        "materials",
        help="measured materials: list, preview, fit, add, report",
        description=(
            "Measured materials as labels (108 numbers) and as the closure mixtures that Cycles"
            " renders."
        ),
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    _register_looking(actions)
    _register_fitting(actions)


def _register_looking(actions):
    one = actions.add_parser(
        "list", help="name, family, split, closures and fit errors of every material"
    )
    one.add_argument(
        "--catalogue",
        type=Path,
        action="append",
        metavar="FILE",
        help="a catalogue; the built-in ones if none is given",
    )
    one.set_defaults(run=run_list)

    one = actions.add_parser(
        "preview", help="a contact sheet: a ball of each material under a light"
    )
    one.add_argument("materials", nargs="*", metavar="MATERIAL", help="names; all if none is given")
    one.add_argument(
        "--catalogue",
        type=Path,
        action="append",
        metavar="FILE",
        help="a catalogue; the built-in ones if none is given",
    )
    one.add_argument(
        "--light",
        default="courtyard",
        metavar="LIGHT",
        help="name or file of a light map (default: %(default)s)",
    )
    one.add_argument(
        "--of",
        choices=("label", "nodes", "both"),
        default="both",
        help="both: label above, nodes below (the default)",
    )
    one.add_argument(
        "--size", type=int, default=96, metavar="N", help="pixels of a ball (default: %(default)s)"
    )
    one.add_argument(
        "--columns", type=int, default=13, metavar="N", help="balls in a row (default: %(default)s)"
    )
    one.add_argument("--out", required=True, type=Path, metavar="PNG", help="the picture to write")
    one.set_defaults(run=run_preview)

    one = actions.add_parser(
        "report", help="the catalogue's fit errors as a table and plots, against the limits"
    )
    one.add_argument(
        "catalogue",
        nargs="?",
        type=Path,
        metavar="FILE",
        help="a catalogue; MERL's built-in one if none is given",
    )
    one.add_argument(
        "--source",
        type=Path,
        metavar="SOURCE",
        help="the measurements: also set them against an ABC table (--abc)",
    )
    one.add_argument(
        "--abc", type=Path, metavar="CSV", help="ABC microfacet parameters of the same materials"
    )
    one.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="DIR",
        help="folder for report.md, report.json and errors.png",
    )
    one.set_defaults(run=run_report)

    one = actions.add_parser(
        "condition", help="how far labels move when the measurement is 1 %% off"
    )
    one.add_argument("source", type=Path, metavar="SOURCE", help=SOURCE_HELP)
    one.add_argument(
        "--only", nargs="+", required=True, metavar="NAME", help="the materials to try"
    )
    one.add_argument(
        "--noise",
        type=float,
        default=0.01,
        help="relative standard deviation (default: %(default)s)",
    )
    one.add_argument(
        "--draws",
        type=int,
        default=3,
        metavar="N",
        help="noisy copies of each (default: %(default)s)",
    )
    one.set_defaults(run=run_condition)


def _register_fitting(actions):
    for name, text in (
        (
            "fit",
            (
                "fit every material of a source into a new catalogue; the same command continues"
                " where it was stopped"
            ),
        ),
        ("add", "fit materials of your own into a catalogue file, beside those already in it"),
    ):
        one = actions.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        one.add_argument("source", type=Path, metavar="SOURCE", help=SOURCE_HELP)
        one.add_argument(
            "--only", nargs="+", default=[], metavar="NAME", help="only these materials"
        )
        one.add_argument(
            "--workers", type=int, default=1, metavar="N", help="processes (default: %(default)s)"
        )
        one.add_argument(
            "--tolerance",
            type=float,
            metavar="X",
            help="label against nodes, relative L1 that is good enough",
        )
        one.add_argument(
            "--closures",
            type=int,
            nargs="+",
            metavar="K",
            help="numbers of closures to try, fewest first",
        )
        one.add_argument(
            "--light",
            action="append",
            metavar="LIGHT",
            help=(
                "light map for the display errors, repeatable: a name, a file, or FILE.npz:ARRAY;"
                " none: no display errors"
            ),
        )
        one.add_argument("--title", metavar="TEXT", help="the catalogue's title")
        one.add_argument(
            "--out",
            required=True,
            type=Path,
            metavar="FILE",
            help="the catalogue, a JSON file; fits are kept in FILE.fits/",
        )
        one.set_defaults(run=run_fit if name == "fit" else run_add)


def _sources_and_recipe(options):
    from dataclasses import replace

    from factory.materials import recipe, sources
    from factory.materials.node_model import dictionary
    from manifests.errors import InputError

    chosen = recipe.Recipe()
    if options.tolerance is not None:
        if not 1e-4 <= options.tolerance <= 1:
            raise InputError(
                "--tolerance", "0.0001 to 1", f"{options.tolerance:g}", "0.015 is usual"
            )
        chosen = replace(chosen, l1=options.tolerance, worst=3 * options.tolerance)
    if options.closures:
        if sorted(set(options.closures)) != options.closures or not 1 <= options.closures[
            0
        ] <= options.closures[-1] <= len(dictionary()):
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


def _light_maps(names):
    """{name: (height, width, 3)} at unit mean."""
    maps = {}
    for name in names or ():
        maps[name.rpartition(":")[2] if ".npz:" in name else name] = _light_map(name)
    return maps


def _light_map(name):
    import numpy as np

    from factory.lights import load
    from manifests.archives import opened_zip, read_array
    from manifests.errors import InputError, closest
    from shaders import envmap

    if ".npz:" not in name:
        return load(name).L64
    path, _, array = name.rpartition(":")
    with opened_zip(path, "an .npz file of light maps", "name another file") as archive:
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


def run_fit(options):
    from factory.materials import fitting, sources

    result, recipe = _sources_and_recipe(options)
    maps = _light_maps(options.light)
    entries = fitting.fit_all(result, recipe, maps, options.out, options.workers)
    title = options.title or f"{len(entries)} materials fitted from {options.source.name}"
    fitting.write_catalogue(entries, options.out, title, sources.credit(result), maps)
    _summary(options.out, entries)


def run_add(options):
    import sys

    from factory.materials import fitting, sources
    from manifests import materials as catalogue
    from manifests.errors import InputError

    result, recipe = _sources_and_recipe(options)
    maps, older, title, credit = (
        _light_maps(options.light),
        [],
        options.title,
        sources.credit(result),
    )
    if options.out.exists():
        before = catalogue.read_catalogue(options.out)
        older, title = [e for e in before.materials if e.name not in result], title or before.title
        for entry in older:  # they are compared with the new ones, and written again
            catalogue.material(entry, options.out)
        credit = before.credit if credit in before.credit else f"{before.credit}; {credit}"
        if tuple(maps) != before.light_maps:
            given = " ".join(f"--light {n}" for n in before.light_maps) or "no --light"
            raise InputError(
                "--light",
                f"the maps of {options.out}",
                ", ".join(maps) or "none",
                f"give {given}, or another --out",
            )
    entries = fitting.fit_all(result, recipe, maps, options.out, options.workers)
    fitting.write_catalogue([*older, *entries], options.out, title or "Own materials", credit, maps)
    for names in fitting.duplicates([*older, *entries]):
        print(f"the same fit under several names: {', '.join(names)}", file=sys.stderr)
    _summary(options.out, entries)


def _summary(path, entries):
    import numpy as np

    agreement = [e.errors.nodes_vs_label.mean for e in entries]
    drift = [e.errors.nodes_vs_source.mean for e in entries]
    print(
        f"{path}: {len(entries)} materials; label against nodes L1 median"
        f" {np.median(agreement):.4f}, worst {max(agreement):.4f}; nodes against measurement"
        f" {np.median(drift):.4f}, {max(drift):.4f}"
    )


def run_list(options):
    import numpy as np

    from manifests.materials import load_catalogue

    materials = load_catalogue(*(options.catalogue or ()))
    width = max(map(len, materials), default=4)
    print(
        f"{'name':<{width}} {'family':<22} {'split':<5} {'closures':>8} {'L–N':>6} {'worst':>6}"
        f" {'N–M':>6} {'display L2':>10}"
    )
    for m in materials.values():
        e = m.errors
        shown = (
            f"{np.mean(e.nodes_vs_label.display_l2):10.2f}"
            if e.nodes_vs_label.display_l2
            else " " * 10
        )
        figures = (
            f"{e.nodes_vs_label.mean:6.3f} {e.nodes_vs_label.worst:6.3f}"
            f" {e.nodes_vs_source.mean:6.3f}"
        )
        print(
            f"{m.name:<{width}} {m.family:<22} {m.split:<5} {len(m.mixture.kinds):>8} {figures}"
            f" {shown}"
        )
    print(
        "L–N: label against nodes, relative L1, mean of six view angles; worst: of the six; N–M:"
        " nodes against the measurement;"
    )
    print(
        "display L2: label against nodes as pictures of a sphere, mean squared difference of values"
        " in [0, 255]"
    )


def run_preview(options):
    from tqdm import tqdm

    from factory.lights import load
    from factory.materials.preview import contact_sheet
    from manifests.errors import InputError
    from manifests.files import write_image
    from manifests.materials import find, load_catalogue

    if not 16 <= options.size <= 512 or not 1 <= options.columns <= 64:
        raise InputError(
            "--size, --columns",
            "16 to 512 pixels, 1 to 64 columns",
            f"{options.size}, {options.columns}",
            "choose within",
        )
    materials = load_catalogue(*(options.catalogue or ()))
    chosen = [find(name, materials) for name in options.materials] or sorted(
        materials.values(), key=lambda m: (m.family, m.name)
    )
    if not chosen:
        raise InputError(
            options.catalogue[0],
            "a material to draw",
            "none",
            "add one: python -m factory materials add",
        )
    light = load(options.light)

    def watch(items):
        return tqdm(items, unit="material", desc="shading", leave=False, disable=None)

    picture = contact_sheet(
        chosen, light.L64, options.size, min(options.columns, len(chosen)), options.of, watch
    )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_image(options.out, picture, "PNG")
    print(f"{options.out}: {len(chosen)} materials under {options.light}")


def run_report(options):
    from factory.materials import report
    from manifests.materials import BUILT_IN

    print(report.write(options.catalogue or BUILT_IN[0], options.out, options.source, options.abc))


def run_condition(options):
    import numpy as np

    from factory.materials import conditioning, recipe, sources

    result = sources.load(options.source, options.only)
    print(
        "how far the label moves: median and 95th percentile over its numbers and the draws; L1 of"
        " the BRDF, mean over the draws"
    )
    print(f"{'name':<26} {'|Δ log κ|':>16} {'|Δ log γ|':>16} {'L1':>8}")
    for name, source in result.items():
        rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=tuple(name.encode())))
        numbers, l1 = conditioning.perturbed_fits(
            source.measured, recipe.Recipe(), options.noise, options.draws, rng
        )
        kappa, gamma = (np.percentile(np.abs(numbers[:, :, :, i]), (50, 95)) for i in (0, 1))
        print(
            f"{name:<26} {kappa[0]:>8.3f}{kappa[1]:>8.2f} {gamma[0]:>8.3f}{gamma[1]:>8.2f}"
            f" {l1.mean():>8.4f}",
            flush=True,
        )
