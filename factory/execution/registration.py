"""Enters a run's job, assets and settings in the data set's folder; the shots come later."""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np

from factory.execution.worker import Reply
from factory.planning.assets import Light, Material
from factory.planning.job_shapes import Shape
from factory.planning.plan import Plan
from manifests.errors import InputError
from manifests.light_files import encode_light, read_light
from manifests.materials import BUILT_IN, Catalogue, Entry, encode, read_catalogue
from manifests.schema import Dataset, Job, LightEntry, MaterialEntry, Order, ShapeEntry
from manifests.splits import light_side
from manifests.store import LINES, Store
from manifests.store_paths import light_path, readable_hash
from manifests.wording import number_of

TITLE = "The materials of this dataset"
# names in a data set's folder besides dataset.json
OWN = (*LINES, "images", "geometry", "lights", "shape-facts", "partial", "materials.json")


def require_no_foreign_files(store: Store) -> str | None:
    """Refuse a folder where a data set would overwrite files that belong to something else.

    A run deletes unfinished drafts and lines, and writes materials.json: such files would be lost.

    Returns a note about other files beside a new data set; None if there are none
    Raises  InputError, before anything is written
    """
    if (store.folder / "dataset.json").exists():
        store.dataset()  # raises for one of another program
        return None
    try:
        names = sorted(path.name for path in store.folder.iterdir())
    except OSError:  # there is none yet, or making it will say what is wrong
        return None
    kept = [path for kind in LINES for path in store.record_files(kind)]
    drafts = store.folder / "partial"
    kept += sorted(drafts.iterdir()) if drafts.is_dir() else []
    foreign = [path for path in kept if not path.name.startswith(("worker-", "main-"))]
    materials = store.folder / "materials.json"
    if materials.exists() and not kept and not _is_ours(materials):
        foreign.append(materials)
    if foreign:
        raise InputError(
            store.folder,
            "a data set, a new folder, or one without such a file",
            f"{foreign[0].relative_to(store.folder)} of something else",
            "give another --out: it would be overwritten here",
        )
    others = [name for name in names if name not in OWN and not name.startswith((".", "failures"))]
    if not others:
        return None
    more = f" and {number_of(len(others) - 1, 'other')}" if len(others) > 1 else ""
    return f"{store.folder}: {others[0]}{more} in this folder will stay as they are"


def _is_ours(materials: Path) -> bool:
    """Return whether materials.json is a data set's."""
    try:
        return read_catalogue(materials).title == TITLE
    except (InputError, OSError):
        return False


def register_job(store: Store, plan: Plan, shots: int) -> None:
    """Enter a plan and its assets in the folder's dataset.json, materials.json and lights/.

    shots   number of the job's shots, counting only shapes that have been read
    Raises  InputError if the folder has a different asset of the same name, or has one of the
            assets on the other side of the split
    """
    known = store.dataset() if (store.folder / "dataset.json").exists() else Dataset()
    assets = plan.assets
    shapes = _shape_entries(assets.shapes)
    materials = {
        m.name: MaterialEntry(hash=m.hash, side=m.side, licence=m.licence, source=m.source)
        for m in assets.materials
    }
    lights = {
        light.name: _light_entry(store, light, known.lights.get(light.name))
        for light in assets.lights.values()
    }
    _require_agreement(store, "shape", known.shapes, shapes)
    _require_agreement(store, "material", known.materials, materials)
    _require_agreement(store, "light", known.lights, lights)
    _write_materials(store, assets.materials, known.materials)
    orders = _with_shots(known.orders, plan.job, shots)
    if not any(_same_job(order.job, plan.job) for order in orders):
        begun = datetime.now(UTC).isoformat(timespec="seconds")
        orders = (*orders, Order(job=plan.job, shots=shots, begun=begun))
    store.write_json(
        "dataset.json",
        msgspec.structs.replace(
            known,
            orders=orders,
            # ids are hashed with the fingerprint, so it is entered before the first record
            settings={plan.fingerprint: {}, **known.settings},
            shapes={**known.shapes, **shapes},
            materials={**known.materials, **materials},
            lights={**known.lights, **lights},
        ),
    )


def register_shapes(store: Store, plan: Plan, shots: int) -> None:
    """Enter further shapes of a job that is registered already.

    plan    with these shapes alone
    shots   number of the job's shots, as far as its shapes have been read
    Raises  InputError as `register_job`
    """
    known, shapes = store.dataset(), _shape_entries(plan.assets.shapes)
    _require_agreement(store, "shape", known.shapes, shapes)
    orders = _with_shots(known.orders, plan.job, shots)
    shapes = {**known.shapes, **shapes}
    store.write_json("dataset.json", msgspec.structs.replace(known, orders=orders, shapes=shapes))


def _shape_entries(shapes: Iterable[Shape]) -> dict[str, ShapeEntry]:
    return {
        s.name: ShapeEntry(
            hash=s.hash,
            category=s.category,
            side=s.side,
            role=s.role,
            segments=s.segments,
            licence=s.licence,
            report=s.report,
        )
        for s in shapes
    }


def _with_shots(orders: Iterable[Order], job: Job, shots: int) -> tuple[Order, ...]:
    """Return the orders, in which the one of this job has at least this number of shots."""
    return tuple(
        msgspec.structs.replace(order, shots=max(order.shots, shots))
        if _same_job(order.job, job)
        else order
        for order in orders
    )


def _same_job(known: Job, job: Job) -> bool:
    """Return whether two jobs differ at most in their names and descriptions."""
    return msgspec.structs.replace(known, name=job.name, about=job.about) == job


def note_settings(store: Store, fingerprint: str, reply: Reply) -> None:
    """Enter the settings and versions of a worker's first reply in dataset.json.

    fingerprint  of the settings, under which they are entered
    """
    known = store.dataset()
    settings = {**known.settings, fingerprint: reply.settings or {}}
    store.write_json(
        "dataset.json",
        msgspec.structs.replace(
            known, settings=settings, versions={**known.versions, **(reply.versions or {})}
        ),
    )


def _require_agreement(
    store: Store,
    kind: str,
    known: Mapping[str, ShapeEntry | MaterialEntry | LightEntry],
    new: Mapping[str, ShapeEntry | MaterialEntry | LightEntry],
) -> None:
    """Raise InputError if two assets have one name, or one shape or material is on two sides."""
    sides = {entry.hash: (entry.side, name) for name, entry in known.items() if kind != "light"}
    for name, entry in new.items():
        if name in known and known[name].hash != entry.hash:
            remedy = "rename the new one, or render into another folder"
            raise InputError(
                f"{store.folder}: {kind} '{name}'",
                f"the one already there ({known[name].hash[:12]})",
                entry.hash[:12],
                remedy,
            )
        if kind != "light" and (held := sides.get(entry.hash)) and held[0] != entry.side:
            remedy = "use the split rule of the folder's first job, or another folder"
            raise InputError(
                f"{store.folder}: {kind} '{name}'",
                f"side {held[0]}, as '{held[1]}' there",
                str(entry.side),
                remedy,
            )


def _light_entry(store: Store, light: Light, known: LightEntry | None) -> LightEntry:
    """Return the entry of a light, after its map has been stored.

    A map that is there already, undamaged and the one that dataset.json names, is left alone.

    known   the light's entry in dataset.json, or None
    """
    file = light_path(light.name, light.hash)
    digest = readable_hash(store.folder / file)
    if (
        digest is None
        or (known and known.file_hash != digest)
        or not _holds(store.folder / file, light.L64)
    ):
        digest = store.place(file, encode_light(light.L64, light.scale), "main")
    return LightEntry(
        hash=light.hash,
        file=file,
        file_hash=digest,
        scale=light.scale,
        licence=light.licence,
        source=light.origin,
        side=light_side(light.hash),
    )


def _holds(path: Path, L: np.ndarray) -> bool:
    """Return whether a stored light map is L, up to the rounding of another machine."""
    try:
        return np.allclose(read_light(path), L, rtol=1e-4, atol=1e-6)
    except InputError:
        return False


def _write_materials(
    store: Store, materials: Iterable[Material], known: Mapping[str, MaterialEntry]
) -> None:
    """Write materials.json: the catalogue entries of all materials that the folder's jobs name.

    known   {name: MaterialEntry} of dataset.json
    Raises  InputError if the file is damaged, and some of its materials are neither the plan's nor
            built in
    """
    path = store.folder / "materials.json"
    ours: dict[str, Entry] = {m.name: m.entry for m in materials}
    try:
        held = (
            {entry.name: entry for entry in read_catalogue(path).materials} if path.exists() else {}
        )
    except InputError as problem:
        held = _built_in(known)
        if lost := sorted(known.keys() - held.keys() - ours.keys()):
            remedy = (
                "restore it, or delete it and render each of the folder's jobs again: they know"
                f" {', '.join(lost[:3])}"
            )
            raise InputError(problem.where, problem.expected, problem.found, remedy) from None
        entries = held | ours
    else:
        entries = held | ours
        if entries == held:
            return
    catalogue = Catalogue(
        title=TITLE,
        credit="each entry names its source and licence",
        materials=tuple(entries.values()),
    )
    store.place("materials.json", encode(catalogue), "main")


def _built_in(known: Mapping[str, MaterialEntry]) -> dict[str, Entry]:
    """Return {name: Entry} of those materials of dataset.json that come with the program."""
    entries = [
        entry for path in BUILT_IN if path.exists() for entry in read_catalogue(path).materials
    ]
    return {
        entry.name: entry
        for entry in entries
        if entry.name in known and known[entry.name].hash == entry.hash
    }
