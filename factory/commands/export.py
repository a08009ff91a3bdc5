"""`export DIR`: a data set in the formats that people train from, or its own files in tars."""

import argparse
from pathlib import Path

from manifests.exporting import FORMATS
from manifests.help_format import HelpFormatter
from manifests.notices import notice
from manifests.option_types import positive
from manifests.wording import number_of

EPILOG = """examples:
  python -m factory export out/demo --to webdataset --out demo-shards
  python -m factory export out/demo --to huggingface --out demo-hub --by "A. Name"
  python -m factory export out/demo --to records --out demo.parquet
  python -m factory export out/demo --to tars --out demo-tars --split train

Run the same command again to continue: files that exist are complete and are kept. But a table of
records is replaced, and tars need a folder without tars.
docs/exporting.md describes the formats."""

# what is no format of samples: the data set's own files, and a table of its records
OWN = ("tars", "records")
EACH = 1000


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
        choices=(*FORMATS, *OWN),
        help=(
            "the format. webdataset, parquet, huggingface or hdf5 (as BlenderProc writes it):"
            " pictures, geometry, records and labels, with a data card; tars: the data set's own"
            " files, unchanged; records: a table of the records, as one Parquet file"
        ),
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="PATH",
        help="the folder to write to; with --to records, the file",
    )
    parser.add_argument(
        "--by", metavar="NAME", help="who rendered the data set; the data card states it"
    )
    for name, form in (("--parquet", "records"), ("--tars", "tars")):
        parser.add_argument(
            name, type=Path, metavar="PATH", help=f"deprecated: --to {form} --out PATH"
        )
    parser.add_argument(
        "--split",
        choices=("train", "test", "mixed"),
        help="export only the records of this split (default: all)",
    )
    parser.add_argument(
        "--each",
        type=positive,
        metavar="N",
        help=f"number of samples per file, or with hdf5 per folder (default {EACH})",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write what the options name; return 0."""
    from manifests.errors import InputError
    from manifests.export import to_parquet, to_tars
    from manifests.outputs import try_file, try_folder
    from manifests.progress import tqdm
    from manifests.store import Store

    for path in (options.out if options.to == "records" else None, options.parquet):
        if path is not None:
            try_file(path)
            if Path(options.folder).resolve() in path.resolve().parents:
                rule, remedy = "a file outside the data set", "give another --out"
                raise InputError(path, rule, "a place in it", remedy)
    for path in (options.out if options.to not in (None, "records") else None, options.tars):
        if path is not None:
            try_folder(path)
    store = Store(options.folder)
    store.dataset()
    if (options.to is None) != (options.out is None):
        raise InputError("export", "--to and --out together", "one of them", "give both")
    tars, records = options.tars, options.parquet
    for name, form, path in (("--tars", "tars", tars), ("--parquet", "records", records)):
        if path is not None:
            said = f"{name} is deprecated: write --to {form} --out {path}"
            notice(said)
    if not (options.to or records or tars):
        raise InputError("export", "--to FORMAT --out PATH", "neither", "see --help for formats")
    if options.to in OWN and (tars or records):
        expected = "one of --to, --tars and --parquet"
        raise InputError("export", expected, "two", "run it twice, with only --to")
    if options.to == "tars":
        tars = options.out
    elif options.to == "records":
        records = options.out
    _require_uses(options, bool(tars), bool(records))
    each = options.each or EACH
    if options.to in FORMATS:
        from manifests.exporting.folders import export

        with tqdm(desc="exporting", unit="sample", delay=1.0) as bar:
            result = export(
                store,
                options.out,
                options.to,
                options.split,
                each,
                options.by or "",
                bar.update,
            )
        line = f"{options.out}: {number_of(result.samples, 'sample')},"
        line += f" {number_of(result.made, 'file')} written"
        print(line + (f", {result.already_there} were there" if result.already_there else ""))
        if result.left_out:
            said = (
                f"{options.folder}: left out {number_of(result.left_out, 'view')} without pictures,"
                " because there are pictures; render views into a folder of their own to export"
                " them"
            )
            notice(said)
    if tars:  # first: it may be refused, and then nothing is written
        with tqdm(desc="exporting", unit="record", delay=1.0) as bar:
            count = to_tars(store, tars, options.split, each, bar.update)
        print(f"{tars}: {number_of(count, 'tar')}")
    if records:
        print(f"{records}: {number_of(to_parquet(store, records, options.split), 'record')}")
    return 0


def _require_uses(options: argparse.Namespace, tars: bool, records: bool) -> None:
    """Raise InputError for an option that what is written would not depend on."""
    from manifests.errors import InputError

    formats = options.to in FORMATS
    for name, given, is_used, where in (
        ("--by", options.by, formats, f"one of {', '.join(FORMATS)}, which have a data card"),
        ("--each", options.each, formats or tars, "a format of several files"),
    ):
        if given is not None and not is_used:
            chosen = " and ".join(["tars"] * tars + ["records"] * records)
            raise InputError(name, where, chosen, f"leave {name} out")
