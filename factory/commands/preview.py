"""`preview DIR`: a contact sheet of a data set, as a picture and as a web page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from manifests.help_format import HelpFormatter
from manifests.wording import number_of

if TYPE_CHECKING:
    from manifests.schema import Record
    from manifests.store import Store

EPILOG = """examples:
  python -m factory preview out/demo
  python -m factory preview out/demo --material brass --count 6 --out brass-preview"""
LARGEST = 1 << 25  # pixels of all records' pictures; 24 of 1,024² took 1.2 GB of memory


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `preview`."""
    parser = subparsers.add_parser(
        "preview",
        help="draw a contact sheet of a data set's pictures, normals, lights and labels",
        description=(
            "Draws a contact sheet of records from all over a data set. Each row shows a picture,"
            " its normals, its segments in shades of grey, the light on a mirror sphere, what the"
            " rendering layer makes of the material's label (without shadows or interreflection),"
            " and the difference between the two pictures, four times as bright."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the data set's folder")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="folder for sheet.png and index.html (default: DIR-preview)",
    )
    parser.add_argument(
        "--count", type=int, default=24, metavar="N", help="number of records (default 24)"
    )
    parser.add_argument(
        "--size",
        type=int,
        default=128,
        metavar="PIXELS",
        help="width and height of each picture (default 128)",
    )
    parser.add_argument("--material", metavar="NAME", help="show only records with this material")
    parser.add_argument(
        "--tier", choices=("direct", "shadow", "full"), help="show only records of this tier"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace results that exist already"
    )
    parser.set_defaults(run=run, result_folders=("out",))


def run(options: argparse.Namespace) -> int:
    """Write sheet.png and index.html; return 0."""
    from factory.preview.contact_sheet import caption, draw, page, row
    from manifests import files, outputs
    from manifests.errors import InputError
    from manifests.materials import load_catalogue
    from manifests.object_store import is_url
    from manifests.progress import tqdm
    from manifests.store import Store

    store, folder = Store(options.folder), options.folder
    if folder.name in ("", ".."):
        folder = folder.resolve()
    out = options.out or folder.with_name(folder.name + "-preview")
    if not is_url(folder):  # a URL is refused as a data set
        outputs.try_folder(out)  # without --out, `require_places` has nothing to try
    dataset = store.dataset()
    materials = load_catalogue(options.folder / "materials.json")
    if not (1 <= options.count <= 1000 and 16 <= options.size <= 2048):
        raise InputError(
            "preview",
            "--count 1 to 1000 and --size 16 to 2048",
            f"{options.count} and {options.size}",
            "--count 24 --size 128 suits most",
        )
    outputs.reserve_outputs(out, ("sheet.png", "index.html"), options.overwrite)
    chosen = choose_records(store, options)
    if not chosen:
        raise InputError(
            options.folder,
            "records",
            "none that fit",
            "render some, or leave out --material and --tier",
        )
    if (pixels := len(chosen) * options.size**2) > LARGEST:
        raise InputError(
            "preview",
            f"{LARGEST:,} pixels of pictures at most",
            f"{pixels:,} in {number_of(len(chosen), 'picture')} of {options.size}²",
            "give a smaller --count or --size",
        )
    rows = [
        row(store, dataset, materials, record, options.size)
        for record in tqdm(chosen, desc="preview", unit="record", delay=1.0)
    ]
    captions = [caption(record) for record in chosen]
    out.mkdir(parents=True, exist_ok=True)
    with files.transaction():
        files.write_image(out / "sheet.png", draw(rows, captions, options.size))
        files.write_text(
            out / "index.html", page(folder.name, rows, captions, [r.id for r in chosen])
        )
    print(f"{out / 'index.html'}: {number_of(len(chosen), 'record')}")
    return 0


def choose_records(store: Store, options: argparse.Namespace) -> list[Record]:
    """Return at most --count records of the requested material and tier, spread over the data set.

    The sorted records are divided into --count equal strata; the place of the chosen record within
    its stratum follows the golden ratio.
    """
    fits = [
        r
        for r in store.records()
        if options.material in (None, *r.materials) and options.tier in (None, r.tier)
    ]
    fits.sort(
        key=lambda r: (r.shape, r.materials, r.light, r.tier, r.light_resolution, r.viewpoint, r.id)
    )
    count = min(options.count, len(fits))
    return [fits[int((k + 0.618034 * k % 1) * len(fits) / count)] for k in range(count)]
