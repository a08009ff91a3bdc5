"""`export DIR`: a dataset for other programs, as a Parquet table of its records or as WebDataset
tar files.
"""


def register(subparsers):
    """Add the parser of `export`."""
    from pathlib import Path

    parser = subparsers.add_parser(
        "export",
        help="write records as a Parquet table, or pictures as WebDataset tars",
        description=(
            "Writes a data set in formats for other programs and for object stores. "
            "Records come in the order of their ids, which is a random one."
        ),
    )
    parser.add_argument("folder", metavar="DIR", help="the dataset's folder")
    parser.add_argument(
        "--parquet", type=Path, metavar="FILE", help="write the records as a table (needs pyarrow)"
    )
    parser.add_argument(
        "--tars",
        type=Path,
        metavar="DIR2",
        help="write records, pictures and geometry as tars, labels and lights beside",
    )
    parser.add_argument(
        "--split", choices=("train", "test", "mixed"), help="export only the records of this split"
    )
    parser.add_argument(
        "--each", type=int, default=1000, metavar="N", help="records per tar (default 1000)"
    )
    parser.set_defaults(run=run)


def run(options):
    """Write what is asked for; 0."""
    from tqdm import tqdm

    from manifests.errors import InputError
    from manifests.export import to_parquet, to_tars
    from manifests.store import Store

    store = Store(options.folder)
    store.dataset()
    if not (options.parquet or options.tars):
        raise InputError("export", "--parquet FILE or --tars DIR2", "neither", "name what to write")
    if options.each < 1:
        raise InputError("--each", "1 or more", str(options.each), "1000 suits most")
    if options.tars:  # first: it may be refused, and then nothing is written
        with tqdm(desc="exporting", unit="record", delay=1.0) as bar:
            count = to_tars(store, options.tars, options.split, options.each, bar.update)
        print(f"{options.tars}: {count} tars")
    if options.parquet:
        print(f"{options.parquet}: {to_parquet(store, options.parquet, options.split)} records")
    return 0
