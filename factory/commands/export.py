"""`export DIR`: a data set's records as a Parquet table, or its files as WebDataset tar files."""

import argparse
from pathlib import Path

from manifests.help_format import HelpFormatter
from manifests.option_types import positive

EPILOG = """examples:
  python -m factory export out/demo --parquet demo.parquet
  python -m factory export out/demo --tars demo-tars --split train"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `export`."""
    parser = subparsers.add_parser(
        "export",
        help="write a data set's records as a Parquet table, or its files as WebDataset tars",
        description=(
            "Writes a data set in formats that other programs and object stores read. Records are"
            " written in the order of their ids; ids are hashes, so this order is random."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("folder", metavar="DIR", help="the data set's folder")
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
        help="number of records per tar file (default 1000)",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the table, the tar files, or both; return 0."""
    from tqdm import tqdm

    from manifests.errors import InputError
    from manifests.export import to_parquet, to_tars
    from manifests.store import Store

    store = Store(options.folder)
    store.dataset()
    if not (options.parquet or options.tars):
        raise InputError("export", "--parquet FILE or --tars DIR2", "neither", "give one of them")
    if options.tars:  # first: it may be refused, and then nothing is written
        with tqdm(desc="exporting", unit="record", delay=1.0) as bar:
            count = to_tars(store, options.tars, options.split, options.each, bar.update)
        print(f"{options.tars}: {count} tars")
    if options.parquet:
        print(f"{options.parquet}: {to_parquet(store, options.parquet, options.split)} records")
    return 0
