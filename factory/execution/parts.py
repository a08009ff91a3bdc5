"""What a run makes of a job, in parts that follow as its shapes are read.

by shapes  A part of a job array reads its own shapes alone. The job's sources are ordered by their
           number modulo n, and this order is cut into n equal parts: each holds about every n-th
           source, and so some of every family. A source at a cut is read by two parts, each of
           which makes its share of the shots.
by shots   All shapes are read first, and each part makes successive shots: where a shape's role
           depends on the others (`roles_are_independent` of factory.planning.job_shapes), in a job
           with fewer sources than parts, and on an object store, where parts cannot take turns.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Any, NamedTuple

from factory.execution.registration import register_job, register_shapes
from factory.execution.reservations import Reservations
from factory.planning.assets import add_shapes
from factory.planning.facts import Facts
from factory.planning.job_shapes import (
    Arrivals,
    Shape,
    duplicate_note,
    no_shapes_error,
    roles_are_independent,
)
from factory.planning.plan import Plan, Shot, require_shots
from factory.planning.reading import Reading
from factory.planning.shape_names import Source
from factory.shapes.mesh_import import has_own_materials
from manifests import lock
from manifests.schema import Job
from manifests.store import Store
from manifests.wording import number_of

# A part of a job array that needed t seconds to register shapes, its wait for other parts included,
# registers the next ones PAUSE * t seconds later, so that parts seldom wait for each other.
PAUSE = 10.0

Watch = Callable[[str, Any], None]  # as factory.execution.run.carry_out calls it


class Part(NamedTuple):
    """Shapes that are registered, and the shots that this run is to make or finds made."""

    shapes: Sequence[Shape]
    shots: Iterable[Shot]


@dataclass(frozen=True)
class Share:
    """A source of a run, and which of its shots are the run's: from first/parts to end/parts."""

    source: Source
    first: int = 0
    end: int = 1
    parts: int = 1

    def bounds(self, shots: int) -> tuple[int, int]:
        """Return the first of so many shots that is the run's, and the end."""
        return shots * self.first // self.parts, shots * self.end // self.parts


def splits_by_shape(job: Job, sources: Sequence[Source], shard: tuple[int, int] | None) -> bool:
    """Return whether a run begins with the first shapes while others are read.

    It follows from the job and the number of parts, so that all parts divide the job alike.
    """
    return (
        bool(sources)
        and len(sources) >= (shard or (1, 1))[1]
        and roles_are_independent(job, sources)
    )


def split_sources(sources: Sequence[Source], shard: tuple[int, int] | None) -> list[Share]:
    """Return the sources of part i of n by shapes; of all n parts each shot is in one share."""
    i, n = shard or (1, 1)
    count = len(sources)
    dealt = [number for first in range(n) for number in range(first, count, n)]
    begin, stop = count * (i - 1), count * i  # in n-ths of a source
    return [
        Share(sources[dealt[place]], max(begin - place * n, 0), min(stop - place * n, n), n)
        for place in range(begin // n, -(-stop // n))
    ]


def shot_range(total: int, shard: tuple[int, int] | None) -> tuple[int, int]:
    """Return the first shot and the end of a part by shots."""
    i, n = shard or (1, 1)
    return total * (i - 1) // n, total * i // n


def parts_by_shots(
    plan: Plan, store: Store, reading: Reading, shard: tuple[int, int] | None, watch: Watch
) -> Iterator[Part | None]:
    """Yield one Part after all shapes have been read and registered.

    Raises  InputError: a bad mesh, no shots, or what `register_job` raises
    """
    if plan.assets.unread:
        notes = len(plan.assets.notes)
        assets = add_shapes(plan.job, plan.assets, _count_facts(reading, watch))
        plan = replace(plan, assets=assets)
        for note in assets.notes[notes:]:
            watch("note", note)
    require_shots(len(plan), plan.assets.shapes)
    with lock.changing(store.folder):
        register_job(store, plan, len(plan))
    first, end = shot_range(len(plan), shard)
    watch("total", end - first)
    yield Part(plan.assets.shapes, islice(plan, first, end))


def _count_facts(reading: Reading, watch: Watch) -> Iterator[tuple[Source, Facts]]:
    """Yield all facts of a reading; the watch is called with how many are to come."""
    for pair in reading.each():
        watch("unread", reading.unread)
        yield pair


def parts_by_shapes(
    plan: Plan,
    store: Store,
    reading: Reading,
    own: Iterable[Share],
    shard: tuple[int, int] | None,
    watch: Watch,
) -> Iterator[Part | None]:
    """Yield Parts with shapes that have been read and registered; None: the next is not known yet.

    reading  of the sources of `own`
    Raises   InputError: a bad mesh, two meshes of one name, no shots, or what `register_job` raises
    """
    arrivals, shares_of = Arrivals(plan.job), {share.source: share for share in own}
    reservations = Reservations(store.folder, plan.job, plan.assets.unread, shard is not None)
    if shard is not None:  # `status` and other parts know of the job before its shapes are read
        with lock.changing(store.folder):
            register_job(store, _with(plan, []), 0)
    shots, count, due, is_registered = 0, 0, 0.0, shard is not None
    waiting: list[Shape] = []
    everything: list[Shape] = []
    while reading.unread or waiting:
        arrived = [arrivals.take(source, facts) for source, facts in reading.ready()]
        waiting += [shape for shape in arrived if shape is not None]
        watch("unread", reading.unread)
        begun = time.monotonic()
        if not waiting or (reading.unread and begun < due):
            if reading.unread:
                yield None
            continue
        with lock.changing(store.folder):
            kept, notes = _reserve(plan, store, waiting, reservations)
            if kept:
                enter = register_shapes if is_registered else register_job
                enter(store, _with(plan, kept), reservations.shots)
                is_registered = True
                reservations.write()
        if shard is not None:
            due = time.monotonic() + PAUSE * (time.monotonic() - begun)
        waiting = []
        for note in notes:
            watch("note", note)
        if not kept:
            continue
        made = [_share_of(plan, shape, shares_of[shape.source]) for shape in kept]
        shots, count = shots + sum(number for number, _ in made), count + len(kept)
        everything += kept
        watch("total", shots + shots * reading.unread // count)
        yield Part(kept, chain.from_iterable(each for _, each in made))
    watch("total", shots)
    if arrivals.is_empty and shard is None:
        raise no_shapes_error(plan.job)
    if shard is None:
        require_shots(shots, everything)
    if arrivals.is_empty and shard is not None:
        roles = ", ".join(plan.job.roles)
        watch("note", f"part {shard[0]} of {shard[1]} has no shapes with a role among {roles}")


def _reserve(
    plan: Plan,
    store: Store,
    shapes: Iterable[Shape],
    reservations: Reservations,
) -> tuple[list[Shape], list[str]]:
    """Return the shapes that are made from these sources, and a line for each duplicate.

    dataset.json is held by the caller. Raises InputError: a duplicate with another role
    """
    reservations.refresh()
    kept: list[Shape] = []
    left_out: list[Shape] = []
    for shape in shapes:
        is_ours = reservations.reserve(shape.hash, shape.source, len(_with(plan, [shape])))
        (kept if is_ours else left_out).append(shape)
    if not left_out:
        return kept, []
    there = store.dataset().shapes if (store.folder / "dataset.json").exists() else {}
    first = {entry.hash: (name, entry.role) for name, entry in there.items()}
    first |= {shape.hash: (shape.name, shape.role) for shape in kept}
    return kept, [
        note
        for shape in left_out
        if (note := duplicate_note(shape, *first.get(shape.hash, (shape.name, shape.role))))
    ]


def note_on_materials(shapes: Sequence[Shape]) -> str | None:
    """Return a line about shapes whose files have materials of their own, None without such."""
    names = [shape.name for shape in shapes if has_own_materials(shape.report)]
    if not names:
        return None
    others = f" and {number_of(len(names) - 1, 'other shape')}" if len(names) > 1 else ""
    have = "has materials of its own" if len(names) == 1 else "have materials of their own"
    return f"{names[0]}{others} {have}, which are not read; those of the job replace them"


def _share_of(plan: Plan, shape: Shape, share: Share) -> tuple[int, Iterator[Shot]]:
    """Return how many shots of a shape are the run's, and these."""
    alone = _with(plan, [shape])
    first, end = share.bounds(len(alone))
    return end - first, islice(alone, first, end)


def _with(plan: Plan, shapes: list[Shape]) -> Plan:
    """Return the plan with these shapes alone."""
    return replace(plan, assets=replace(plan.assets, shapes=shapes, unread=()))
