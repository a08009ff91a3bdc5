"""Repair: what is broken is removed, so that the same `render` makes it again.

Nothing outside the folder is touched, and no link is followed.
"""

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import msgspec

from manifests import materials
from manifests.errors import InputError
from manifests.files import write_lines
from manifests.line_files import bounded_lines
from manifests.store import LINES, Store
from manifests.store_paths import geometry_path, image_path, light_path
from manifests.verification.faults import Fault
from manifests.verification.strays import kind_of


def repair(store: Store, faults: Iterable[Fault]) -> tuple[int, int]:
    """Remove lines, files and entries at fault; return how many (lines, files) were removed.

    A picture or geometry file is removed with the last line that names it. The folder must be
    locked.
    """
    faults = list(faults)
    going = {fault.file for fault in faults if fault.file and not fault.record}
    files = sum(_remove(store.folder, path) for path in sorted(going))
    dropped: dict[Path, set[int]] = {}
    for fault in faults:
        if fault.line:
            dropped.setdefault(fault.line[0], set()).add(fault.line[1])
    lines, unnamed = 0, {fault.file for fault in faults if fault.file and fault.record}
    for path, numbers in sorted(dropped.items()):
        count, named = _drop_lines(store.folder / "partial", path, numbers)
        lines += count
        unnamed |= {store.folder / relative for relative in named}
    if unnamed:  # a file that a remaining line names stays
        unnamed -= {store.folder / relative for relative in _named_files(store)}
    unnamed |= _drop_entries(store, {fault.entry for fault in faults if fault.entry})
    return lines, files + sum(_remove(store.folder, path) for path in sorted(unnamed))


def _drop_lines(partial, path, numbers):
    """Write a file without some of its lines; return their number, and the files they named."""
    remaining, count, named, type_ = [], 0, set(), LINES.get(path.parent.name)
    for number, line in bounded_lines(path):
        if number not in numbers and line is not None:
            remaining.append(line)
            continue
        count += 1
        if type_ and line is not None:
            named |= _files_of(line, type_)
    partial.mkdir(exist_ok=True)
    # where a killed run's drafts are swept
    write_lines(path, remaining, draft=partial / f"repair-{path.parent.name}-{path.name}")
    return count, named


def _files_of(line, type_):
    """Return the files that follow from a line's ids; the paths in it may lead anywhere."""
    try:
        record = msgspec.json.decode(line, type=type_)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return set()
    result = {image_path(record.id)} if hasattr(record, "image") else set()
    name = record.geometry.rpartition("/")[2].removesuffix(".exr")
    return result | ({record.geometry} if record.geometry == geometry_path(name) else set())


def _named_files(store):
    """Return every file that the remaining lines name."""
    named = set()
    for kind in LINES:
        for line in store.records() if kind == "records" else store.views():
            named.add(line.geometry)
            named.add(getattr(line, "image", line.geometry))
    return named


def _drop_entries(store, entries):
    """Remove entries of dataset.json and materials.json; return the removed lights' maps."""
    if not entries:
        return set()
    dataset = store.dataset()
    names = {
        kind: {name for of, name in entries if of == kind}
        for kind in ("shapes", "materials", "lights", "labels")
    }
    maps = {
        store.folder / light_path(n, dataset.lights[n].hash)
        for n in names["lights"]
        if n in dataset.lights
    }
    changed = {
        kind: {
            name: entry for name, entry in getattr(dataset, kind).items() if name not in names[kind]
        }
        for kind in ("shapes", "materials", "lights")
    }
    store.write_json("dataset.json", msgspec.structs.replace(dataset, **changed))
    if gone := names["labels"] | names["materials"]:
        path = store.folder / "materials.json"
        try:
            catalogue = materials.read_catalogue(path)
        except InputError:  # missing, or removed as damaged
            return maps
        remaining = tuple(entry for entry in catalogue.materials if entry.name not in gone)
        store.place(
            "materials.json",
            materials.encode(msgspec.structs.replace(catalogue, materials=remaining)),
            "main",
        )
    return maps


def _remove(folder, path):
    """Remove a file, a link or a folder in place of a file; return whether there was one."""
    kind = kind_of(path)
    if kind is None or not Path(os.path.realpath(path.parent)).is_relative_to(
        os.path.realpath(folder)
    ):
        return False
    if kind == "a folder":
        shutil.rmtree(path)
    else:
        path.unlink()
    return True
