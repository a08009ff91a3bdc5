"""Carry a plan out: open its folder, leave out the shots that are there, and make the others."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from factory.execution.pipeline import Assignment, LightSource, ShapeSource
from factory.execution.pool import Pool
from factory.execution.worker import STUDIO, Reply, WorkerConfig
from factory.planning.assets import Assets, Light, Material
from factory.planning.fingerprint import render_fingerprint
from factory.planning.plan import Plan, Shot
from manifests import lock
from manifests.arrays import encode_light, read_light
from manifests.errors import InputError
from manifests.materials import BUILT_IN, Catalogue, Entry, encode, read_catalogue
from manifests.schema import Dataset, Failure, Job, LightEntry, MaterialEntry, Order, ShapeEntry
from manifests.splits import light_side
from manifests.store import Lines, Store, geometry_path, light_path, readable_hash

Watch = Callable[[str, Any], None]


@dataclass(frozen=True)
class Outcome:
    """How many pictures were made, how many failed, and how many were there before the run."""

    made: int
    failed: int
    already_there: int


@dataclass(frozen=True)
class RunOptions:
    """How to carry a job out. No option alters a pixel beyond Cycles' repeatability.

    workers  number of processes
    threads  CPU threads of each process, None: an equal part of the machine's
    device   one of factory.render.device.NAMES
    shard    None, or (i, n): only part i of n, 1 ≤ i ≤ n
    limit    the largest number of pictures in this run, None: all
    library  a folder of light maps, or None
    studio   module:class of the studio; tests without Blender name another
    """

    workers: int = 1
    threads: int | None = None
    device: str = "auto"
    shard: tuple[int, int] | None = None
    limit: int | None = None
    library: str | None = None
    studio: str = STUDIO

    @property
    def threads_per_worker(self) -> int | None:
        """CPU threads of each worker; None, which means all, for a single worker."""
        if self.threads or self.workers == 1:
            return self.threads or None
        return max(1, processors() // self.workers)


def carry_out(
    plan: Plan, folder: str | Path, run_options: RunOptions, watch: Watch | None = None
) -> Outcome:
    """Make every shot of a plan that the folder does not hold yet.

    watch   called with (event, value): "total" and the number of this run's shots, "already_there"
            and 1, "made" and a Reply, "failed" and a Failure, "note" and a line for the user
    Raises  InputError; OSError (full disk), after which everything written before is intact
    """
    watch = watch or (lambda event, value: None)
    store, prefix = Store(folder), "worker-"
    if run_options.shard is not None:
        prefix += f"{run_options.shard[0]}of{run_options.shard[1]}-"
    with lock.writing(folder, run_options.shard) as descriptors:
        store.sweep(prefix if run_options.shard else "")
        with lock.changing(folder):
            register(store, plan)
        return _made(plan, store, run_options, prefix, descriptors, watch)


def _made(
    plan: Plan,
    store: Store,
    run_options: RunOptions,
    prefix: str,
    descriptors: Sequence[int],
    watch: Watch,
) -> Outcome:
    """Make the shots of a plan whose folder is locked and registered.

    prefix       of the workers' names
    descriptors  the locks, which workers hold too
    """
    done, hashes = store.known("records" if plan.job.pictures else "views")
    first, end = _bounds(len(plan), run_options.shard)
    watch("total", end - first)
    counts = {"already_there": 0, "made": 0, "failed": 0}

    def missing() -> Iterator[Shot]:
        for shot in islice(plan, first, end):
            if shot.id in done:
                counts["already_there"] += 1
                watch("already_there", 1)
            else:
                known = hashes.get(geometry_path(shot.geometry))
                yield shot if known is None else msgspec.structs.replace(shot, geometry_hash=known)

    assignment = assign(plan, run_options.library)
    pool = Pool(
        run_options.workers,
        lambda number: worker_config(store, f"{prefix}{number:02d}", assignment, run_options),
        descriptors,
        store.folder / "partial",
    )
    failures = None
    for shot, reply in pool.run(islice(missing(), run_options.limit)):
        if reply.settings:
            with lock.changing(store.folder):
                _note_settings(store, plan, reply)
        for note in reply.notes:
            watch("note", note)
        if reply.made:
            counts["made"] += 1
            watch("made", reply)
            continue
        failure = _failure(shot, reply.reason)
        failures = failures or Lines(
            store.folder / f"failures{prefix.removeprefix('worker').rstrip('-')}.jsonl"
        )
        failures.append(failure)
        counts["failed"] += 1
        watch("failed", failure)
    return Outcome(**counts)


def assign(plan: Plan, library: str | None = None) -> Assignment:
    """Return what the plan's workers need to know besides their shots.

    library  a folder of light maps, or None
    """
    return Assignment(
        job=plan.job,
        shapes={
            s.name: ShapeSource(source=s.source, hash=s.hash, category=s.category)
            for s in plan.assets.shapes
        },
        lights={
            light.name: LightSource(source=light.source, hash=light.hash)
            for light in plan.assets.lights.values()
        },
        library=library,
    )


def worker_config(
    store: Store, worker: str, assignment: Assignment, run_options: RunOptions
) -> WorkerConfig:
    """Return the configuration of the worker of that name."""
    return WorkerConfig(
        folder=str(store.folder),
        worker=worker,
        device=run_options.device,
        threads=run_options.threads_per_worker,
        studio=run_options.studio,
        assignment=assignment,
    )


def register(store: Store, plan: Plan) -> None:
    """Enter a plan and its assets in the folder's dataset.json, materials.json and lights/.

    Raises  InputError if the folder has another asset of the same name, or has one of the assets
            on the other side of the split
    """
    known = store.dataset() if (store.folder / "dataset.json").exists() else Dataset()
    assets = plan.assets
    shapes = {
        s.name: ShapeEntry(
            hash=s.hash,
            category=s.category,
            side=s.side,
            role=s.role,
            segments=s.segments,
            licence=s.licence,
            report=s.report,
        )
        for s in assets.shapes
    }
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
    orders = known.orders
    if not any(
        msgspec.structs.replace(order.job, name=plan.job.name, about=plan.job.about) == plan.job
        for order in orders
    ):
        orders = (
            *orders,
            Order(
                job=plan.job, shots=len(plan), begun=datetime.now(UTC).isoformat(timespec="seconds")
            ),
        )
    store.write_json(
        "dataset.json",
        msgspec.structs.replace(
            known,
            orders=orders,
            # ids are hashed with the fingerprint, so it is entered before the first record
            settings={plan.render: {}, **known.settings},
            shapes={**known.shapes, **shapes},
            materials={**known.materials, **materials},
            lights={**known.lights, **lights},
        ),
    )


def _require_agreement(
    store: Store,
    kind: str,
    known: Mapping[str, ShapeEntry | MaterialEntry | LightEntry],
    new: Mapping[str, ShapeEntry | MaterialEntry | LightEntry],
) -> None:
    """Raise InputError if a name has two meanings, or a shape or material stands on two sides."""
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
        title="The materials of this dataset",
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


def _note_settings(store: Store, plan: Plan, reply: Reply) -> None:
    """Enter the settings and versions of a worker's first reply in dataset.json."""
    known = store.dataset()
    settings = {**known.settings, plan.render: reply.settings}
    store.write_json(
        "dataset.json",
        msgspec.structs.replace(
            known, settings=settings, versions={**known.versions, **(reply.versions or {})}
        ),
    )


def _bounds(total: int, shard: tuple[int, int] | None) -> tuple[int, int]:
    """Return the first shot and the end of a part: successive shots, which share scene data."""
    i, n = shard or (1, 1)
    return total * (i - 1) // n, total * i // n


def processors() -> int:
    """Return the number of CPUs that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _failure(shot: Shot, reason: str) -> Failure:
    return Failure(
        **shot.repeated_in(Failure),
        reason=reason,
        when=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def planned(job: Job, assets: Assets) -> Plan:
    """Return the Plan of a job under this program's render settings."""
    return Plan(job, assets, render_fingerprint())


def parsed_shard(text: str) -> tuple[int, int]:
    """Return "3/8" as (3, 8). Raises InputError."""
    i, slash, n = text.partition("/")
    if not (
        slash
        and text.isascii()
        and len(text) < 20
        and i.isdigit()
        and n.isdigit()
        and 1 <= int(i) <= int(n)
    ):
        raise InputError(
            "--shard",
            "I/N with 1 ≤ I ≤ N",
            f"'{text}'",
            "write --shard 1/8 for the first of eight parts",
        )
    return int(i), int(n)
