"""Records and views, checked against their ids and the entries of dataset.json.

An id is a hash of everything that determines a picture, so a line can be checked by itself. Where a
line and an entry of dataset.json differ, the other lines show which of the two was altered: a line
whose id fits, and which does not differ from an entry, confirms the entry. An entry that no line
confirms is the one to remove.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from manifests import ids
from manifests.materials import Entry, material_hash
from manifests.schema import Dataset, MaterialEntry, Record, View
from manifests.splits import split_of
from manifests.store_paths import geometry_path, image_path
from manifests.verification.faults import Fault, Line
from manifests.viewpoints import azimuths_deg
from manifests.wording import number_of

MOST_GROUPS = 20_000  # combinations whose hashes are remembered; one's records are neighbours


class _Difference(NamedTuple):
    """Where a line and an entry differ.

    entry  (kind, name)
    what   None if there is no such entry
    """

    entry: tuple[str, str]
    what: str | None
    by_entry: str
    by_line: str


@dataclass(slots=True)
class _Group:
    """What the records of one combination have in common.

    materials  their hashes by dataset.json, None where it lacks one
    hashings   (render, materials' hashes, digest to continue) for each way in which their ids may
               have been computed
    """

    camera: str
    materials: tuple[str, ...] | None
    hashings: list[tuple[str, tuple[str, ...], Any]]
    differences: list[_Difference]
    confirms: bool = False


class Judge:
    """Finds the faults of records and views, one by one, and those that need all of them.

    labels   {name: Entry} of materials.json
    damaged  (kind, name) of entries that are known to be wrong
    render   fingerprint of the program's render settings, with which ids may have been computed
             besides those in dataset.json
    """

    def __init__(
        self, dataset: Dataset, labels: dict[str, Entry], damaged: set, render: str | None
    ):
        self.dataset, self._labels, self._damaged, self._render = dataset, labels, damaged, render
        known = list(dataset.settings)
        self._renders = known if render is None or render in known else [*known, render]
        self._groups: dict[tuple, _Group] = {}
        self._own_hashes: dict[str, str] = {}
        self._confirmed: set[tuple[str, str]] = set()
        self._differing: dict[tuple[str, str], list[tuple[Fault, _Difference]]] = {}
        self._unfit: list[tuple[Fault, Record | View]] = []
        self._fit = 0

    def of_kind(self, kind: str) -> Callable[[Any, Line], list[Fault]]:
        """Return the method that checks lines of a kind: (line, place) → its faults.

        Some faults are returned by `verdicts` alone.
        """
        return self.record if kind == "records" else self.view

    def record(self, record: Record, line: Line) -> list[Fault]:
        """Return the faults of one record; fast for good ones, since there may be 720,000."""
        key = (
            record.shape,
            record.shape_hash,
            record.category,
            record.materials,
            record.light,
            record.light_hash,
            record.camera,
            ids.sampling(record),
            record.split,
        )
        group = self._groups.get(key) or self._new_group(key, record)
        place = (
            record.viewpoint,
            record.rotation_texels,
            record.tier,
            record.light_resolution,
            record.seed,
        )
        for render, hashes, digest in group.hashings:  # noqa: B007 -- the fitting one is used below
            if ids.shot_id(digest, *place) == record.id:
                break
        else:
            fitting = [ids.shot_id(digest, *place) for _, _, digest in group.hashings]
            self._note_unfitting(
                "record",
                record,
                line,
                fitting,
                "materials and render settings that dataset.json names",
            )
            return []
        self._fit += 1
        if group.differences or hashes is not group.materials:
            self._note_differences(
                "record",
                record,
                line,
                [*group.differences, *self._hash_differences(record, hashes)],
            )
        if not group.confirms:
            self._confirm(group, record, hashes)
        geometry = geometry_path(
            ids.geometry_id(record.shape_hash, group.camera, record.viewpoint, render)
        )
        faults = _place_faults("record", record, line, geometry)
        if record.image != (image := image_path(record.id)):
            faults.append(
                Fault(
                    f"record {record.id}: expected image at {image}, found {record.image}",
                    record.id,
                    line,
                )
            )
        return faults

    def view(self, view: View, line: Line) -> list[Fault]:
        """Return the faults of one view."""
        camera = ids.camera_words(view.camera)
        fitting = [
            ids.geometry_id(view.shape_hash, camera, view.viewpoint, render)
            for render in self._renders
        ]
        if view.id not in fitting:
            self._note_unfitting("view", view, line, fitting, "render settings in dataset.json")
            return []
        self._fit += 1
        if differences := self._shape_differences(view, view.segments):
            self._note_differences("view", view, line, differences)
        else:
            self._confirmed.add(("shapes", view.shape))
        faults = _place_faults("view", view, line, geometry_path(view.id))
        return faults

    def _new_group(self, key, record):
        """Return the _Group of a record's combination."""
        camera = ids.camera_words(record.camera)
        sampling = ids.sampling(record)
        entries = self._material_entries(record)
        materials = tuple(entry.hash for entry in entries) if entries is not None else None
        hashings = [
            (
                render,
                hashes,
                ids.shots_digest(
                    render, record.shape_hash, hashes, record.light_hash, camera, sampling
                ),
            )
            for hashes in (materials, self._label_hashes(record.materials, materials))
            for render in self._renders
            if hashes is not None
        ]
        differences = self._shape_differences(record, len(record.materials))
        light = self.dataset.lights.get(record.light)
        if light is None:
            differences.append(self._no_entry("lights", record.light, record.light_hash))
        elif light.hash != record.light_hash:
            differences.append(
                _Difference(
                    ("lights", record.light), "hash", light.hash[:12], record.light_hash[:12]
                )
            )
        if len(self._groups) >= MOST_GROUPS:
            self._groups.clear()
        self._groups[key] = group = _Group(camera, materials, hashings, differences)
        return group

    def _shape_differences(self, line, segments):
        """Return the differences between a record or a view and the entry of its shape."""
        here, shape = ("shapes", line.shape), self.dataset.shapes.get(line.shape)
        if shape is None:
            return [self._no_entry("shapes", line.shape, line.shape_hash)]
        pairs = [
            ("hash", shape.hash[:12], line.shape_hash[:12]),
            ("category", shape.category, line.category),
            ("segments", shape.segments, segments),
        ]
        if isinstance(line, View):
            pairs.append(("side", shape.side, line.side))
        else:
            materials = self._material_entries(line)
            damaged = self._damaged & {here, *(("materials", name) for name in line.materials)}
            if materials is not None and not damaged:
                pairs.append(
                    ("split", split_of(shape.side, [entry.side for entry in materials]), line.split)
                )
        return [
            _Difference(here, what, str(ours), str(theirs))
            for what, ours, theirs in pairs
            if ours != theirs
        ]

    def _material_entries(self, record: Record) -> list[MaterialEntry] | None:
        """Return the entries of a record's materials; None where dataset.json lacks one."""
        entries = [self.dataset.materials.get(name) for name in record.materials]
        known = [entry for entry in entries if entry is not None]
        return known if len(known) == len(entries) else None

    def _no_entry(self, kind, name, hash_):
        """Return the difference of a line that names what dataset.json lacks.

        If dataset.json has the same hash under another name, the name is the difference.
        """
        for other, entry in getattr(self.dataset, kind).items():
            if entry.hash == hash_:
                return _Difference((kind, other), "name", other, name)
        return _Difference((kind, name), None, "", "")

    def _label_hashes(
        self, names: Sequence[str], known: tuple[str, ...] | None
    ) -> tuple[str, ...] | None:
        """Return the hashes of materials by their labels.

        None where a label is missing, or where the hashes are the known ones.
        """
        labels = [self._labels.get(name) for name in names]
        if not all(labels):
            return None
        own = tuple(self._label_hash(name) for name in names)
        return None if own == known else own

    def _label_hash(self, name: str) -> str:
        if name not in self._own_hashes:
            label = self._labels[name]
            self._own_hashes[name] = material_hash(label.label, label.mixture)
        return self._own_hashes[name]

    def _hash_differences(self, record, hashes):
        """Yield the differences of dataset.json and the hashes with which a record's id fits."""
        for name, own in zip(record.materials, hashes, strict=True):
            entry = self.dataset.materials.get(name)
            if entry is None:
                yield _Difference(("materials", name), None, "", "")
            elif entry.hash != own:
                yield _Difference(("materials", name), "hash", entry.hash, own)

    def _note_differences(self, kind, line, place, differences):
        """Remember differences until it is known which side was altered."""
        for difference in differences:
            (of, name), what, by_entry, by_line = difference
            text = f"{kind} {line.id}: expected {of[:-1]} '{name}' in dataset.json, found none"
            if what:
                text = (
                    f"{kind} {line.id}: expected {of[:-1]} '{name}' with {what} {by_entry}, found"
                    f" {by_line}"
                )
            self._differing.setdefault(difference.entry, []).append(
                (Fault(text, line.id, place), difference)
            )

    def _confirm(self, group, record, hashes):
        """Confirm the entries from which a record whose id fits does not differ."""
        named = {
            ("shapes", record.shape),
            ("lights", record.light),
            *(("materials", name) for name in record.materials),
        }
        differing = {
            difference.entry
            for difference in (*group.differences, *self._hash_differences(record, hashes))
        }
        self._confirmed |= named - differing
        group.confirms = True

    def _note_unfitting(self, kind, line, place, fitting, needed):
        """Remember a line whose id is not the hash of its content."""
        text = f"{kind} {line.id}: expected {needed}, found none"
        if fitting:
            text = (
                f"{kind} {line.id}: expected id {fitting[0]}, the hash of what it says, found"
                f" {line.id}"
            )
        self._unfit.append((Fault(text, line.id, place), line))

    def verdicts(self) -> Iterator[Fault]:
        """Yield the faults that depend on whether a line or an entry was altered."""
        doubted: dict[tuple[str, str], int] = {}
        if self._unfit and not self._fit and self._render not in self.dataset.settings:
            yield Fault(
                "dataset.json: expected settings of the render version that made its pictures,"
                f" found none that gives the ids of its {number_of(len(self._unfit), 'line')},"
                f" {self._unfit[0][0].record} first"
            )
        else:
            for fault, line in self._unfit:
                yield fault
                for entry in self._entries_of(line):
                    doubted[entry] = doubted.get(entry, 0) + 1
        for entry, result in self._differing.items():
            if entry in self._confirmed:
                yield from (fault for fault, _ in result)
            else:
                doubted.pop(entry, None)
                yield self._altered_fault(entry, result)
        for (kind, name), many in doubted.items():
            if (kind, name) not in self._confirmed:
                text = (
                    f"dataset.json: expected {kind[:-1]} '{name}' that an id confirms, found {many}"
                    " lines whose ids do not fit"
                )
                yield Fault(text, entry=(kind, name))

    def _entries_of(self, line):
        """Return the entries that a line names, as far as they exist."""
        named = [("shapes", line.shape)]
        if isinstance(line, Record):
            named += [
                ("lights", line.light),
                *(("materials", name) for name in dict.fromkeys(line.materials)),
            ]
        return [(kind, name) for kind, name in named if name in getattr(self.dataset, kind)]

    def _altered_fault(self, entry, found):
        """Return the Fault of an entry that no line confirms."""
        (kind, name), (_, what, by_entry, by_line) = entry, found[0][1]
        lines = (
            "a line whose id fits says"
            if len(found) == 1
            else f"{len(found)} lines whose ids fit say"
        )
        if what is None:
            return Fault(f"dataset.json: {kind[:-1]} '{name}' expected, as {lines}, found none")
        text = (
            f"dataset.json: {kind[:-1]} '{name}': {what} {by_line} expected, as {lines}, found"
            f" {by_entry}"
        )
        return Fault(text, entry=entry)


def _place_faults(kind, line, place, geometry):
    """Return the faults of where a line's geometry lies and of the azimuth that it states."""
    results = []
    if line.geometry != geometry:
        results.append(
            Fault(
                f"{kind} {line.id}: expected geometry at {geometry}, found {line.geometry}",
                line.id,
                place,
            )
        )
    if line.azimuth_deg != (azimuth := azimuths_deg()[line.viewpoint]):
        text = (
            f"{kind} {line.id}: expected azimuth {azimuth:g} of viewpoint {line.viewpoint}, found"
            f" {line.azimuth_deg:g}"
        )
        results.append(Fault(text, line.id, place))
    return results
