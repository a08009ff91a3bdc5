"""`verify DIR`: is every record there once, every file whole, every normal unit, and nothing shared between training and test?"""

import sys

from manifests.problems import Problem

SHOWN = 20


def register(subparsers):
    """Add the parser of `verify`."""
    parser = subparsers.add_parser(
        "verify",
        help="check a dataset: records, files, hashes, normals, splits",
        description="Check datasets. With several folders, also that nothing one trains on is what another tests on.",
    )
    parser.add_argument("folders", nargs="+", metavar="DIR", help="a dataset's folder")
    parser.add_argument("--quick", action="store_true", help="records only: seconds, even for 720,000; no file is opened")
    parser.add_argument("--repair", action="store_true", help="take broken records and stray files away; `render` then makes them again")
    parser.set_defaults(run=run)


def run(options):
    """0 if every folder is clean."""
    from manifests.store import Store
    from manifests.verification import shared_between

    dirty = 0
    for folder in options.folders:
        dirty += _one(folder, options)
    for kind, name, where, other, there in shared_between({f: Store(f).dataset() for f in options.folders}):
        print(f"{kind} '{name}' of {where} and '{other}' of {there}: one side expected, found training in one and test in the other")
        dirty += 1
    return 1 if dirty else 0


def _one(folder, options):
    """Report on one folder; the number of faults that remain."""
    from manifests import lock
    from manifests.store import Store
    from manifests.verification import repair, summary

    store = Store(folder)
    store.dataset()
    with lock.writing(folder, patience=0):
        faults, count = _faults(store, options.quick)
        for fault in faults[:SHOWN]:
            print(f"{folder}: {fault.text}", file=sys.stderr)
        if len(faults) > SHOWN:
            print(f"{folder}: … and {len(faults) - SHOWN} more", file=sys.stderr)
        if not faults:
            print(f"{folder}: {count} records, clean{' (files not opened)' if options.quick else ''}")
            return 0
        records, orphans, others = summary(faults)
        print(f"{folder}: {count} records; {records} faults in records, {orphans} stray files, {others} others")
        if not options.repair:
            raise Problem(
                folder, "a clean dataset", f"{len(faults)} faults", "verify --repair takes broken records away, render makes them again"
            )
        removed, unlinked = repair(store, faults)
        print(f"{folder}: {removed} records and {unlinked} stray files taken away; run the same `render` again")
        return 0


def _faults(store, quick):
    """All faults, and how many records there are."""
    from itertools import chain

    from tqdm import tqdm

    from manifests.verification import faults_in_files, faults_in_records

    faults = list(faults_in_records(store))
    condemned = {f.record for f in faults if f.record}
    if any(f.record is None and ".jsonl:" in f.text for f in faults):
        return faults, 0  # a line that is no record: the files behind it cannot be told from orphans
    count = len(store.ids()) + len(store.ids("views"))
    if not quick:
        with tqdm(total=count, desc=f"verifying {store.folder}", unit="record", leave=False, delay=1.0) as bar:
            records = (line for line in chain(store.records(), store.views()) if line.id not in condemned)
            faults += faults_in_files(store, records, geometry_faults, bar.update)
    return faults, count


def geometry_faults(path, record):
    """What is wrong with a geometry file: normals not unit or turned away, a mask that is not the record's, too many segments."""
    import numpy as np

    from manifests.arrays import read_geometry

    geometry = read_geometry(path)
    normals, mask, segments = geometry.normals, geometry.mask, geometry.segments
    if mask.shape != tuple(record.camera.size):
        return [f"{path.name}: size {record.camera.size} expected, found {mask.shape}"]
    found = []
    lengths = np.linalg.norm(normals[mask].astype(np.float64), axis=-1)
    if lengths.size and not np.abs(lengths - 1).max() <= 1e-3:
        found.append(f"{path.name}: unit normals expected, found lengths {lengths.min():.4f}–{lengths.max():.4f}")
    if abs(mask.mean() - record.coverage) > 1e-5:
        found.append(f"{path.name}: coverage {record.coverage:.6f} expected, found {mask.mean():.6f}")
    if segments.max(initial=0) > record.segments:
        found.append(f"{path.name}: segments up to {record.segments} expected, found {segments.max()}")
    return found
