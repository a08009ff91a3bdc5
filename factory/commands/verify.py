"""`verify DIR`: check the records, ids, files and splits of data sets, and repair them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from manifests.errors import InputError
from manifests.help_format import HelpFormatter
from manifests.notices import notice
from manifests.wording import number_of

if TYPE_CHECKING:
    import numpy as np

    from manifests.schema import Dataset
    from manifests.store import Store
    from manifests.verification import Fault, Verification

SHOWN = 20  # faults that are printed
EPILOG = """examples:
  python -m factory verify out/demo
  python -m factory verify out/train out/test --quick
  python -m factory verify out/demo --repair

Exit status: 0 clean or repaired, 1 faults remain, 2 wrong usage."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `verify`."""
    parser = subparsers.add_parser(
        "verify",
        help="check the records, ids, files and splits of data sets",
        description=(
            "Compares every record with its id, which is a hash of everything that determines the"
            " picture, and every file with its hash, and checks that pictures, normals and light"
            " maps are physically possible. With several folders, checks also that none trains on"
            " what another tests on."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "folders",
        nargs="+",
        metavar="DIR",
        help="a data set's folder, or the URL of one on an object store",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help=(
            "check only the records and open no picture, which takes seconds even for 720,000"
            " records"
        ),
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help=(
            "remove broken records and stray files, so that the same `render` makes the records"
            " again"
        ),
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Return 0 if every folder is clean or was repaired, else 1."""
    from manifests.cached_store import open_store
    from manifests.object_store import is_url
    from manifests.verification import shared_between

    dirty = 0
    datasets: dict[str, Dataset] = {}
    for folder in options.folders:
        try:
            if options.repair and is_url(folder):
                remedy = "copy it to a disk, repair it there, and copy it back"
                raise InputError(folder, "a folder, not a URL, to repair", "a URL", remedy)
            store = open_store(folder, fresh=True)
            dirty += not _is_clean(folder, store, options)
            datasets[folder] = store.dataset()
        except (InputError, OSError) as error:
            notice(error)
            dirty += 1
    for kind, name, where, other, there in shared_between(datasets):
        print(
            f"{kind} '{name}' of {where} and '{other}' of {there}: expected one side, found"
            " training in one and test in the other"
        )
        dirty += 1
    return 1 if dirty else 0


def _is_clean(folder: str, store: Store, options: argparse.Namespace) -> bool:
    """Print a report on one folder; return whether it is clean or was repaired."""
    from factory.planning.fingerprint import render_fingerprint
    from manifests.verification import Verification, repair, summary

    verification = Verification(store, render_fingerprint(), reference_light)
    with _locked(store, options.repair):
        faults = _faults(verification, options.quick)
        for fault in faults[:SHOWN]:
            print(f"{folder}: {fault.text}", file=sys.stderr)
        if len(faults) > SHOWN:
            print(f"{folder}: … and {len(faults) - SHOWN} more", file=sys.stderr)
        if not faults:
            print(
                f"{folder}: {_count_lines(verification)},"
                f" clean{' (files not opened)' if options.quick else ''}"
            )
            return True
        records, strays, others = summary(faults)
        print(
            f"{folder}: {number_of(verification.count, 'record')}; {number_of(records, 'fault')} in"
            f" records, {number_of(strays, 'stray file')}, {number_of(others, 'other')}"
        )
        if not options.repair:
            remedy = "verify --repair removes what is broken, and render makes it again"
            notice(InputError(folder, "a clean data set", number_of(len(faults), "fault"), remedy))
            return False
        removed, unlinked = repair(store, faults)
        left = sum(not fault.mendable for fault in faults)
        print(
            f"{folder}: {number_of(removed, 'line')} and {number_of(unlinked, 'file')} removed; run"
            " the same `render` again"
        )
        if left:
            notice(
                f"{folder}: --repair cannot mend {number_of(left, 'fault')}; run the same `render`"
                " again, or copy the folder again"
            )
        return not left


def _count_lines(verification: Verification) -> str:
    """Return the number of records and views, and that of the orders where it is larger."""
    planned = sum(order.shots for order in verification.dataset.orders)
    rest = f" of at most {planned} that its orders ask for" if planned > verification.count else ""
    return f"{number_of(verification.count, 'record')}{rest}"


def _faults(verification: Verification, quick: bool) -> list[Fault]:
    """Return all faults of one folder."""
    from manifests.progress import tqdm

    faults = list(verification.in_records())
    if not quick:
        what = f"verifying {verification.store.name}"
        with tqdm(
            total=verification.count, desc=what, unit="record", leave=False, delay=1.0
        ) as bar:
            faults += verification.in_files(bar.update)
    return faults


@contextmanager
def _locked(store: Store, repair: bool) -> Iterator[None]:
    """Hold the folder's lock, so that no run writes meanwhile.

    A folder whose .lock is no ordinary file is read without it; that is a fault, too.
    """
    from manifests import lock
    from manifests.verification.strays import kind_of

    if repair:
        for path in store.folder.glob(".lock*"):
            if kind_of(path) != "a file":  # a link or a pipe would be opened
                path.rmdir() if kind_of(path) == "a folder" else path.unlink()
    elif kind_of(store.folder / ".lock") not in ("a file", None):
        yield
        return
    with lock.writing(store.folder, patience=0):
        yield


def reference_light(name: str, hash_: str) -> tuple[np.ndarray, float] | None:
    """Return (L, scale) of a built-in light; None for a name or hash that the program lacks."""
    from factory.lights.catalogue import load
    from factory.lights.files import is_light_path

    if is_light_path(name):  # a name in a manifest is never opened as a path
        return None
    try:
        light = load(name)
    except (InputError, OSError):
        return None
    return (light.L64, light.scale) if light.hash == hash_ else None
