"""`shapes`: list, preview, add and collect the objects that are rendered."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from factory.commands.actions import add_action, add_command, add_picture_output
from factory.commands.mesh_options import add_reading, reading_options
from factory.commands.shape_libraries import add_add, add_collect
from manifests.wording import number_of

if TYPE_CHECKING:
    from factory.shapes.mesh import Mesh

EPILOG = """examples:
  python -m factory shapes list
  python -m factory shapes list --category chair ~/meshes
  python -m factory shapes preview --family chair --count 20 --out chairs.png
  python -m factory shapes preview car:3 sphere my/kettle.obj --out three.png
  python -m factory shapes add my/kettle.obj --category object --library my-shapes --licence CC0

A shape is FAMILY:SEED (such as chair:3 or vessel:0; `shapes list` names all families, and a seed is
any whole number), a primitive (sphere, cube, torus, disc or blob), or a mesh file (OBJ, PLY, GLB,
STL or OFF). LIBRARY.sh3f#NAME is a piece of one of Sweet Home 3D's furniture libraries."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `shapes`."""
    actions = add_command(
        subparsers,
        "shapes",
        "list, preview, add and collect the objects that are rendered",
        "Lists, previews, adds and collects the objects that are rendered. The program makes them"
        " from a seed, or reads them from your mesh files.",
        EPILOG,
    )
    _add_list(actions)
    _add_preview(actions)
    add_add(actions)
    add_collect(actions)


def _add_list(actions: argparse._SubParsersAction) -> None:
    one = add_action(
        actions,
        "list",
        run_list,
        "list the families and primitives, or check and list every mesh of a folder",
        "python -m factory shapes list --category chair ~/meshes",
    )
    one.add_argument(
        "folder",
        nargs="?",
        type=Path,
        metavar="FOLDER",
        help="a folder of meshes (ShapeNet's layout is understood), a .sh3f library, or one file",
    )
    one.add_argument(
        "--category", help="list only this category: car, chair, sofa, monitor or object"
    )
    add_reading(one)


def _add_preview(actions: argparse._SubParsersAction) -> None:
    one = add_action(
        actions,
        "preview",
        run_preview,
        "draw a picture of many shapes, without Blender",
        "python -m factory shapes preview --family chair --count 20 --out chairs.png",
    )
    one.add_argument(
        "shapes",
        nargs="*",
        metavar="SHAPE",
        help="FAMILY:SEED, a primitive, a mesh file, or a folder of mesh files",
    )
    one.add_argument(
        "--family", metavar="FAMILY", help="draw successive seeds of this family as well"
    )
    one.add_argument(
        "--count",
        type=int,
        metavar="N",
        help="number of seeds of the family (default: the paper's number of models)",
    )
    one.add_argument(
        "--first",
        type=int,
        default=0,
        metavar="SEED",
        help="first seed of the family (default: %(default)s)",
    )
    one.add_argument(
        "--size",
        type=int,
        default=160,
        metavar="N",
        help="width and height of each picture in pixels (default: %(default)s)",
    )
    one.add_argument(
        "--azimuths",
        default="37",
        metavar="A,…",
        help=(
            "viewing directions in degrees from the object's front, with commas between them; each"
            " shape is drawn from all of them (default: %(default)s)"
        ),
    )
    add_picture_output(one)
    add_reading(one)


def _is_file(spec: str) -> bool:
    from factory.shapes.catalogue import FAMILIES, GENERAL, PRIMITIVES

    return spec.partition(":")[0] not in (*FAMILIES, *GENERAL, *PRIMITIVES)


def run_list(options: argparse.Namespace) -> int:
    """Print the families, or one line for each mesh; return 1 if a mesh was refused, else 0."""
    if options.folder is None:
        _print_families(options.category)
        return 0
    return _print_meshes(options)


def _print_families(requested: str | None) -> None:
    from factory.shapes.catalogue import PAPER_COUNTS, PRIMITIVES
    from factory.shapes.general import FAMILIES, TEST_ONLY

    print("family   a shape is FAMILY:SEED, with any seed; the family's segments")
    regions = {
        "car": "body | wheels, glass, trim",
        "chair": "seat, back | frame",
        "sofa": "upholstery | feet, frame",
        "monitor": "screen | casing",
    }
    for family, count in PAPER_COUNTS.items():
        if requested in (None, family):
            print(
                f"{family:<8} {family}:0 … {family}:{count - 1} are as many as the paper uses;"
                f" {regions[family]}"
            )
    if requested is None:
        print(f"general families, for variety: {', '.join(FAMILIES)}")
        print(f"families only for testing, never for training: {', '.join(TEST_ONLY)}")
    if requested in (None, "primitive"):
        print(f"primitives: {', '.join(PRIMITIVES)} (sphere:LEVEL, blob:SEED)")


def _print_meshes(options: argparse.Namespace) -> int:
    from factory.shapes.libraries import find
    from factory.shapes.mesh_import import open_mesh
    from manifests.errors import InputError
    from manifests.progress import tqdm

    entries = [
        entry for entry in find(options.folder) if options.category in (None, entry.category)
    ]
    failed = 0
    hashes: dict[str, str] = {}
    for entry in tqdm(entries, unit="mesh", disable=None):
        try:
            mesh = open_mesh(
                entry.place,
                category=entry.category,
                name=entry.name,
                **reading_options(options),
            )
        except InputError as problem:
            tqdm.write(f"{entry.name}: {problem}")
            failed += 1
            continue
        duplicate = f"; the same as {hashes[mesh.hash]}" if mesh.hash in hashes else ""
        hashes.setdefault(mesh.hash, entry.name)
        licence = f" [{entry.licence}]" if entry.licence else ""
        tqdm.write(
            f"{entry.category:<8} {entry.name:<36} {mesh.hash[:12]} "
            f" {mesh.report.line()}{duplicate}{licence}"
        )
    duplicates = len(entries) - failed - len(hashes)
    meshes = number_of(len(entries), "mesh", "meshes")
    print(f"{meshes}, {failed} refused, {number_of(duplicates, 'duplicate')}")
    return 1 if failed else 0


def run_preview(options: argparse.Namespace) -> int:
    """Write the picture; return 1 if a shape could not be read, else 0."""
    import numpy as np

    from factory.shapes.catalogue import load, specs
    from factory.shapes.contact_sheet import contact_sheet
    from manifests.errors import InputError
    from manifests.files import write_image
    from manifests.notices import notice
    from manifests.progress import tqdm

    if not 16 <= options.size <= 2048:
        raise InputError(
            "--size", "16 to 2048 pixels", str(options.size), "160 suits a contact sheet"
        )
    if (options.count is not None and options.count < 1) or options.first < 0:
        raise InputError(
            "--count and --first",
            "a count ≥ 1 and a seed ≥ 0",
            f"{options.count} and {options.first}",
            "--count 20 --first 0 draws the seeds 0 to 19",
        )
    try:
        azimuths = tuple(np.radians([float(a) for a in options.azimuths.split(",")]))
    except ValueError:
        raise InputError(
            "--azimuths", "degrees with commas between", f"'{options.azimuths}'", "write 0,90,180"
        ) from None
    chosen = [place for shape in options.shapes for place in _places(shape)]
    if options.family:
        chosen += specs(options.family, options.count, options.first)
    if not chosen:
        raise InputError(
            "preview", "shapes or --family", "neither", "see python -m factory shapes list"
        )
    failed: list[InputError] = []

    def meshes() -> Iterator[Mesh | str]:
        for spec in tqdm(chosen, unit="shape", disable=None):
            try:
                yield load(spec, **(reading_options(options) if _is_file(spec) else {}))
            except InputError as problem:
                failed.append(problem)
                notice(problem)
                yield str(problem)

    from PIL import Image

    options.out.parent.mkdir(parents=True, exist_ok=True)  # before the pictures are rendered
    montage = contact_sheet(meshes(), len(chosen), size=options.size, azimuths=azimuths)
    write_image(options.out, montage.quantize(128, dither=Image.Dither.NONE), "PNG", optimize=True)
    return 1 if failed else 0


def _places(shape: str) -> list[str]:
    """Return the meshes of a folder or a library, or the shape itself."""
    path = Path(shape)
    if path.is_dir() or (path.suffix.lower() == ".sh3f" and path.is_file()):
        from factory.shapes.libraries import find

        return [entry.place for entry in find(path)]
    return [shape]
