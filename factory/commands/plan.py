"""`plan JOB`: how many pictures a job has, by split, and the time and disk space it takes."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

from factory.commands import job_options
from manifests.help_format import HelpFormatter
from manifests.notices import notice
from manifests.option_types import above_zero, positive
from manifests.wording import number_of

if TYPE_CHECKING:
    from factory.execution.forecast import Forecast
    from factory.planning.plan import Plan
    from manifests.schema import Job

# times as long as it computes that a picture may take before the plan mentions it
BUSY = 1.5

EPILOG = """examples:
  python -m factory plan demo
  python -m factory plan my-job.json --workers 2
  python -m factory plan pretrain --no-probe
  python -m factory plan pretrain --machines 20 --cores 32 --price 0.04
  python -m factory plan --presets            the jobs that come with the program"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `plan`."""
    parser = subparsers.add_parser(
        "plan",
        help="show how many pictures a job has, and how much time and disk space it takes",
        description=(
            "Counts the pictures of a job by split, and forecasts the time and disk space that"
            " rendering it takes. The forecast renders pictures from all over the job for about 15"
            " seconds. Writes no files."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "job", nargs="?", metavar="JOB", help="a job file (JSON), or the name of a preset"
    )
    parser.add_argument(
        "--presets", action="store_true", help="list the jobs that come with the program"
    )
    parser.add_argument(
        "--probe",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="forecast time and disk space by rendering a few pictures (default: yes)",
    )
    parser.add_argument(
        "--machines",
        type=positive,
        metavar="N",
        help="forecast for a cluster of N machines whose cores are as fast as this one's",
    )
    parser.add_argument(
        "--cores",
        type=positive,
        metavar="C",
        help=(
            "cores per machine, each of which runs one worker (default: as many as this machine"
            " has)"
        ),
    )
    parser.add_argument(
        "--price",
        type=above_zero,
        metavar="P",
        help="price of one core for one hour, in any currency, to forecast the cost",
    )
    parser.add_argument("--schema", action="store_true", help="print the JSON Schema of job files")
    job_options.add(parser)
    job_options.add_error(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the plan; return 0."""
    from factory.execution.run import make_plan
    from factory.planning import jobs
    from factory.planning.plan import require_shots
    from manifests.errors import InputError

    if options.presets or options.schema:
        print(_presets() if options.presets else _schema())
        return 0
    if not options.job:
        raise InputError(
            "plan", "a job", "none", "name a file or a preset; plan --presets lists them"
        )
    _require_consistent(options)
    job, folder = jobs.load(options.job)
    job = job_options.with_error(job, options)
    plan = make_plan(job, job_options.resolve_assets(job, options.assets or folder, options))
    for note in plan.assets.notes:
        notice(note)
    require_shots(len(plan), plan.assets.shapes)
    for line in describe(plan):
        print(line)
    if options.probe:
        print(_forecast(plan, options))
    return 0


def describe(plan: Plan) -> Iterator[str]:
    """Yield the lines that say how many shapes, materials, lights and pictures a plan has."""
    from collections import Counter

    from manifests.schema import Draw

    job, assets = plan.job, plan.assets
    categories = Counter((s.category, s.role) for s in assets.shapes)
    views, rotations = (
        f"{numbers.random} random {what}{'s' * (numbers.random != 1)}"
        if isinstance(numbers, Draw)
        else number_of(len(numbers), what)
        for numbers, what in ((job.views, "view"), (job.rotations, "rotation"))
    )
    height, width = job.camera.size
    each = (
        f"{number_of(len(plan), 'picture')} of {height}×{width}, {describe_quality(job)}"
        if job.pictures
        else f"{number_of(len(plan), 'view')} of {height}×{width}, geometry only"
    )
    yield f"job {job.name}: {each}, {describe_camera(job)}"
    yield "  shapes     " + ", ".join(
        f"{count} {category} ({role})" for (category, role), count in sorted(categories.items())
    )
    sides = Counter(m.side for m in assets.materials)
    yield f"  materials  {len(assets.materials)}: " + ", ".join(
        f"{count} {side}" for side, count in sorted(sides.items())
    )
    yield f"  lights     {len(job.lights)}: " + ", ".join(dict.fromkeys(job.lights))
    if not job.pictures:
        sides = Counter(shape.side for shape in assets.shapes)
        yield f"  each       {views}"
        yield "  split      " + ", ".join(
            f"{count * len(plan) // len(assets.shapes)} {side}"
            for side, count in sorted(sides.items())
        )
        return
    kinds = f"{'/'.join(job.tiers)} × {'/'.join(job.light_resolutions)}"
    yield f"  each       {views} × {rotations} × {kinds} × {number_of(job.repeats, 'seed')}"
    yield "  split      " + ", ".join(
        f"{count} {split}" for split, count in split_counts(plan).items()
    )


def describe_quality(job: Job) -> str:
    """Return the words for a job's samples, or for the error that it names."""
    return (
        number_of(job.samples, "sample") if job.error is None else f"display error ≤ {job.error:g}"
    )


def describe_camera(job: Job) -> str:
    """Return the words for a job's camera: its lens, roll and elevation, or their ranges."""
    camera, ranges = job.camera, job.camera_ranges
    of_camera = "orthographic" if camera.fov_deg is None else f"{camera.fov_deg:g}° wide"
    if ranges is None:
        return of_camera + (f", rolled by {camera.roll_deg:g}°" if camera.roll_deg else "")
    if ranges.fov_deg is not None:
        low, high = ranges.fov_deg
        share = ranges.perspective_share
        of_camera = f"{share:.0%} of views {low:g}° to {high:g}° wide, the others orthographic"
        if share == 1:
            of_camera = f"{low:g}° to {high:g}° wide"
    parts = ["a camera drawn for each view", of_camera]
    spans = (("elevation", ranges.elevation_deg), ("roll", ranges.roll_deg))
    parts += [f"{name} {span[0]:g}° to {span[1]:g}°" for name, span in spans if span]
    return ": ".join((parts[0], ", ".join(parts[1:])))


def split_counts(plan: Plan) -> dict[str, int]:
    """Return {split: number of pictures}, from the assets' sides without making the shots."""
    from collections import Counter

    from manifests.splits import split_of

    counts: Counter[str] = Counter()
    each = plan.shots_per_choice * len(plan.lights)
    for shape in plan.assets.shapes:
        for choice in plan.choices(shape):
            split = (
                plan.split_of_draws(shape)
                if isinstance(choice, int)
                else split_of(shape.side, [m.side for m in choice])
            )
            counts[split] += each
    return dict(sorted(counts.items(), reverse=True))


def _require_consistent(options: argparse.Namespace) -> None:
    """Raise InputError for options of a cluster that do not fit together."""
    from manifests.errors import InputError

    if options.machines is None:
        for name in ("cores", "price"):
            if getattr(options, name) is not None:
                remedy = "give --machines 1 for one machine"
                raise InputError(f"plan --{name}", "--machines N", "none", remedy)
    elif options.workers != 1:
        remedy = "leave --workers out: a machine has a worker for each of its cores"
        raise InputError("plan --machines", "no --workers", f"{options.workers}", remedy)
    elif not options.probe:
        remedy = "leave one of them out: the forecast needs pictures"
        raise InputError("plan --machines", "no --no-probe", "both", remedy)


def _forecast(plan: Plan, options: argparse.Namespace) -> str:
    """Return the lines for time and disk space, and for a cluster those of its cost."""
    from factory.execution.forecast import probe
    from factory.execution.run import RunOptions

    forecast = probe(
        plan,
        RunOptions(
            workers=options.workers,
            threads=1 if options.machines else None,
            device=options.device,
            library=options.lights,
        ),
    )
    whole = sum(forecast.seconds.values()) or 1.0
    parts = ", ".join(
        f"{kind} {seconds / whole:.0%}"
        for kind, seconds in sorted(forecast.seconds.items(), key=lambda item: -item[1])
    )
    files = ", ".join(f"{kind} {_bytes(size)}" for kind, size in forecast.bytes.items())
    disk = f"  disk       about {_bytes(sum(forecast.bytes.values()))} ({files})"
    if options.machines:
        lines = [*_cluster(forecast, options, len(plan), parts), disk]
        return "\n".join(lines)
    return (
        f"  time       about {_time(forecast.hours)} with {number_of(forecast.workers, 'worker')}"
        f" ({parts})\n{disk}"
    )


def _cluster(
    forecast: Forecast, options: argparse.Namespace, pictures: int, parts: str
) -> Iterator[str]:
    """Yield the lines of a cluster: its workers, hours, core-hours and cost."""
    from factory.execution.forecast import forecast_cluster
    from manifests.subprocesses import processors

    cores = options.cores or processors()
    cluster = forecast_cluster(forecast, options.machines, cores, pictures)
    workers = cluster.machines * cluster.cores
    yield (
        f"  cluster    {number_of(cluster.machines, 'machine')} of"
        f" {number_of(cluster.cores, 'core')}: {number_of(workers, 'worker')} of one thread"
    )
    yield f"  time       about {_time(cluster.hours)} ({parts})"
    if forecast.slowdown > BUSY and os.getloadavg()[0] > processors():
        yield (
            f"  busy       other programs made these pictures take {forecast.slowdown:.1f} times as"
            " long as they compute: divide time and cost by that for machines of your own"
        )
    if pictures < workers:
        yield f"  idle       {workers - pictures} of the workers: there are {pictures} to make"
    cost = f"  cost       about {_amount(cluster.core_hours)} core-hours"
    if options.price is None:
        yield f"{cost} (--price P gives the money)"
    else:
        money = _amount(cluster.core_hours * options.price)
        yield f"{cost}: {money} at {options.price:g} per core-hour"


def _amount(value: float) -> str:
    """Return a number with three digits, or without decimals from 100 on."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _time(hours: float) -> str:
    minutes = hours * 60
    if minutes < 2:
        return f"{minutes * 60:.0f} s"
    if minutes < 120:
        return f"{minutes:.0f} min"
    return f"{hours:.1f} h" if hours < 72 else f"{hours / 24:.1f} days"


def _bytes(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


def _presets() -> str:
    from factory.planning import jobs

    lines = []
    for name, path in jobs.presets().items():
        job, _ = jobs.load(path)
        lines.append(f"{name:<16} {job.about}")
    return "\n".join(lines)


def _schema() -> str:
    from manifests.publish import documents

    return documents()["job.schema.json"].rstrip()
