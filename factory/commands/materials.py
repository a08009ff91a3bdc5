"""`materials`: list, preview, report, export, fit and add measured materials."""

import argparse
import shutil
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from factory.commands import material_export, material_fitting
from factory.commands.actions import add_action, add_catalogues, add_command, add_picture_output
from manifests.wording import number_of

if TYPE_CHECKING:
    from manifests.materials import Material

EPILOG = """examples:
  python -m factory materials list
  python -m factory materials preview --out materials.png
  python -m factory materials export --blend library/library.blend
  python -m factory materials add my-merl-folder --only my-wood --out my-materials.json
  python -m factory materials fit merl_nbrdf.npz --workers 2 --out materials.json

A SOURCE is an npz of Neural-BRDF weights (arrays `names` and `weights`), a folder of MERL .binary
files, or one such file."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `materials`."""
    actions = add_command(
        subparsers,
        "materials",
        "list, preview, report, export, fit and add measured materials",
        "Works with measured materials. Each has a label (108 numbers, which the layer uses) and a"
        " mixture of closures (which Cycles renders).",
        EPILOG,
    )
    _add_list(actions)
    _add_preview(actions)
    _add_report(actions)
    _add_condition(actions)
    material_export.add(actions)
    material_fitting.add(
        actions,
        "fit",
        material_fitting.run_fit,
        "fit every material of a source into a new catalogue, or continue a fit that was stopped",
        "python -m factory materials fit merl_nbrdf.npz --workers 2 --out materials.json",
    )
    material_fitting.add(
        actions,
        "add",
        material_fitting.run_add,
        "fit materials of your own, and write them to a catalogue beside those already in it",
        "python -m factory materials add my-merl-folder --only my-wood --out my-materials.json",
    )


def _add_list(actions: argparse._SubParsersAction) -> None:
    one = add_action(
        actions,
        "list",
        run_list,
        "print the names of all materials by family, or a table with the errors of their fits",
        "python -m factory materials list --errors",
    )
    add_catalogues(one)
    one.add_argument(
        "--errors",
        action="store_true",
        help="print a table with each material's split, number of closures and errors of its fit",
    )


def _add_preview(actions: argparse._SubParsersAction) -> None:
    one = add_action(
        actions,
        "preview",
        run_preview,
        "draw a contact sheet with a sphere of each material under a light",
        "python -m factory materials preview brass pink-felt --light city --out two.png",
    )
    one.add_argument(
        "materials", nargs="*", metavar="MATERIAL", help="names of materials (default: all)"
    )
    add_catalogues(one)
    one.add_argument(
        "--light",
        default="courtyard",
        metavar="LIGHT",
        help="name or file of the light map (default: %(default)s)",
    )
    one.add_argument(
        "--of",
        choices=("label", "nodes", "both"),
        default="both",
        help=(
            "what to draw: the label, the mixture of closures (nodes), or both, the label above"
            " the nodes (default: %(default)s)"
        ),
    )
    one.add_argument(
        "--size",
        type=int,
        default=96,
        metavar="N",
        help="diameter of each sphere in pixels (default: %(default)s)",
    )
    one.add_argument(
        "--columns",
        type=int,
        default=13,
        metavar="N",
        help="number of spheres per row (default: %(default)s)",
    )
    add_picture_output(one)


def _add_report(actions: argparse._SubParsersAction) -> None:
    one = add_action(
        actions,
        "report",
        run_report,
        "compare a catalogue's fit errors with their limits, as a table and plots",
        "python -m factory materials report my-materials.json --out report",
    )
    one.add_argument(
        "catalogue",
        nargs="?",
        type=Path,
        metavar="FILE",
        help="a catalogue (default: the built-in one of MERL)",
    )
    one.add_argument(
        "--source",
        type=Path,
        metavar="SOURCE",
        help="the measurements, which --abc compares with the table of ABC models",
    )
    one.add_argument(
        "--abc",
        type=Path,
        metavar="CSV",
        help="a table of ABC microfacet parameters of the same materials",
    )
    one.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="DIR",
        help="folder for the results: report.md, report.json and errors.png",
    )
    one.set_defaults(result_folders=("out",))


def _add_condition(actions: argparse._SubParsersAction) -> None:
    one = add_action(
        actions,
        "condition",
        run_condition,
        "measure how far labels move when noise is added to the measurement",
        "python -m factory materials condition merl_nbrdf.npz --only brass pink-felt",
    )
    one.add_argument("source", type=Path, metavar="SOURCE", help=material_fitting.SOURCE_HELP)
    one.add_argument(
        "--only", nargs="+", required=True, metavar="NAME", help="names of the materials to measure"
    )
    one.add_argument(
        "--noise",
        type=float,
        default=0.01,
        metavar="X",
        help="relative standard deviation of the noise (default: %(default)s)",
    )
    one.add_argument(
        "--draws",
        type=int,
        default=3,
        metavar="N",
        help="number of noisy copies of each material (default: %(default)s)",
    )


def run_list(options: argparse.Namespace) -> None:
    """Print the materials' names, or with --errors a table."""
    from manifests.described_materials import DESCRIBED
    from manifests.materials import load_catalogue

    materials = load_catalogue(*(options.catalogue or ()))
    if options.errors:
        _print_errors(materials)
        return
    if not options.catalogue:
        print("Everyday materials, described by numbers. They are for edits, not for data sets:")
        print(f"{_wrapped(DESCRIBED)}\n\nMeasured materials:")
    families = sorted({m.family for m in materials.values()})
    for family in families:
        names = [
            m.name + "*" * (m.split == "test") for m in materials.values() if m.family == family
        ]
        print(f"{family}\n{_wrapped(names)}")
    if any(m.split == "test" for m in materials.values()):
        print("* is kept for testing (docs/materials.md, Splits).")


def _wrapped(names: Iterable[str]) -> str:
    """Return names as indented lines that fit the terminal; names are not divided."""
    width = min(shutil.get_terminal_size((100, 24)).columns, 100)
    return textwrap.fill(
        ", ".join(names),
        width,
        initial_indent="  ",
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _print_errors(materials: "Mapping[str, Material]") -> None:
    """Print one line for each material, and what the columns mean."""
    import numpy as np

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
        "L–N: relative L1 of label and nodes, mean of six view angles; worst: the largest of the"
        " six; N–M: relative L1 of nodes and measurement;"
    )
    print(
        "display L2: mean squared difference, of values in [0, 255], between pictures of a sphere"
        " rendered from label and nodes"
    )


def run_preview(options: argparse.Namespace) -> None:
    """Write the contact sheet."""
    from factory.lights import load
    from factory.materials.preview import contact_sheet
    from manifests.errors import InputError
    from manifests.files import write_image
    from manifests.materials import find, load_catalogue
    from manifests.progress import tqdm

    if not 16 <= options.size <= 512 or not 1 <= options.columns <= 64:
        raise InputError(
            "--size, --columns",
            "16 to 512 pixels, 1 to 64 columns",
            f"{options.size}, {options.columns}",
            "96 pixels and 13 columns suit most",
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

    def watch(items: Iterable) -> Iterable:
        return tqdm(items, unit="material", desc="shading", leave=False, disable=None)

    picture = contact_sheet(
        chosen, light.L64, options.size, min(options.columns, len(chosen)), options.of, watch
    )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_image(options.out, picture, "PNG")
    print(f"{options.out}: {number_of(len(chosen), 'material')} under {options.light}")


def run_report(options: argparse.Namespace) -> None:
    """Write the report, and print its verdict."""
    from factory.materials import report
    from manifests.materials import BUILT_IN

    print(report.write(options.catalogue or BUILT_IN[0], options.out, options.source, options.abc))


def run_condition(options: argparse.Namespace) -> None:
    """Print one line for each material."""
    import numpy as np

    from factory.materials import conditioning, recipe, sources

    result = sources.load(options.source, options.only)
    print(
        "how far the label moves: median and 95th percentile over its numbers and the draws; L1:"
        " relative L1 of the BRDF, mean over the draws"
    )
    print(f"{'name':<26} {'|Δ log κ|':>16} {'|Δ log γ|':>16} {'L1':>8}")
    for name, source in result.items():
        rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=tuple(name.encode())))
        numbers, l1 = conditioning.fit_perturbed(
            source.measured, recipe.Recipe(), options.noise, options.draws, rng
        )
        kappa, gamma = (np.percentile(np.abs(numbers[:, :, :, i]), (50, 95)) for i in (0, 1))
        print(
            f"{name:<26} {kappa[0]:>8.3f}{kappa[1]:>8.2f} {gamma[0]:>8.3f}{gamma[1]:>8.2f}"
            f" {l1.mean():>8.4f}",
            flush=True,
        )
