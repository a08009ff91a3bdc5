"""What a job will take, from three of its shots made for real: seconds by kind of work, bytes by
kind of file.

kind    shape (load and set up), light (set and checked), materials, geometry, picture, writing:
what a worker spends time on
events  how often each kind happens: counted on the job's first shots, for it follows from their
order
"""

import tempfile
from collections import defaultdict
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from factory.execution.pool import Pool, config_for_worker
from factory.execution.run import RunOptions, assign, processors, register
from manifests.errors import InputError
from manifests.schema import Draw
from manifests.store import Store
from manifests.viewpoints import COUNT

COUNTED = 3000  # shots on which events are counted
RECORD_BYTES = 1100  # a line of records/*.jsonl


@dataclass(frozen=True)
class Forecast:
    """seconds by kind for the whole job on one worker; bytes by kind of file; workers that share
    the time; start: one worker's.
    """

    seconds: dict
    bytes: dict
    workers: int
    start: float

    @property
    def hours(self):
        """Of the whole job, workers side by side."""
        return (sum(self.seconds.values()) / self.workers + self.start) / 3600

    @property
    def gigabytes(self):
        """On disk."""
        return sum(self.bytes.values()) / 1e9


def probe_shots(plan):
    """Three shots: of the first, the middle and the last shape, under different lights."""
    shapes, result = plan.assets.shapes, []
    if not plan.job.pictures:
        return [
            shot
            for place in sorted({0, len(shapes) // 2, len(shapes) - 1})
            for shot in islice(plan.views_alone(shapes[place]), 1)
        ]
    for k, place in enumerate((0, len(shapes) // 2, len(shapes) - 1)):
        group = list(
            islice(plan.group(shapes[place], *plan.lights[k * (len(plan.lights) - 1) // 2]), 200)
        )
        result.append(
            next(
                (
                    shot
                    for shot in group[k * len(group) // 3 :]
                    if shot.id not in {s.id for s in result}
                ),
                None,
            )
        )
    return [shot for shot in result if shot is not None]


def probed(plan, run_options: RunOptions):
    """The Forecast of a plan. Raises InputError for a shot that fails, OSError: a probe tells
    before anything long starts.
    """
    import time

    cost, sizes, start = defaultdict(list), defaultdict(list), time.perf_counter()
    threads = run_options.threads or (
        None if run_options.workers == 1 else max(1, processors() // run_options.workers)
    )
    with tempfile.TemporaryDirectory(prefix="brdfactory-probe-") as folder:
        store = Store(folder)
        register(store, plan)
        assignment = assign(plan, run_options.library)
        pool = Pool(
            1,
            lambda _: config_for_worker(
                folder, "probe", run_options.device, threads, assignment, run_options.studio
            ),
            (),
            Path(folder) / "partial",
        )
        for shot, reply in pool.run(probe_shots(plan)):
            if not reply.made:
                raise InputError(
                    f"{shot.shape}, view {shot.viewpoint}",
                    "a shot that can be made",
                    reply.reason,
                    "mend what it names",
                )
            if plan.job.pictures:
                sizes["images"].append(reply.bytes)
            for kind, seconds in reply.spent.items():
                cost[kind].append(seconds)
        sizes["geometry"] = [
            path.stat().st_size for path in (store.folder / "geometry").rglob("*.exr")
        ]
    elapsed = time.perf_counter() - start
    start = elapsed - sum(map(sum, cost.values()))
    events = expected_events(plan)
    seconds = {kind: _typical(values) * events[kind] for kind, values in cost.items()}
    files = {"images": events["picture"], "geometry": events["geometry"]}
    taken = {
        kind: sum(result) / max(len(result), 1) * files[kind] for kind, result in sizes.items()
    }
    return Forecast(
        seconds,
        {**taken, "records": RECORD_BYTES * len(plan)},
        run_options.workers,
        max(start, 0.0),
    )


def _typical(values):
    """The mean, the first left out where there are more: it warms Cycles up."""
    later = values[1:] or values
    return sum(later) / len(later)


def expected_events(plan):
    """How often each kind of work happens in a plan: exact where it follows from the job, else
    counted on its first shots and scaled.
    """
    total, job = len(plan), plan.job
    if not job.pictures:
        return {"shape": len(plan.assets.shapes), "geometry": total, "picture": 0, "writing": 0}
    changed, last, counted = {"light": 0, "materials": 0}, None, 0
    for shot in islice(plan, COUNTED):
        now = {
            "light": (shot.light, shot.light_resolution, shot.rotation_texels),
            "materials": (shot.shape, shot.materials),
        }
        for kind in changed:
            changed[kind] += last is None or now[kind] != last[kind]
        last, counted = now, counted + 1
    drawn = isinstance(job.views, Draw)
    combinations = total / len(plan.assets.shapes) / max(plan.each, 1)
    views = (
        COUNT * (1 - (1 - job.views.random / COUNT) ** combinations) if drawn else len(job.views)
    )
    scaled = {kind: count * total / max(counted, 1) for kind, count in changed.items()}
    return {
        "shape": len(plan.assets.shapes),
        "geometry": len(plan.assets.shapes) * views,
        "picture": total,
        "writing": total,
        **scaled,
    }
