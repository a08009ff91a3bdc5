"""Carry a plan out: open its folder, leave out the shots that are there, and make the others."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec

from factory.execution.pipeline import Assignment, LightSource, ShapeSource
from factory.execution.pool import Pool
from factory.execution.registration import note_settings, register
from factory.execution.worker import STUDIO, WorkerConfig
from factory.planning.assets import Assets
from factory.planning.fingerprint import render_fingerprint
from factory.planning.plan import Plan, Shot
from manifests import lock
from manifests.errors import InputError
from manifests.schema import Failure, Job
from manifests.store import Lines, Store, geometry_path

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
                note_settings(store, plan.render, reply)
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
