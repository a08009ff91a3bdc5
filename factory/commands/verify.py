"""`verify DIR`: is every record there once, the one that its id means, every file whole and
possible, nothing shared between sides?
"""

import sys
from contextlib import contextmanager

from manifests.errors import InputError

SHOWN = 20


def register(subparsers):
    """Add the parser of `verify`."""
    parser = subparsers.add_parser(
        "verify",
        help="check a dataset: records, ids, files, hashes, contents, splits",
        description=(
            "Check datasets: every line against its id, which is a hash of all that determines a"
            " picture; every file against its hash; every picture, normal and light map against"
            " what it can be. With several folders, also that nothing one trains on is what another"
            " tests on. Exit status: 0 clean, or repaired; 1 faults, or faults that only a person"
            " can mend."
        ),
    )
    parser.add_argument("folders", nargs="+", metavar="DIR", help="a dataset's folder")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="records only: seconds, even for 720,000; no picture is opened",
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help="take broken records and stray files away; `render` then makes them again",
    )
    parser.set_defaults(run=run)


def run(options):
    """0 if every folder is clean."""
    from manifests.store import Store
    from manifests.verification import shared_between

    dirty, datasets = 0, {}
    for folder in options.folders:
        try:
            dirty += not _is_clean(folder, options)
            datasets[folder] = Store(folder).dataset()
        except (InputError, OSError) as error:
            print(f"factory: {error}", file=sys.stderr)
            dirty += 1
    for kind, name, where, other, there in shared_between(datasets):
        print(
            f"{kind} '{name}' of {where} and '{other}' of {there}: expected one side, found"
            " training in one and test in the other"
        )
        dirty += 1
    return 1 if dirty else 0


def _is_clean(folder, options):
    """Report on one folder; True if it is clean, or was mended."""
    from factory.planning.fingerprint import render_fingerprint
    from manifests.store import Store
    from manifests.verification import Verification, repair, summary

    store = Store(folder)
    verification = Verification(store, render_fingerprint(), reference_light)
    with _held(store, options.repair):
        faults = _faults(verification, options.quick)
        for fault in faults[:SHOWN]:
            print(f"{folder}: {fault.text}", file=sys.stderr)
        if len(faults) > SHOWN:
            print(f"{folder}: … and {len(faults) - SHOWN} more", file=sys.stderr)
        if not faults:
            print(
                f"{folder}: {_counted(verification)},"
                f" clean{' (files not opened)' if options.quick else ''}"
            )
            return True
        records, strays, others = summary(faults)
        print(
            f"{folder}: {verification.count} records; {records} faults in records, {strays} stray"
            f" files, {others} others"
        )
        if not options.repair:
            remedy = "verify --repair takes what is broken away, render makes it again"
            print(
                "factory:"
                f" {InputError(folder, 'a clean dataset', f'{len(faults)} faults', remedy)}",
                file=sys.stderr,
            )
            return False
        removed, unlinked = repair(store, faults)
        left = sum(not fault.mendable for fault in faults)
        print(
            f"{folder}: {removed} lines and {unlinked} files taken away; run the same `render`"
            " again"
        )
        if left:
            print(
                f"{folder}: {left} faults are not for --repair: the same `render` or a copy of the"
                " folder may mend them",
                file=sys.stderr,
            )
        return not left


def _counted(verification):
    """How many records and views there are, and how many the orders ask for where it is more."""
    planned = sum(order.shots for order in verification.dataset.orders)
    owed = f" of at most {planned} that its orders ask for" if planned > verification.count else ""
    return f"{verification.count} records{owed}"


def _faults(verification, quick):
    """All faults."""
    from tqdm import tqdm

    faults = list(verification.in_records())
    if not quick:
        what = f"verifying {verification.store.folder}"
        with tqdm(
            total=verification.count, desc=what, unit="record", leave=False, delay=1.0
        ) as bar:
            faults += verification.in_files(bar.update)
    return faults


@contextmanager
def _held(store, repair):
    """Hold the folder's lock, so that no run writes meanwhile; a folder that nobody can write to is
    read without it.
    """
    from manifests import lock
    from manifests.verification.strays import kind_of

    if repair:
        for path in store.folder.glob(".lock*"):
            if kind_of(path) != "a file":  # a link, a pipe: it would be opened
                path.rmdir() if kind_of(path) == "a folder" else path.unlink()
    # its fault is listed with the others
    elif kind_of(store.folder / ".lock") not in ("a file", None):
        yield
        return
    with lock.writing(store.folder, patience=0):
        yield


def reference_light(name, hash_):
    """(L, scale) of a light as the program makes it itself; None for a name or a hash that it does
    not know.
    """
    from factory.lights.catalogue import load
    from factory.lights.files import is_light_path

    if is_light_path(name):  # a name out of a manifest is no path to be opened
        return None
    try:
        light = load(name)
    except (InputError, OSError):
        return None
    return (light.L64, light.scale) if light.hash == hash_ else None
