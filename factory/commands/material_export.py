"""`materials export` and `materials extension`: materials for Blender and other programs."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from factory.commands.actions import add_action, add_catalogues
from manifests.errors import InputError
from manifests.wording import number_of

if TYPE_CHECKING:
    from manifests.materials import Material

EXTENSION = Path(__file__).resolve().parents[1] / "blender_extension"
EXTENSION_FILES = ("__init__.py", "blender_manifest.toml")
DATE = (1980, 1, 1, 0, 0, 0)  # of every file in the zip, so that equal sources give equal bytes


def add(actions: argparse._SubParsersAction) -> None:
    """Add the actions `export` and `extension`."""
    _add_export(actions)
    one = add_action(
        actions,
        "extension",
        run_extension,
        "build the extension for Blender that lists the material library and makes data sets",
        "python -m factory materials extension --out brdfactory-extension.zip",
    )
    one.add_argument("--out", required=True, type=Path, metavar="ZIP", help="the file to write")
    one.set_defaults(result_files=("out",))
    _add_overwrite(one)


def _add_export(actions: argparse._SubParsersAction) -> None:
    one = add_action(
        actions,
        "export",
        run_export,
        "write materials as assets for Blender, or as approximations for other programs",
        "python -m factory materials export --blend library/library.blend",
    )
    one.add_argument(
        "--blend",
        type=Path,
        metavar="FILE",
        help=(
            "write a library for Blender's asset browser; its catalogues are written beside it, so"
            " give it a folder of its own"
        ),
    )
    one.add_argument(
        "--materialx",
        type=Path,
        metavar="FILE",
        help=(
            "write approximations by MaterialX's standard_surface, each with its error, and a table"
            " of the errors beside it; fitting one takes about one second"
        ),
    )
    one.set_defaults(result_files=("blend", "materialx"))
    one.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="NAME",
        help="write this material; repeat the option for several (default: all)",
    )
    add_catalogues(one)
    one.add_argument(
        "--light",
        default="courtyard",
        metavar="LIGHT",
        help="name or file of the light map of the preview pictures (default: %(default)s)",
    )
    one.add_argument(
        "--size",
        type=int,
        default=128,
        metavar="N",
        help="height and width of the preview pictures in pixels (default: %(default)s)",
    )
    _add_overwrite(one)


def _add_overwrite(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--overwrite", action="store_true", help="replace results that exist already"
    )


def run_export(options: argparse.Namespace) -> None:
    """Write the library, the approximations, or both."""
    from manifests.materials import find, load_catalogue

    if not (options.blend or options.materialx):
        raise InputError("export", "--blend FILE or --materialx FILE", "neither", "give one")
    if not 16 <= options.size <= 512:
        raise InputError("--size", "16 to 512 pixels", f"{options.size}", "128 suits most")
    catalogues: list[Path] = options.catalogue or []
    materials = load_catalogue(*catalogues)
    chosen = [find(name, materials) for name in dict.fromkeys(options.material)]
    chosen = chosen or sorted(materials.values(), key=lambda m: (m.family, m.name))
    if not chosen:
        raise InputError(
            catalogues[0],
            "a material to export",
            "none",
            "add one: python -m factory materials add",
        )
    if options.blend:
        from factory.render.asset_library import CATALOGUES

        _reserve(options.blend, ".blend", options.overwrite, catalogues, (CATALOGUES,))
    if options.materialx:
        table = _error_table(options.materialx).name
        _reserve(options.materialx, ".mtlx", options.overwrite, catalogues, (table,))
    if options.blend:
        _write_library(options.blend, chosen, options.light, options.size)
    if options.materialx:
        _write_approximations(options.materialx, chosen)


def _reserve(
    path: Path,
    ending: str,
    overwrite: bool,
    inputs: Sequence[Path] = (),
    beside: Sequence[str] = (),
) -> None:
    """Make a file's folder. Raises InputError for another ending, and for a file that exists.

    beside  names of files that are written with it
    """
    from manifests.outputs import reserve_outputs

    if path.suffix != ending:
        raise InputError(path, f"a name that ends in {ending}", path.suffix or "none", "rename it")
    reserve_outputs(path.parent, (path.name, *beside), overwrite, inputs)
    path.parent.mkdir(parents=True, exist_ok=True)


def _write_library(path: Path, chosen: "Sequence[Material]", light: str, size: int) -> None:
    from factory.lights import load
    from factory.materials.preview import cut_out_sphere, light_sphere
    from factory.render import asset_library
    from manifests.progress import tqdm

    sphere, exposure = light_sphere(load(light).L64, size)
    previews = {
        material.name: cut_out_sphere(sphere, material, size, exposure)
        for material in tqdm(chosen, unit="material", desc="preview pictures", disable=None)
    }
    asset_library.write(
        path,
        chosen,
        previews,
        lambda items: tqdm(items, unit="material", desc="materials", disable=None),
    )
    print(f"{path}: {number_of(len(chosen), 'material')}, {path.stat().st_size / 1e6:.1f} MB")


def _error_table(path: Path) -> Path:
    """Return the name of the table of errors beside a MaterialX document."""
    return path.with_name(f"{path.stem}-errors.md")


def _write_approximations(path: Path, chosen: "Sequence[Material]") -> None:
    import numpy as np

    from factory.materials import materialx, standard_surface
    from manifests.files import transaction, write_text
    from manifests.progress import tqdm

    results = {
        material.name: standard_surface.fit(material.mixture)
        for material in tqdm(chosen, unit="material", desc="fitting", disable=None)
    }
    with transaction():
        write_text(path, materialx.document(chosen, results))
        write_text(_error_table(path), materialx.table(chosen, results))
    errors = [result.error for result in results.values()]
    print(
        f"{path}: {number_of(len(chosen), 'material')}; relative L1 median {np.median(errors):.3f},"
        f" worst {max(errors):.3f}"
    )


def run_extension(options: argparse.Namespace) -> None:
    """Write the zip."""
    from manifests.files import write_bytes

    _reserve(options.out, ".zip", options.overwrite)
    write_bytes(options.out, extension_archive())
    print(f"{options.out}: install it in Blender by Preferences, Get Extensions, Install from Disk")


def extension_archive() -> bytes:
    """Return the bytes of the extension's zip; equal sources give equal bytes."""
    import io
    import zipfile

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in EXTENSION_FILES:
            member = zipfile.ZipInfo(name, DATE)
            member.external_attr = 0o644 << 16
            archive.writestr(member, (EXTENSION / name).read_bytes())
    return buffer.getvalue()
