"""Verification of a data set: whether its folder is complete, and is what its ids say.

Faults are single lines of text; a good folder has none. There are two passes: over the records
alone (`in_records`: seconds for 720,000), then over every file (`in_files`: a few milliseconds per
picture). No fault ends a pass: what cannot be read is a fault, and the pass goes on.

entries   dataset.json and materials.json against each other and the rules of the split
lines     records and views against their ids and the entries
orders    records and views against the jobs that ask for them
files     pictures, geometry and light maps against their hashes, and their contents against physics
strays    what lies in the folder and does not belong there
repair    removes what is broken, so that the same `render` makes it again

A forger who recomputes every hash and id makes a folder that no reading of it can tell from another
data set; docs/rendering.md says what this leaves open.
"""

from collections.abc import Callable, Iterator
from typing import Any

from manifests.errors import InputError
from manifests.materials import Entry, read_catalogue
from manifests.schema import Dataset
from manifests.splits import light_side
from manifests.store import LINES, Store
from manifests.verification.entries import entry_faults
from manifests.verification.faults import Fault, Line, summary
from manifests.verification.files import Files, Reference
from manifests.verification.lines import Judge
from manifests.verification.orders import Orders
from manifests.verification.reading_lines import failure_faults, read_lines
from manifests.verification.repair import repair
from manifests.verification.strays import folder_faults, stray_faults

__all__ = ["Fault", "Verification", "faults_of", "repair", "shared_between", "summary"]


class Verification:
    """The verification of one data set.

    Consume all of `in_records` first; then, if the files are to be read, all of `in_files`.

    store      its Store
    render     fingerprint of the program's own render settings, None: unknown
    reference  (name, hash) → (L, scale) of a light that the program makes itself, None for others
    count      records and views seen; 0 before `in_records`
    Raises     InputError if dataset.json is missing or cannot be read
    """

    def __init__(self, store: Store, render: str | None = None, reference: Reference | None = None):
        self.store, self.dataset, self.count = store, store.dataset(), 0
        self._render, self._reference = render, reference
        self._labels: dict[str, Entry] | None = None
        self._condemned: set[Line] = set()
        self._damaged: set[tuple[str, str]] = set()

    def in_records(self) -> Iterator[Fault]:
        """Yield the faults of dataset.json, materials.json and the lines of records and views."""
        for fault in self._in_records():
            if fault.line:
                self._condemned.add(fault.line)
            if fault.entry:
                self._damaged.add(fault.entry)
            yield fault

    def _in_records(self):
        yield from folder_faults(self.store.folder)
        yield from self._read_labels()
        yield from entry_faults(self.dataset, self._labels)
        judge = Judge(self.dataset, self._labels or {}, self._damaged, self._render)
        for kind in LINES:
            faults_of, seen = judge.of_kind(kind), set()
            for path, number, line in read_lines(self.store, kind):
                if isinstance(line, Fault):
                    yield line
                    continue
                self.count += 1
                if line.id in seen:
                    yield Fault(
                        f"{kind[:-1]} {line.id}: expected once, found again",
                        line.id,
                        (path, number),
                    )
                    continue
                seen.add(line.id)
                if faults := faults_of(line, (path, number)):
                    yield from faults
        yield from judge.verdicts()
        yield from failure_faults(self.store)

    def _read_labels(self):
        path = self.store.folder / "materials.json"
        try:
            catalogue = read_catalogue(path).materials
        except (InputError, OSError) as problem:
            yield Fault(str(problem))
            return
        labels = self._labels = {}
        for entry in catalogue:
            if entry.name in labels:
                text = f"materials.json: expected '{entry.name}' once, found again"
                yield Fault(text, entry=("labels", entry.name))
            labels[entry.name] = entry

    def in_files(self, watch: Callable[[], Any] | None = None) -> Iterator[Fault]:
        """Yield the faults of files, and lines that no order asks for.

        A file may be missing, altered, impossible as what it is, or named by no line.

        watch  called once for each record and view
        """
        files, orders = (
            Files(
                self.store.folder,
                self.dataset,
                self._labels or {},
                self._reference,
                self.store.copy_here,
            ),
            Orders(self.dataset),
        )
        yield from files.light_faults()
        for kind in LINES:
            for path, number, line in read_lines(self.store, kind):
                if isinstance(line, Fault):
                    continue
                files.name(line)
                if (path, number) not in self._condemned:
                    if self._damaged.isdisjoint(
                        ("materials", name) for name in getattr(line, "materials", ())
                    ):
                        orders.look(line, (path, number))
                    for text, broken in files.of(line):
                        yield Fault(
                            f"{kind[:-1]} {line.id}: {text}", line.id, (path, number), broken
                        )
                if watch:
                    watch()
        yield from orders.faults()
        yield from files.packed_faults()
        yield from stray_faults(self.store.folder, files.named)
        for name in self.store.unnamed_objects(files.named):
            yield Fault(f"{name}: expected a record that names it, found none", stray=True)


def faults_of(
    store: Store, render: str | None = None, reference: Reference | None = None
) -> list[Fault]:
    """Return all faults of a data set; arguments as Verification takes them."""
    verification = Verification(store, render, reference)
    return [*verification.in_records(), *verification.in_files()]


def shared_between(datasets: dict[str, Dataset]) -> list[tuple[str, str, str, str, str]]:
    """Return the assets that are for training in one data set and for testing in another.

    datasets  {folder: Dataset}
    Returns   [(kind, name, folder, name, folder)]
    """
    result: list[tuple[str, str, str, str, str]] = []
    sides: dict[tuple[str, str], tuple[str, str, str]] = {}
    for folder, dataset in datasets.items():
        for kind, entries in (
            ("shape", dataset.shapes),
            ("material", dataset.materials),
            ("light", dataset.lights),
        ):
            for name, entry in entries.items():
                ours = entry.side or light_side(entry.hash)
                side, other, where = sides.setdefault((kind, entry.hash), (ours, name, folder))
                if side != ours:
                    result.append((kind, other, where, name, folder))
    return result
