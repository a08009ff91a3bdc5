"""`shapes`: list, look at and add the objects that are rendered."""

import argparse
from pathlib import Path

CATEGORIES = ("car", "chair", "sofa", "monitor")
EPILOG = """examples:
  python -m factory shapes list
  python -m factory shapes list --category chair ~/meshes
  python -m factory shapes preview --family chair --count 20 --out chairs.png
  python -m factory shapes preview car:3 sphere my/kettle.obj --out three.png
  python -m factory shapes add my/kettle.obj --category object --library my-shapes --licence CC0
A shape is FAMILY:SEED (car, chair, sofa, monitor; any whole number), a primitive (sphere, cube, torus, disc, blob), or a mesh file:
OBJ, PLY, GLB, STL, OFF, or LIBRARY.sh3f#NAME of Sweet Home 3D's furniture libraries."""


def register(subparsers):
    parser = subparsers.add_parser(
        "shapes",
        help="objects to render: list, preview, add",
        description=(
            "The objects that are rendered: made by the program from a seed, or read from your mesh"
            " files."
        ),
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(required=True, metavar="ACTION")

    one = actions.add_parser(
        "list", help="the families and primitives, or every mesh of a folder with a report of each"
    )
    one.add_argument(
        "folder",
        nargs="?",
        type=Path,
        metavar="FOLDER",
        help="a folder of meshes (ShapeNet's layout too), a .sh3f, or one file",
    )
    one.add_argument("--category", help="only this one: car, chair, sofa, monitor, object")
    _reading(one)
    one.set_defaults(run=run_list)

    one = actions.add_parser("preview", help="a picture of many shapes, drawn without Blender")
    one.add_argument(
        "shapes",
        nargs="*",
        metavar="SHAPE",
        help="FAMILY:SEED, a primitive, a mesh file, or a folder of them",
    )
    one.add_argument("--family", choices=CATEGORIES, help="show the first seeds of a family")
    one.add_argument(
        "--count",
        type=int,
        metavar="N",
        help="how many seeds of the family (default: the paper's number of models)",
    )
    one.add_argument(
        "--first", type=int, default=0, metavar="SEED", help="the first seed (default: %(default)s)"
    )
    one.add_argument(
        "--size",
        type=int,
        default=160,
        metavar="N",
        help="pixels along one picture (default: %(default)s)",
    )
    one.add_argument(
        "--azimuths",
        default="37",
        metavar="A,…",
        help=(
            "degrees from the object's front; several: each shape from several sides (default:"
            " %(default)s)"
        ),
    )
    one.add_argument("--out", required=True, type=Path, metavar="PNG", help="the picture to write")
    _reading(one)
    one.set_defaults(run=run_preview)

    one = actions.add_parser(
        "add", help="check and clean mesh files and copy them into a folder of your own"
    )
    one.add_argument("files", nargs="+", metavar="FILE", help="mesh files, or LIBRARY.sh3f#NAME")
    one.add_argument(
        "--library",
        required=True,
        type=Path,
        metavar="DIR",
        help="the folder; made if it is not there",
    )
    one.add_argument("--name", help="its name there (one FILE only; default: the file's)")
    one.add_argument(
        "--category", help="car, chair, sofa, monitor or object (default: guessed from the path)"
    )
    one.add_argument(
        "--licence",
        default="unknown",
        help="the licence, kept with every data set it appears in (default: %(default)s)",
    )
    _reading(one)
    one.set_defaults(run=run_add)


def _reading(parser):
    group = parser.add_argument_group("how mesh files are read")
    group.add_argument(
        "--up",
        metavar="AXIS",
        help=(
            "the file's axis that points up, such as y or -z (default: y for OBJ and GLB, z for"
            " others)"
        ),
    )
    group.add_argument(
        "--front",
        metavar="AXIS",
        help="the file's axis to the object's front (default: z for OBJ and GLB, x for others)",
    )
    group.add_argument(
        "--crease",
        type=float,
        metavar="DEG",
        help="faces that meet at less look smooth (default: 45)",
    )
    group.add_argument(
        "--segments",
        choices=("one", "materials"),
        help="materials: each material of an OBJ becomes a region of its own (default: one)",
    )
    group.add_argument(
        "--max-triangles", type=int, metavar="N", help="refuse larger meshes (default: 2,000,000)"
    )


def _options(options):
    named = {
        "up": options.up,
        "front": options.front,
        "crease_deg": options.crease,
        "segments": options.segments,
    }
    named["maximum_triangles"] = options.max_triangles
    return {key: value for key, value in named.items() if value is not None}


def _is_file(spec):
    from factory.shapes.catalogue import FAMILIES, PRIMITIVES

    return spec.partition(":")[0] not in FAMILIES + PRIMITIVES


def run_list(options):
    from factory.shapes.catalogue import PAPER_COUNTS, PRIMITIVES

    if options.folder is None:
        print("family   a shape is FAMILY:SEED, any seed; segments")
        regions = {
            "car": "body | wheels, glass, trim",
            "chair": "seat, back | frame",
            "sofa": "upholstery | feet, frame",
            "monitor": "screen | casing",
        }
        for family, count in PAPER_COUNTS.items():
            if options.category in (None, family):
                print(
                    f"{family:<8} {family}:0 … {family}:{count - 1} in the paper's number;"
                    f" {regions[family]}"
                )
        if options.category in (None, "primitive"):
            print(f"primitives: {', '.join(PRIMITIVES)} (sphere:LEVEL, blob:SEED)")
        return 0
    from tqdm import tqdm

    from factory.shapes.libraries import find
    from factory.shapes.mesh_import import open_mesh
    from manifests.errors import InputError

    entries = [
        entry for entry in find(options.folder) if options.category in (None, entry.category)
    ]
    failed, hashes = 0, {}
    for entry in tqdm(entries, unit="mesh", disable=None):
        try:
            mesh = open_mesh(
                entry.place, category=entry.category, name=entry.name, **_options(options)
            )
        except InputError as problem:
            tqdm.write(f"{entry.name}: {problem}")
            failed += 1
            continue
        twin = f"; the same as {hashes[mesh.hash]}" if mesh.hash in hashes else ""
        hashes.setdefault(mesh.hash, entry.name)
        licence = f" [{entry.licence}]" if entry.licence else ""
        tqdm.write(
            f"{entry.category:<8} {entry.name:<36} {mesh.hash[:12]} "
            f" {mesh.report.line()}{twin}{licence}"
        )
    print(f"{len(entries)} meshes, {failed} refused, {len(entries) - failed - len(hashes)} twins")
    return 1 if failed else 0


def run_preview(options):
    import numpy as np
    from tqdm import tqdm

    from factory.shapes.catalogue import load, specs
    from factory.shapes.contact_sheet import contact_sheet
    from manifests.errors import InputError
    from manifests.files import write_image

    if not 16 <= options.size <= 2048:
        raise InputError(
            "--size", "16 to 2048 pixels", str(options.size), "160 suits a contact sheet"
        )
    if (options.count is not None and options.count < 1) or options.first < 0:
        raise InputError(
            "--count and --first",
            "a count ≥ 1 and a seed ≥ 0",
            f"{options.count} and {options.first}",
            "name others",
        )
    try:
        azimuths = tuple(np.radians([float(a) for a in options.azimuths.split(",")]))
    except ValueError:
        raise InputError(
            "--azimuths", "degrees with commas between", f"'{options.azimuths}'", "write 0,90,180"
        ) from None
    chosen = [place for shape in options.shapes for place in _unfolded(shape)]
    if options.family:
        chosen += specs(options.family, options.count, options.first)
    if not chosen:
        raise InputError(
            "preview", "shapes or --family", "neither", "see python -m factory shapes list"
        )
    failed = []

    def meshes():
        for spec in tqdm(chosen, unit="shape", disable=None):
            try:
                yield load(spec, **(_options(options) if _is_file(spec) else {}))
            except InputError as problem:
                failed.append(problem)
                tqdm.write(f"factory: {problem}")
                yield str(problem)

    from PIL import Image

    sheet = contact_sheet(meshes(), len(chosen), size=options.size, azimuths=azimuths)
    write_image(options.out, sheet.quantize(128, dither=Image.Dither.NONE), "PNG", optimize=True)
    return 1 if failed else 0


def _unfolded(shape):
    """A folder's or a library's meshes, or the shape itself."""
    path = Path(shape)
    if path.is_dir() or (path.suffix.lower() == ".sh3f" and path.is_file()):
        from factory.shapes.libraries import find

        return [entry.place for entry in find(path)]
    return [shape]


def run_add(options):
    from tqdm import tqdm

    from factory.shapes.library import add
    from factory.shapes.mesh_import import open_mesh
    from manifests.errors import InputError

    if options.name and len(options.files) > 1:
        raise InputError(
            "--name", "one FILE", str(len(options.files)), "add them one by one, or without --name"
        )
    for file in tqdm(options.files, unit="mesh", disable=None):
        mesh = open_mesh(file, name=options.name, category=options.category, **_options(options))
        source = Path(file.partition("?")[0]).name
        path = add(mesh, options.library, source=source, licence=options.licence)
        tqdm.write(
            f"{path}: {mesh.report.line()}; hash {mesh.hash[:12]}, licence {options.licence}"
        )
    return 0
