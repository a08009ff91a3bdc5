"""Carries out a plan: makes every shot that the data set's folder does not have yet.

Shapes that have not been read yet are read at the same time, by other processes, so that the shots
of the first shapes are made while the remaining shapes are read (factory.execution.parts).
"""

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from factory.execution.absolute_paths import make_paths_absolute
from factory.execution.assignment import Assignment, LightSource, ShapeSource
from factory.execution.parts import (
    Part,
    Watch,
    note_on_materials,
    parts_by_shapes,
    parts_by_shots,
    split_sources,
    splits_by_shape,
)
from factory.execution.pool import Pool
from factory.execution.registration import note_settings, require_no_foreign_files
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
from manifests.store import Store
from manifests.store_paths import geometry_path
from manifests.subprocesses import processors

# seconds to wait for the workers of a stopped run on a Ray cluster to end
SWEEP_PATIENCE = 20.0
MOST_WORKERS = 1024


@dataclass(frozen=True)
class Outcome:
    """How many pictures a run made, how many failed, and how many existed before it."""

    made: int
    failed: int
    already_there: int


@dataclass(frozen=True)
class RunOptions:
    """How to carry a job out. Pixels do not depend on any of this, as far as Cycles repeats itself.

    workers  number of processes
    threads  CPU threads of each process; None: an equal share of the machine's
    device   one of factory.render.device.NAMES
    shard    (i, n) to make only part i of n, 1 ≤ i ≤ n; None: the whole job
    limit    the largest number of pictures to make in this run; None: all
    library  a folder of the user's light maps, or None
    studio   module:class of the studio; tests without Blender name a substitute
    ray      address of a Ray cluster, all of whose CPUs render in place of `workers`; "auto": the
             cluster that this machine belongs to, or a new one here; None: this machine's processes
    """

    workers: int = 1
    threads: int | None = None
    device: str = "auto"
    shard: tuple[int, int] | None = None
    limit: int | None = None
    library: str | None = None
    studio: str = STUDIO
    ray: str | None = None

    def __post_init__(self) -> None:
        """Raise InputError for numbers of workers that no machine has memory for."""
        if not 1 <= self.workers <= MOST_WORKERS:
            raise InputError(
                "workers",
                f"a number from 1 to {MOST_WORKERS}",
                str(self.workers),
                "give the number of processes that the machine has memory for, about 1 GB each",
            )

    @property
    def readers(self) -> int:
        """Number of processes that read meshes: one per worker, or one per CPU for one worker."""
        return processors() if self.workers == 1 else self.workers

    @property
    def threads_per_worker(self) -> int | None:
        """CPU threads of each worker; None, which means all of them, for a single worker."""
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
    watch   called with (event, value) whenever something happens:
            "total"          number of this run's shots; an estimate that is repeated while shapes
                             are still to be read
            "unread"         number of shapes that are still to be read
            "already_there"  1, for a shot that the folder has
            "made"           Reply
            "failed"         Failure
            "note"           a line for the user
    Raises  InputError; OSError (full disk), after which everything written before is intact
    """
    watch = watch or (lambda event, value: None)
    if is_url(folder):
        return _carry_out_remotely(plan, str(folder), run_options, watch)
    return _carry_out(plan, folder, run_options, watch, takes_turns=True)


def _carry_out(
    plan: Plan,
    folder: str | Path,
    run_options: RunOptions,
    watch: Watch,
    takes_turns: bool,
) -> Outcome:
    """Carry a plan out in a local folder.

    takes_turns  whether all parts of the job write into this same folder, so that they take turns
                 in registering shapes and see each other's
    """
    # workers on other nodes are given absolute paths
    store = Store(folder if run_options.ray is None else Path(folder).absolute())
    if (note := require_no_foreign_files(store)) is not None:
        watch("note", note)
    prefix = "worker-" if run_options.ray is None else "worker-ray-"
    if run_options.shard is not None:
        prefix += f"{run_options.shard[0]}of{run_options.shard[1]}-"
    with lock.writing(folder, run_options.shard) as descriptors:
        store.sweep(prefix if run_options.shard else "", SWEEP_PATIENCE)
        memory = Memory(folder, f"{prefix}main")
        shard = run_options.shard
        by_shapes = splits_by_shape(plan.job, plan.assets.unread, shard)
        if not by_shapes or (shard is not None and not takes_turns):
            with closing(Reading(plan.assets.unread, run_options.readers, memory)) as reading:
                parts = parts_by_shots(plan, store, reading, shard, watch)
                return _make_shots(plan, parts, store, run_options, prefix, descriptors, watch)
        own = split_sources(plan.assets.unread, shard)
        sources = [share.source for share in own]
        with closing(Reading(sources, run_options.readers, memory)) as reading:
            parts = parts_by_shapes(plan, store, reading, own, shard, watch)
            return _make_shots(plan, parts, store, run_options, prefix, descriptors, watch)


def _carry_out_remotely(plan: Plan, url: str, run_options: RunOptions, watch: Watch) -> Outcome:
    """Carry a plan out in a scratch folder, and upload everything it makes to an object store."""
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
                uploads.count_reply(value)

        # each part has a scratch folder of its own
        return _carry_out(plan, uploads.folder, run_options, watched, takes_turns=False)


def _make_shots(
    plan: Plan,
    parts: Iterable[Part | None],
    store: Store,
    run_options: RunOptions,
    prefix: str,
    descriptors: Sequence[int],
    watch: Watch,
) -> Outcome:
    """Make the shots of a plan whose folder is locked.

    parts        yields registered shapes with their shots; None while the next are still being read
    prefix       what the workers' names start with
    descriptors  file descriptors of the folder's locks, which the workers hold as well
    """
    known = store.known_ids("records" if plan.job.pictures else "views")
    sources: dict[str, ShapeSource] = {}
    if run_options.ray is not None:
        plan, parts, run_options = make_paths_absolute(plan, parts, run_options)
    counts = {"already_there": 0, "made": 0, "failed": 0}
    missing = _missing_shots(parts, known, sources, counts, run_options.limit, watch)
    assignment = make_assignment(plan, run_options.library)

    def config(number: int) -> WorkerConfig:
        return worker_config(store, f"{prefix}{number:02d}", assignment, run_options)

    failures = None
    replies = _replies(missing, config, sources, store, run_options, descriptors, watch)
    with closing(replies):
        for shot, reply in replies:
            if reply.settings:
                with lock.changing(store.folder):
                    note_settings(store, plan.fingerprint, reply)
            for note in reply.notes:
                watch("note", note)
            if reply.made:
                counts["made"] += 1
                watch("made", reply)
                continue
            failure = _failure(shot, reply.reason)
            failures = failures or Lines(_failures_file(store, prefix))
            failures.append(failure)
            counts["failed"] += 1
            watch("failed", failure)
    return Outcome(**counts)


def _failures_file(store: Store, prefix: str) -> Path:
    """Return the file of shots that failed, by the prefix of the workers' names."""
    part = prefix.removeprefix("worker").removesuffix("ray-").rstrip("-")
    return store.folder / f"failures{part}.jsonl"


def _missing_shots(
    parts: Iterable[Part | None],
    known: tuple[set[str], dict[str, str]],
    sources: dict[str, ShapeSource],
    counts: dict[str, int],
    limit: int | None,
    watch: Watch,
) -> Iterator[Shot | None]:
    """Yield the shots that are still to be made, at most `limit`; None: the next is not known yet.

    known    ids of the lines that are there, and hashes of their geometry files
    sources  to which the sources of the parts' shapes are added
    counts   of which `already_there` is counted up
    """
    done, hashes = known
    given, is_noted = 0, False
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
            if given == limit:
                return
            given += 1
            made = hashes.get(geometry_path(shot.geometry))
            yield shot if made is None else msgspec.structs.replace(shot, geometry_hash=made)


def _replies(
    shots: Iterator[Shot | None],
    config: Callable[[int], WorkerConfig],
    sources: Mapping[str, ShapeSource],
    store: Store,
    run_options: RunOptions,
    descriptors: Sequence[int],
    watch: Watch,
) -> Generator[tuple[Shot, Reply], None, None]:
    """Yield (shot, Reply) for each shot, made by processes here or on a Ray cluster."""
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


def make_assignment(plan: Plan, library: str | None = None) -> Assignment:
    """Return what a plan's workers need to know besides their shots and shapes.

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
    """Return {shape's name: where a worker reads it from}."""
    return {s.name: ShapeSource(source=s.source, hash=s.hash, category=s.category) for s in shapes}


def worker_config(
    store: Store, worker: str, assignment: Assignment, run_options: RunOptions
) -> WorkerConfig:
    """Return the configuration of the worker with this name."""
    return WorkerConfig(
        folder=str(store.folder),
        worker=worker,
        device=run_options.device,
        threads=run_options.threads_per_worker,
        studio=run_options.studio,
        assignment=assignment,
    )


def _failure(shot: Shot, reason: str) -> Failure:
    """Return the line of failures.jsonl about a shot that failed now."""
    return Failure(
        **shot.repeated_in(Failure),
        reason=reason,
        when=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def make_plan(job: Job, assets: Assets) -> Plan:
    """Return the Plan of a job under this program's render settings."""
    return Plan(job, assets, render_fingerprint(by_error=job.error is not None))


def parse_shard(text: str) -> tuple[int, int]:
    """Parse "3/8" as (3, 8), part 3 of 8. Raises InputError."""
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
