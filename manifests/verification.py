"""Is a dataset's folder whole, and does it keep to its own rules? Faults come as lines; a good folder gives none.

Two readings: of the records alone (seconds for 720,000), then of every file (as long as the disk takes).
"""

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import msgspec

from manifests.files import write_lines
from manifests.materials import read_catalogue
from manifests.problems import Problem
from manifests.splits import light_side, split_of
from manifests.store import LINES, Store, file_hash, geometry_path, image_path, inside


@dataclass(frozen=True)
class Fault:
    """What is wrong. record: the id it condemns, None if it is about the folder; orphan: a file that no record names."""

    text: str
    record: str | None = None
    orphan: Path | None = None


def faults_in_records(store: Store):
    """Faults that the records show by themselves: duplicates, paths that leave, sides that mix, assets that nothing describes."""
    dataset = store.dataset()
    labels = {entry.name: entry.hash for entry in read_catalogue(store.folder / "materials.json").materials}
    for name, entry in dataset.materials.items():
        if labels.get(name) != entry.hash:
            yield Fault(f"materials.json: '{name}' with hash {entry.hash[:12]} expected, found {str(labels.get(name))[:12]}")
    for name, entry in dataset.lights.items():
        if entry.side not in (None, side := light_side(entry.hash)):
            yield Fault(f"dataset.json: light '{name}' on side {side} expected, found {entry.side}")
    for kind, judge in (("records", _faults_of), ("views", _faults_of_view)):
        seen = set()
        for record in _lines(store, kind):
            if isinstance(record, Fault):
                yield record
                continue
            if record.id in seen:
                yield Fault(f"{kind[:-1]} {record.id}: once expected, found again", record.id)
            seen.add(record.id)
            yield from judge(record, store, dataset)


def _lines(store, kind):
    """Every line of a kind; a line that is none becomes a Fault and the reading goes on."""
    decoder = msgspec.json.Decoder(LINES[kind])
    for path in store.record_files(kind):
        with open(path, "rb") as lines:
            for number, line in enumerate(lines, 1):
                if not line.endswith(b"\n"):
                    yield Fault(f"{path.name}:{number}: a whole line expected, found one cut short; the next run over it removes it")
                    continue
                try:
                    yield decoder.decode(line)
                except (msgspec.DecodeError, UnicodeDecodeError) as error:
                    yield Fault(f"{path.name}:{number}: a {kind[:-1]} expected, found {error}")


def _faults_of(record, store, dataset):
    """Faults of one record. Written for the good one: 720,000 of them must take seconds."""
    shape, light = dataset.shapes.get(record.shape), dataset.lights.get(record.light)
    for kind, name, entry, hash_ in (("shape", record.shape, shape, record.shape_hash), ("light", record.light, light, record.light_hash)):
        if entry is None:
            yield Fault(f"record {record.id}: {kind} '{name}' in dataset.json expected, found none", record.id)
        elif entry.hash != hash_:
            yield Fault(f"record {record.id}: {kind} '{name}' with hash {entry.hash[:12]} expected, found {hash_[:12]}", record.id)
    unknown = [name for name in record.materials if name not in dataset.materials]
    for name in unknown:
        yield Fault(f"record {record.id}: material '{name}' in dataset.json expected, found none", record.id)
    if shape and len(record.materials) != shape.segments:
        yield Fault(f"record {record.id}: {shape.segments} materials, one a segment, expected, found {len(record.materials)}", record.id)
    if (
        shape
        and not unknown
        and record.split != (split := split_of(shape.side, [dataset.materials[name].side for name in record.materials]))
    ):
        yield Fault(f"record {record.id}: split {split} expected, found {record.split}", record.id)
    stem = record.geometry[record.geometry.rfind("/") + 1 : -4]
    for kind, path, expected in (("image", record.image, image_path(record.id)), ("geometry", record.geometry, geometry_path(stem))):
        if path != expected:
            yield _misplaced(record, store, kind, path, expected)


def _faults_of_view(view, store, dataset):
    """Faults of one view."""
    shape = dataset.shapes.get(view.shape)
    found = (view.shape_hash, view.segments, view.side)
    if shape is None:
        yield Fault(f"view {view.id}: shape '{view.shape}' in dataset.json expected, found none", view.id)
    elif found != (shape.hash, shape.segments, shape.side):
        expected = f"hash {shape.hash[:12]}, {shape.segments} segments, side {shape.side}"
        text = f"view {view.id}: shape '{view.shape}' with {expected} expected, found {found[0][:12]}, {found[1]}, {found[2]}"
        yield Fault(text, view.id)
    if view.geometry != geometry_path(view.id):
        yield _misplaced(view, store, "geometry", view.geometry, geometry_path(view.id))


def _misplaced(record, store, kind, path, expected):
    try:
        inside(store.folder, path)
    except Problem as problem:
        return Fault(f"record {record.id}: {problem}", record.id)
    return Fault(f"record {record.id}: {kind} at {expected} expected, found {path}", record.id)


def faults_in_files(store: Store, records, check_geometry, watch=None):
    """Faults that only the files show: missing, altered, not unit normals, named by nobody.

    records         Records and Views, as of `store.records()`; those whose paths leave the folder must have been left out
    check_geometry  called with (path, record): lines that say what is wrong with normals and segments
    watch           called once a record
    """
    named, geometry = {"images": set(), "geometry": set(), "lights": set()}, {}
    for entry in store.dataset().lights.values():
        named["lights"].add(entry.file)
        if fault := _altered(store, entry.file, entry.file_hash):
            yield Fault(fault)
    for record in records:
        named["geometry"].add(record.geometry)
        if image := getattr(record, "image", None):  # a view has none
            named["images"].add(image)
            if fault := _altered(store, image, record.image_hash):
                yield Fault(f"record {record.id}: {fault}", record.id)
        key = (record.geometry, record.geometry_hash)
        if key not in geometry:
            altered = _altered(store, *key)
            geometry[key] = [altered] if altered else list(check_geometry(store.folder / record.geometry, record))
        for fault in geometry[key]:
            yield Fault(f"record {record.id}: {fault}", record.id)
        if watch:
            watch()
    yield from _orphans(store, named)


def _altered(store, relative, expected):
    """What is wrong with a file, or None."""
    try:
        path = inside(store.folder, relative)
        found = file_hash(path)
    except FileNotFoundError:
        return f"{relative}: a file expected, found none"
    except Problem as problem:
        return str(problem)
    return None if found == expected else f"{relative}: hash {expected[:12]} expected, found {found[:12]}: the file was altered"


def _orphans(store, named):
    """Files that no record names, and what was left half-written."""
    for kind, known in named.items():
        top = store.folder / kind
        for folder, _, files in os.walk(top):
            for name in files:
                path = Path(folder) / name
                if path.relative_to(store.folder).as_posix() not in known:
                    yield Fault(f"{path.relative_to(store.folder)}: a record that names it expected, found none", orphan=path)
    for path in sorted((store.folder / "partial").glob("*")):
        yield Fault(f"{path.relative_to(store.folder)}: nothing expected, found a file half-written by a run that was killed", orphan=path)


def shared_between(datasets):
    """Shapes, materials and lights that are for training in one dataset and for testing in another: [(kind, name, folder, name, folder)].

    datasets  {folder: Dataset}
    """
    found, sides = [], {}
    for folder, dataset in datasets.items():
        for kind, entries in (("shape", dataset.shapes), ("material", dataset.materials), ("light", dataset.lights)):
            for name, entry in entries.items():
                ours = entry.side or light_side(entry.hash)
                side, other, where = sides.setdefault((kind, entry.hash), (ours, name, folder))
                if side != ours:
                    found.append((kind, other, where, name, folder))
    return found


def summary(faults):
    """How many records are condemned, how many files orphaned, how many other faults."""
    counts = Counter("orphan" if f.orphan else "record" if f.record else "other" for f in faults)
    return counts["record"], counts["orphan"], counts["other"]


def repair(store: Store, faults):
    """Take condemned records and orphaned files away, so that the same job renders them again; returns (records, files) removed.

    Call it with the folder locked.
    """
    condemned = {f.record for f in faults if f.record}
    removed = 0
    files = [(path, type_) for kind, type_ in LINES.items() for path in store.record_files(kind)]
    for path, type_ in files if condemned or any(f.text for f in faults if not f.orphan) else ():
        with open(path, "rb") as file:
            lines = file.readlines()
        kept = [line for line in lines if _keep(line, type_, condemned)]
        if len(kept) < len(lines):
            removed += len(lines) - len(kept)
            partial = store.folder / "partial"
            partial.mkdir(exist_ok=True)
            write_lines(path, kept, draft=partial / f"repair-{path.parent.name}-{path.name}")
    orphans = [f.orphan for f in faults if f.orphan]
    for path in orphans:
        path.unlink(missing_ok=True)
    return removed, len(orphans)


def _keep(line, type_, condemned):
    try:
        return line.endswith(b"\n") and msgspec.json.decode(line, type=type_).id not in condemned
    except (msgspec.DecodeError, UnicodeDecodeError):
        return False
