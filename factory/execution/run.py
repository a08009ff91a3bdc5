"""Carry a plan out: open its folder, leave out the shots that are there, and make the others.

Shapes that the plan has not read yet are read meanwhile, in processes of their own, and the shots
of the first ones are made while others are read (factory.execution.parts).
"""

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from factory.execution.assignment import Assignment, LightSource, ShapeSource
from factory.execution.parts import (
    Part,
    Watch,
    is_by_shapes,
    note_on_materials,
    parts_by_shapes,
    parts_by_shots,
    shares,
)
from factory.execution.pool import Pool
from factory.execution.registration import note_settings, require_no_strangers
from factory.execution.uploads import uploading
from factory.execution.worker import STUDIO, Reply, WorkerConfig
from factory.planning.assets import Assets
from factory.planning.facts import Memory
from factory.planning.fingerprint import render_fingerprint
from factory.planning.job_shapes import Shape
from factory.planning.plan import Plan, Shot
from factory.planning.reading import Reading
from manifests import lock
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.object_store import is_url
from manifests.schema import Failure, Job
from manifests.store import Store, geometry_path
from manifests.subprocesses import processors

# seconds that workers of a Ray cluster whose run was stopped have to end in
SWEEP_PATIENCE = 20.0


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
    ray      address of a Ray cluster whose CPUs all work, instead of `workers`; "auto": this
             machine's cluster, or a new one here; None: processes of this machine
    """

    workers: int = 1
    threads: int | None = None
    device: str = "auto"
    shard: tuple[int, int] | None = None
    limit: int | None = None
    library: str | None = None
    studio: str = STUDIO
    ray: str | None = None

    @property
    def readers(self) -> int:
        """Number of processes that read meshes: as many as workers; for one worker, as CPUs."""
        return processors() if self.workers == 1 else self.workers

    @property
    def threads_per_worker(self) -> int | None:
        """CPU threads of each worker; None, which means all, for a single worker."""
        if self.ray is not None:
            return self.threads or 1
        if self.threads or self.workers == 1:
            return self.threads or None
        return max(1, processors() // self.workers)


def carry_out(
    plan: Plan, folder: str | Path, run_options: RunOptions, watch: Watch | None = None
) -> Outcome:
    """Make every shot of a plan that the folder does not hold yet.

    folder  a path, or the URL of a folder on an object store (manifests.object_store)
    watch   called with (event, value): "total" and the number of this run's shots, "already_there"
            and 1, "made" and a Reply, "failed" and a Failure, "note" and a line for the user,
            "unread" and the number of shapes that are still to be read. While there are such,
            "total" is an estimate, which comes again.
    Raises  InputError; OSError (full disk), after which everything written before is intact
    """
    watch = watch or (lambda event, value: None)
    if is_url(folder):
        return _carried_out_remotely(plan, str(folder), run_options, watch)
    return _carried_out(plan, folder, run_options, watch, takes_turns=True)


def _carried_out(
    plan: Plan,
    folder: str | Path,
    run_options: RunOptions,
    watch: Watch,
    takes_turns: bool,
) -> Outcome:
    """Carry a plan out in a folder.

    takes_turns  whether all parts of the job write into this folder, and see each other's shapes
    """
    # workers on other nodes are given absolute paths
    store = Store(folder if run_options.ray is None else Path(folder).absolute())
    if (note := require_no_strangers(store)) is not None:
        watch("note", note)
    prefix = "worker-" if run_options.ray is None else "worker-ray-"
    if run_options.shard is not None:
        prefix += f"{run_options.shard[0]}of{run_options.shard[1]}-"
    with lock.writing(folder, run_options.shard) as descriptors:
        store.sweep(prefix if run_options.shard else "", SWEEP_PATIENCE)
        memory = Memory(folder, f"{prefix}main")
        shard = run_options.shard
        by_shapes = is_by_shapes(plan.job, plan.assets.unread, shard)
        if not by_shapes or (shard is not None and not takes_turns):
            with closing(Reading(plan.assets.unread, run_options.readers, memory)) as reading:
                parts = parts_by_shots(plan, store, reading, shard, watch)
                return _made(plan, parts, store, run_options, prefix, descriptors, watch)
        own = shares(plan.assets.unread, shard)
        sources = [share.source for share in own]
        with closing(Reading(sources, run_options.readers, memory)) as reading:
            parts = parts_by_shapes(plan, store, reading, own, shard, watch)
            return _made(plan, parts, store, run_options, prefix, descriptors, watch)


def _carried_out_remotely(plan: Plan, url: str, run_options: RunOptions, watch: Watch) -> Outcome:
    """Carry a plan out in a scratch folder, and send what is made to an object store."""
    if run_options.ray is not None:
        remedy = (
            "render with --ray into a folder that the cluster shares, or without it on each machine"
            " with --shard"
        )
        raise InputError("render --ray", "a folder, not a URL, as --out", "a URL", remedy)
    job = hashlib.sha256(msgspec.json.encode(plan.job)).hexdigest()[:12]
    with uploading(url, run_options.shard, lambda line: watch("note", line), job) as uploads:

        def watched(event: str, value: Any) -> None:
            watch(event, value)
            if event == "made":
                uploads.replied(value)

        # each part has a scratch folder of its own
        return _carried_out(plan, uploads.folder, run_options, watched, takes_turns=False)


def _made(
    plan: Plan,
    parts: Iterable[Part | None],
    store: Store,
    run_options: RunOptions,
    prefix: str,
    descriptors: Sequence[int],
    watch: Watch,
) -> Outcome:
    """Make the shots of a plan whose folder is locked.

    parts        shapes that are registered, with their shots; None: the next is not known yet
    prefix       of the workers' names
    descriptors  the locks, which workers hold too
    """
    done, hashes = store.known("records" if plan.job.pictures else "views")
    sources: dict[str, ShapeSource] = {}
    counts = {"already_there": 0, "made": 0, "failed": 0}

    is_noted = False

    def missing() -> Iterator[Shot | None]:
        nonlocal is_noted
        given = 0
        for part in parts:
            if part is None:
                yield None
                continue
            sources.update(shape_sources(part.shapes))
            note = None if is_noted else note_on_materials(part.shapes)
            if note is not None:
                is_noted = True
                watch("note", note)
            for shot in part.shots:
                if shot.id in done:
                    counts["already_there"] += 1
                    watch("already_there", 1)
                    continue
                if given == run_options.limit:
                    return
                given += 1
                known = hashes.get(geometry_path(shot.geometry))
                yield shot if known is None else msgspec.structs.replace(shot, geometry_hash=known)

    assignment = assign(plan, run_options.library)

    def config(number: int) -> WorkerConfig:
        return worker_config(store, f"{prefix}{number:02d}", assignment, run_options)

    failures = None
    replies = _replies(missing(), config, sources, store, run_options, descriptors, watch)
    with closing(replies):
        for shot, reply in replies:
            if reply.settings:
                with lock.changing(store.folder):
                    note_settings(store, plan.render, reply)
            for note in reply.notes:
                watch("note", note)
            if reply.made:
                counts["made"] += 1
                watch("made", reply)
                continue
            failure = _failure(shot, reply.reason)
            failures = failures or Lines(
                store.folder
                / f"failures{prefix.removeprefix('worker').removesuffix('ray-').rstrip('-')}.jsonl"
            )
            failures.append(failure)
            counts["failed"] += 1
            watch("failed", failure)
    return Outcome(**counts)


def _replies(
    shots: Iterator[Shot | None],
    config: Callable[[int], WorkerConfig],
    sources: Mapping[str, ShapeSource],
    store: Store,
    run_options: RunOptions,
    descriptors: Sequence[int],
    watch: Watch,
) -> Generator[tuple[Shot, Reply], None, None]:
    """Yield (shot, Reply) of each shot, made by processes here or on a Ray cluster."""
    if run_options.ray is None:
        folder = store.folder / "partial"
        yield from Pool(run_options.workers, config, descriptors, folder, sources).run(shots)
        return
    from factory.execution.ray_pool import RayPool
    from manifests.ray_cluster import connected

    with connected(run_options.ray):
        threads = run_options.threads_per_worker or 1
        pool = RayPool(config, sources, threads, lambda line: watch("note", line))
        with closing(pool.run(shots)) as replies:
            yield from replies


def assign(plan: Plan, library: str | None = None) -> Assignment:
    """Return what the plan's workers need to know besides their shots and shapes.

    library  a folder of light maps, or None
    """
    return Assignment(
        job=plan.job,
        lights={
            light.name: LightSource(source=light.source, hash=light.hash)
            for light in plan.assets.lights.values()
        },
        library=library,
    )


def shape_sources(shapes: Iterable[Shape]) -> dict[str, ShapeSource]:
    """Return {name: where a worker reads the shape from}."""
    return {s.name: ShapeSource(source=s.source, hash=s.hash, category=s.category) for s in shapes}


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


def _failure(shot: Shot, reason: str) -> Failure:
    return Failure(
        **shot.repeated_in(Failure),
        reason=reason,
        when=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def planned(job: Job, assets: Assets) -> Plan:
    """Return the Plan of a job under this program's render settings."""
    return Plan(job, assets, render_fingerprint(by_error=job.error is not None))


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
