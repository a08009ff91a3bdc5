"""`export DIR`: a data set in the formats that people train from, or its own files in tars."""

import argparse
from pathlib import Path

from manifests.exporting import FORMATS
from manifests.help_format import HelpFormatter
from manifests.option_types import positive

EPILOG = """examples:
  python -m factory export out/demo --to webdataset --out demo-shards
  python -m factory export out/demo --to huggingface --out demo-hub --by "A. Name"
  python -m factory export out/demo --parquet demo.parquet
  python -m factory export out/demo --tars demo-tars --split train

Run the same --to command again to continue: files that exist are whole and stay.
docs/exporting.md describes the formats."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `export`."""
    parser = subparsers.add_parser(
        "export",
        help="write a data set as WebDataset, Parquet, Hugging Face or HDF5 files",
        description=(
            "Writes a data set in formats that other programs and object stores read. Records are"
            " written in the order of their ids; ids are hashes, so this order is random."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("folder", metavar="DIR", help="the data set's folder")
    parser.add_argument(
        "--to",
        choices=FORMATS,
        help=(
            "write pictures, geometry, records and labels in this format to --out, with a data card"
            " (hdf5: files as BlenderProc writes them)"
        ),
    )
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="the folder of --to")
    parser.add_argument(
        "--by", default="", metavar="NAME", help="who rendered it, for the data card of --to"
    )
    parser.add_argument(
        "--parquet",
        type=Path,
        metavar="FILE",
        help="write the records as a table to FILE (needs the package pyarrow)",
    )
    parser.add_argument(
        "--tars",
        type=Path,
        metavar="DIR2",
        help=(
            "write records, pictures and geometry as tar files to DIR2, with dataset.json,"
            " materials.json and the light maps beside them"
        ),
    )
    parser.add_argument(
        "--split",
        choices=("train", "test", "mixed"),
        help="export only the records of this split (default: all)",
    )
    parser.add_argument(
        "--each",
        type=positive,
        default=1000,
        metavar="N",
        help="number of samples per file, of hdf5 per folder (default 1000)",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write what the options name; return 0."""
    from tqdm import tqdm

    from manifests.errors import InputError
    from manifests.export import to_parquet, to_tars
    from manifests.store import Store

    store = Store(options.folder)
    store.dataset()
    if (options.to is None) != (options.out is None):
        raise InputError("export", "--to and --out together", "one of them", "give both")
    if not (options.to or options.parquet or options.tars):
        expected = "--to FORMAT --out FOLDER, --parquet FILE or --tars DIR2"
        raise InputError("export", expected, "none of them", "give one of them")
    if options.to:
        from manifests.exporting.folders import export

        with tqdm(desc="exporting", unit="sample", delay=1.0) as bar:
            result = export(
                store,
                options.out,
                options.to,
                options.split,
                options.each,
                options.by,
                bar.update,
            )
        line = f"{options.out}: {result.samples} samples, {result.made} files written"
        print(line + (f", {result.already_there} were there" if result.already_there else ""))
    if options.tars:  # first: it may be refused, and then nothing is written
        with tqdm(desc="exporting", unit="record", delay=1.0) as bar:
            count = to_tars(store, options.tars, options.split, options.each, bar.update)
        print(f"{options.tars}: {count} tars")
    if options.parquet:
        print(f"{options.parquet}: {to_parquet(store, options.parquet, options.split)} records")
    return 0
