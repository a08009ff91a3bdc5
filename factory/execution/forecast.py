"""The time and disk space that a job will take, estimated from a few of its shots.

kind    of work that a worker spends time on: shape (load and set up), light (set and checked),
        materials, geometry, picture, writing
events  how often each kind of work occurs. This follows from the order of the shots, and is counted
        on the job's first ones.
"""

import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from factory.execution.pool import Pool
from factory.execution.registration import register_job
from factory.execution.run import RunOptions, make_assignment, shape_sources, worker_config
from factory.planning.job_shapes import Shape
from factory.planning.plan import Plan, Shot
from manifests.errors import InputError
from manifests.progress import tqdm
from manifests.schema import Draw
from manifests.store import Store
from manifests.viewpoints import COUNT

COUNTED = 3000  # shots on which events are counted
LEAST_PROBES, MOST_PROBES = 3, 24  # shots that are tried
PROBE_SECONDS = 15.0  # after which no further trial shots are awaited
RECORD_BYTES = 1100  # a line of records/*.jsonl


@dataclass(frozen=True)
class Forecast:
    """What a whole job takes.

    seconds  {kind of work: seconds on one worker}
    bytes    {kind of file: bytes on disk}
    workers  number of processes, among which the seconds are divided
    start    seconds until a worker has started
    computed seconds of processor time on one worker, for all kinds and threads; None: unknown
    """

    seconds: dict[str, float]
    bytes: dict[str, float]
    workers: int
    start: float
    computed: float | None = None

    @property
    def slowdown(self) -> float:
        """Seconds by the clock per second of computing, of a worker of one thread; at least 1.

        If other programs use the processor, this is far above 1.
        """
        return max(1.0, sum(self.seconds.values()) / self.computed) if self.computed else 1.0

    @property
    def hours(self) -> float:
        """Hours until the whole job is done."""
        return (sum(self.seconds.values()) / self.workers + self.start) / 3600


@dataclass(frozen=True)
class ClusterForecast:
    """What a whole job takes on machines of one kind, with one worker of one thread for each core.

    hours       until the job is done, if all machines work from the beginning to the end
    core_hours  that are paid for: of all cores for that time, including their start
    """

    machines: int
    cores: int
    hours: float

    @property
    def core_hours(self) -> float:
        """Hours of one core that are paid for."""
        return self.hours * self.machines * self.cores


def forecast_cluster(
    forecast: Forecast, machines: int, cores: int, pictures: int
) -> ClusterForecast:
    """Return the ClusterForecast of a job whose Forecast was measured with one thread.

    pictures  of the job; a worker makes whole ones, so that the last to finish decides
    """
    workers = machines * cores
    each = sum(forecast.seconds.values()) / max(pictures, 1)
    seconds = -(-pictures // workers) * each + forecast.start
    return ClusterForecast(machines, cores, seconds / 3600)


def probe_shots(plan: Plan) -> Iterator[Shot]:
    """Yield shots from all over a plan: of the first, middle and last shape, then of others.

    They are at most MOST_PROBES, and three where the job has no pictures.
    """
    shapes, lights = _shapes_with_shots(plan), plan.lights
    if not plan.job.pictures:
        for place in sorted({0, len(shapes) // 2, len(shapes) - 1}):
            yield from islice(plan.views_alone(shapes[place]), 1)
        return
    known: set[str] = set()
    for k in range(MOST_PROBES):
        of_shapes, of_lights, of_shots = _places(k)
        shape = shapes[min(int(of_shapes * len(shapes)), len(shapes) - 1)]
        light = lights[min(int(of_lights * len(lights)), len(lights) - 1)]
        group = list(islice(plan.shots_under(shape, *light), 200))
        shot = next((s for s in group[int(of_shots * len(group)) :] if s.id not in known), None)
        if shot is not None:
            known.add(shot.id)
            yield shot


def _shapes_with_shots(plan: Plan) -> list[Shape]:
    """Return the shapes of which there are shots: without `mixed`, some may have no material."""
    if not plan.job.pictures:
        return plan.assets.shapes
    return [shape for shape in plan.assets.shapes if plan.choices(shape)]


def _places(k: int) -> tuple[float, float, float]:
    """Return where shot k lies among shapes, lights and a group's shots, in [0, 1], [0, 1], [0, 1).

    The first three begin, halve and end the first two; the others are spread by steps without a
    common pattern (Martin Roberts' generalised golden ratio).
    """
    if k < LEAST_PROBES:
        return k / 2, k / 2, k / LEAST_PROBES
    return (k * 0.8191725134) % 1, (k * 0.6710436067) % 1, (k * 0.5497004779) % 1


def probe(plan: Plan, run_options: RunOptions) -> Forecast:
    """Return the Forecast of a plan, after rendering a few of its shots.

    Raises  InputError for one of the first shots that fails; OSError
    """
    cost, sizes, start = defaultdict(list), defaultdict(list), time.perf_counter()
    computed: defaultdict[str, list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory(prefix="brdfactory-probe-") as folder:
        store = Store(folder)
        register_job(store, plan, len(plan))
        assignment = make_assignment(plan, run_options.library)
        pool = Pool(
            1,
            lambda _: worker_config(store, "probe", assignment, run_options),
            (),
            Path(folder) / "partial",
            shape_sources(plan.assets.shapes),
        )
        began, shots = time.perf_counter(), list(probe_shots(plan))
        with closing(pool.run(shots)) as replies:
            shown = tqdm(replies, "trial shots", len(shots), leave=False, unit="shot")
            for number, (shot, reply) in enumerate(shown, 1):
                if not reply.made:
                    if number > LEAST_PROBES:
                        continue  # a job goes on without such a shot
                    raise InputError(
                        f"{shot.shape}, view {shot.viewpoint}",
                        "a shot that can be made",
                        reply.reason,
                        "mend what it names",
                    )
                if plan.job.pictures:
                    sizes["images"].append(reply.bytes)
                for kind, spent in (reply.spent or {}).items():
                    cost[kind].append(spent)
                for kind, spent in (reply.computed or {}).items():
                    computed[kind].append(spent)
                if number >= LEAST_PROBES and time.perf_counter() - began > PROBE_SECONDS:
                    break
        sizes["geometry"] = [
            path.stat().st_size for path in (store.folder / "geometry").rglob("*.exr")
        ]
    elapsed = time.perf_counter() - start
    start = elapsed - sum(map(sum, cost.values()))
    events = count_events(plan)
    seconds = {kind: _typical(values) * events[kind] for kind, values in cost.items()}
    files = {"images": events["picture"], "geometry": events["geometry"]}
    space = {kind: sum(of) / max(len(of), 1) * files[kind] for kind, of in sizes.items()}
    return Forecast(
        seconds,
        {**space, "records": RECORD_BYTES * len(plan)},
        run_options.workers,
        max(start, 0.0),
        sum(_typical(values) * events[kind] for kind, values in computed.items()),
    )


def _typical(values: list[float]) -> float:
    """Return the mean, without the first of several values, which includes Cycles' warm-up."""
    later = values[1:] or values
    return sum(later) / len(later)


def count_events(plan: Plan) -> dict[str, float]:
    """Return {kind of work: how often it occurs in a plan}.

    The numbers are exact where they follow from the job; others are counted on the first shots and
    scaled.
    """
    total, job, shapes = len(plan), plan.job, len(_shapes_with_shots(plan))
    if not job.pictures:
        return {"shape": shapes, "geometry": total, "picture": 0, "writing": 0}
    changed, last, counted = {"light": 0, "materials": 0}, None, 0
    for shot in islice(plan, COUNTED):
        now = {
            "light": (shot.light, shot.light_resolution, shot.rotation_texels),
            "materials": (shot.shape, shot.materials),
        }
        for kind in changed:
            changed[kind] += last is None or now[kind] != last[kind]
        last, counted = now, counted + 1
    combinations = total / max(shapes, 1) / max(plan.shots_per_choice, 1)
    views = (
        COUNT * (1 - (1 - job.views.random / COUNT) ** combinations)
        if isinstance(job.views, Draw)
        else len(job.views)
    )
    scaled = {kind: count * total / max(counted, 1) for kind, count in changed.items()}
    return {
        "shape": shapes,
        "geometry": shapes * views,
        "picture": total,
        "writing": total,
        **scaled,
    }
