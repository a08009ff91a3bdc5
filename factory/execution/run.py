"""A job carried out: its folder opened, what is there left out, the rest made, until nothing is
owed.
"""

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice

import msgspec
import numpy as np

from factory.execution.pipeline import Assignment, LightSource, ShapeSource
from factory.execution.pool import Pool, config_for_worker
from factory.execution.worker import STUDIO
from factory.planning.fingerprint import render_fingerprint
from factory.planning.plan import Plan
from manifests import lock
from manifests.arrays import encode_light, read_light
from manifests.errors import InputError
from manifests.materials import BUILT_IN, Catalogue, encode, read_catalogue
from manifests.schema import Dataset, Failure, LightEntry, MaterialEntry, Order, ShapeEntry
from manifests.splits import light_side
from manifests.store import Lines, Store, geometry_path, light_path, readable_hash


@dataclass(frozen=True)
class Outcome:
    """What a run came to: pictures made, failures in this run, shots that were there before."""

    made: int
    failed: int
    already_there: int


@dataclass(frozen=True)
class RunOptions:
    """How to carry a job out, none of which alters a pixel beyond Cycles' repeatability.

    workers  processes; threads: CPU threads of each, None: the machine's, shared out
    shard    None, or (i, n): only part i of n, 1 ≤ i ≤ n
    limit    at most so many pictures in this run, None: all
    library  a folder of light maps, or None
    studio   module:class, for tests without Blender
    """

    workers: int = 1
    threads: int | None = None
    device: str = "auto"
    shard: tuple[int, int] | None = None
    limit: int | None = None
    library: str | None = None
    studio: str = STUDIO


def carry_out(plan: Plan, folder, run_options: RunOptions, watch=None):
    """Make every shot of a plan that the folder does not hold yet.

    watch    called with (event, value): "total" shots of this run, "already_there" one that was
    there, "made" a Reply, "failed" a Failure,
             "note" a line for the user
    Returns  Outcome
    Raises   InputError; OSError (full disk) with everything that was written before intact
    """
    watch = watch or (lambda event, value: None)
    store, prefix = (
        Store(folder),
        (
            "worker-"
            if run_options.shard is None
            else f"worker-{run_options.shard[0]}of{run_options.shard[1]}-"
        ),
    )
    with lock.writing(folder, run_options.shard) as descriptors:
        store.sweep(prefix if run_options.shard else "")
        with lock.changing(folder):
            register(store, plan)
        return _made(plan, store, run_options, prefix, descriptors, watch)


def _made(plan, store, run_options, prefix, descriptors, watch):
    done, hashes = store.known("records" if plan.job.pictures else "views")
    shots = _part(plan, run_options.shard)
    watch("total", _part_length(plan, run_options.shard))
    counts = {"already_there": 0, "made": 0, "failed": 0}

    def owed():
        for shot in shots:
            if shot.id in done:
                counts["already_there"] += 1
                watch("already_there", 1)
            else:
                known = hashes.get(geometry_path(shot.geometry))
                yield shot if known is None else msgspec.structs.replace(shot, geometry_hash=known)

    assignment = assign(plan, run_options.library)
    threads = run_options.threads or (
        None if run_options.workers == 1 else max(1, processors() // run_options.workers)
    )
    pool = Pool(
        run_options.workers,
        lambda number: config_for_worker(
            store.folder,
            f"{prefix}{number:02d}",
            run_options.device,
            threads,
            assignment,
            run_options.studio,
        ),
        descriptors,
        store.folder / "partial",
    )
    failures = None
    for shot, reply in pool.run(islice(owed(), run_options.limit)):
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


def assign(plan, library=None):
    """What the plan's workers need to know."""
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


def register(store, plan):
    """Write down, in dataset.json, materials.json and lights/, what a plan brings to the folder.

    Raises  InputError if the folder knows another thing by a name of the plan's, or has it on the
    other side of the split
    """
    held = store.dataset() if (store.folder / "dataset.json").exists() else Dataset()
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
        light.name: _light_entry(store, light, held.lights.get(light.name))
        for light in assets.lights.values()
    }
    for kind, known, brought in (
        ("shape", held.shapes, shapes),
        ("material", held.materials, materials),
        ("light", held.lights, lights),
    ):
        _agree(store, kind, known, brought)
    _write_materials(store, assets.materials, held.materials)
    orders = held.orders
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
            held,
            orders=orders,
            # ids are hashed with it: known before the first of them is written
            settings={plan.render: {}, **held.settings},
            shapes={**held.shapes, **shapes},
            materials={**held.materials, **materials},
            lights={**held.lights, **lights},
        ),
    )


def _agree(store, kind, known, brought):
    """Names mean one thing, and things stand on one side."""
    sides = {entry.hash: (entry.side, name) for name, entry in known.items() if kind != "light"}
    for name, entry in brought.items():
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
                entry.side,
                remedy,
            )


def _light_entry(store, light, known):
    """The entry of a light, its stored map put in place unless it is there, whole and the one that
    the folder knows.

    known   its LightEntry in dataset.json, or None
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


def _holds(path, L):
    """Whether a stored light map is L, up to what another machine's rounding makes of the same
    light.
    """
    try:
        return np.allclose(read_light(path), L, rtol=1e-4, atol=1e-6)
    except InputError:
        return False


def _write_materials(store, materials, known):
    """materials.json: the catalogue's lines of all materials that the folder's jobs name.

    known   {name: MaterialEntry} of dataset.json
    Raises  InputError if it is damaged, and some of its materials are neither the plan's nor built
    in
    """
    path, ours = store.folder / "materials.json", {m.name: m.entry for m in materials}
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


def _built_in(known):
    """{name: Entry} of those materials of dataset.json that the program itself brings."""
    entries = [
        entry for path in BUILT_IN if path.exists() for entry in read_catalogue(path).materials
    ]
    return {
        entry.name: entry
        for entry in entries
        if entry.name in known and known[entry.name].hash == entry.hash
    }


def _note_settings(store, plan, reply):
    held = store.dataset()
    settings = {**held.settings, plan.render: reply.settings}
    store.write_json(
        "dataset.json",
        msgspec.structs.replace(
            held, settings=settings, versions={**held.versions, **(reply.versions or {})}
        ),
    )


def _part_length(plan, shard):
    first, end = _bounds(len(plan), shard)
    return end - first


def _part(plan, shard):
    return islice(plan, *_bounds(len(plan), shard))


def _bounds(total, shard):
    """First and end of a part: neighbours stay together, so that persistent data pays."""
    i, n = shard or (1, 1)
    return total * (i - 1) // n, total * i // n


def processors():
    """CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def _failure(shot, reason):
    return Failure(
        **shot.repeated_in(Failure),
        reason=reason,
        when=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def planned(job, assets):
    """The Plan of a job under the settings in force."""
    return Plan(job, assets, render_fingerprint())


def parsed_shard(text):
    """ "3/8" as (3, 8). Raises InputError."""
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
