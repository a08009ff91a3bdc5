"""`render`: render a job file, or meshes that options name, into a data set."""

from __future__ import annotations

import argparse
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from factory.commands import job_options
from manifests import JOBS
from manifests.errors import InputError
from manifests.help_format import HelpFormatter
from manifests.notices import notice
from manifests.option_types import positive
from manifests.wording import number_of

if TYPE_CHECKING:
    from factory.execution.run import Outcome
    from manifests.schema import Job

EPILOG = """examples:
  a preset:
    python -m factory render demo --out out/demo
  your own job, with two processes:
    python -m factory render my-job.json --out out/mine --workers 2
  geometry without pictures, with the materials and lights to relight it:
    python -m factory render geometry --out out/geometry
  part 3 of a job array of 8, whose tasks all write into one folder:
    python -m factory render my-job.json --out out/mine --shard 3/8
  every picture with an error of at most 5 (display L2), with as few samples as that takes:
    python -m factory render my-job.json --out out/mine --error 5
  on a Ray cluster, or on a local one if none is there:
    python -m factory render my-job.json --out out/mine --ray auto
  into an object store, with credentials from the environment:
    python -m factory render my-job.json --out s3://bucket/mine
  without a job file:
    python -m factory render --mesh chair.obj --material brass --light city --out out/chair

{presets};
  `python -m factory plan --presets` says what each is for.
A second job into the same folder adds to the data set.
Exit status: 0 all pictures made, 1 some failed (failures.jsonl says why), 2 wrong usage."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `render`."""
    parser = subparsers.add_parser(
        "render",
        help="render a job, or a few meshes, into a data set",
        description=(
            "Renders a job file, or the meshes, materials and lights that options name, into a data"
            " set: pictures, normals, depth, segments and material labels. The same command"
            " continues a run that was stopped; pictures that exist are not rendered twice."
        ),
        epilog=EPILOG.format(presets=_list_of_presets()),
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "job", nargs="?", metavar="JOB", help="a job file (JSON), or the name of a preset"
    )
    parser.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help=(
            "the data set's folder, new or existing; an existing data set is added to, and other"
            " files in the folder stay. Or the URL of a folder on an object store, such as"
            " s3://bucket/mine (extra stores)"
        ),
    )
    job_options.add(parser)
    job_options.add_error(parser)
    parser.add_argument(
        "--limit", type=positive, metavar="N", help="make at most N pictures in this run"
    )
    _add_several_machines(parser)
    parser.add_argument(
        "--geometry-only",
        action="store_true",
        help=(
            "render normals, depth and segments of every view but no pictures, for training that"
            " relights geometry"
        ),
    )
    _add_job_without_file(parser)
    parser.set_defaults(run=run, result_folders=("out",), result_urls=("out",))


def _list_of_presets() -> str:
    """Return the line of the help that names all presets, wrapped like the other lines."""
    names = ", ".join(sorted(path.stem for path in JOBS.glob("*.json")))
    return textwrap.fill(
        f"Presets: {names}", width=96, subsequent_indent="  ", break_on_hyphens=False
    )


def _add_several_machines(parser: argparse.ArgumentParser) -> None:
    """Add the options by which several machines share a job."""
    shared = parser.add_argument_group("several machines", "docs/clusters.md explains both ways.")
    shared.add_argument(
        "--shard",
        metavar="I/N",
        help="render only part I of N of the job, for the tasks of a job array, such as 3/8",
    )
    shared.add_argument(
        "--ray",
        metavar="ADDRESS",
        help=(
            "render on all CPUs of the Ray cluster at HOST:PORT, whose nodes must share the folder."
            " With auto, use the cluster that this machine belongs to, or start one here (extra"
            " ray)"
        ),
    )


# defaults of the options that describe a job without a file, besides --mesh, --material and --light
WITHOUT_JOB = {
    "views": "0",
    "rotations": "0",
    "size": "256",
    "samples": 64,
    "tier": None,
    "light_resolution": None,
    "fov": None,
    "seed": 0,
}


def _add_job_without_file(parser: argparse.ArgumentParser) -> None:
    single = parser.add_argument_group(
        "instead of a job file",
        "These options describe a small job: every mesh is rendered in every material under every"
        " light. A relative path of --mesh or --light is also looked up in --assets.",
    )
    single.add_argument(
        "--mesh",
        action="append",
        default=[],
        metavar="FILE",
        help="a mesh file, or a shape such as chair:17 or sphere; repeat the option for several",
    )
    single.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="NAME",
        help="a material, or a set such as merl/test; repeat the option for several",
    )
    single.add_argument(
        "--light",
        action="append",
        default=[],
        metavar="NAME",
        help="a light's name, or an .hdr or .exr file; repeat the option for several",
    )
    single.add_argument(
        "--views",
        metavar="LIST",
        help="viewpoints from 0 to 23, 15° apart, such as 0,6 or random:5 (default 0)",
    )
    single.add_argument(
        "--rotations",
        metavar="LIST",
        help=(
            "rotations of the light in texels from 0 to 127 (128 are a full turn), such as 0,32 or"
            " random:2 (default 0)"
        ),
    )
    single.add_argument(
        "--size",
        metavar="PIXELS",
        help="size of the pictures: 128, or 128x256 for height and width (default 256)",
    )
    single.add_argument(
        "--samples", type=positive, metavar="N", help="samples per pixel (default 64)"
    )
    single.add_argument(
        "--tier",
        action="append",
        choices=("direct", "shadow", "full"),
        help=(
            "light transport: direct (neither shadows nor interreflection), shadow, or full"
            " (default); repeat the option for several"
        ),
    )
    single.add_argument(
        "--light-resolution",
        action="append",
        choices=("64x128", "full"),
        help="resolution of the light map (default 64x128); repeat the option for both",
    )
    single.add_argument(
        "--fov",
        type=float,
        metavar="DEGREES",
        help="field of view of a perspective camera (default: an orthographic camera)",
    )
    single.add_argument(
        "--seed",
        type=int,
        metavar="N",
        help="random seed of drawn views and rotations, and of the noise (default 0)",
    )


def run(options: argparse.Namespace) -> int:
    """Render the job; return 0 if every picture was made, and 1 if some failed."""
    from msgspec import structs

    from factory.execution.run import RunOptions, carry_out, make_plan, parse_shard
    from factory.planning.assets import resolve_unread

    job, folder = choose_job(options)
    job = job_options.with_error(job, options)
    if options.geometry_only:
        job = structs.replace(job, pictures=False)
    if options.ray and (options.shard or options.workers != 1):
        remedy = "leave them out: --ray uses all CPUs of the cluster"
        raise InputError("render --ray", "neither --shard nor --workers", "one of them", remedy)
    shard = None if options.shard is None else parse_shard(options.shard)
    plan = make_plan(job, resolve_unread(job, folder, options.lights, options.catalogue))
    for note in plan.assets.notes:
        notice(note)
    run_options = RunOptions(
        workers=options.workers,
        device=options.device,
        shard=shard,
        limit=options.limit,
        library=options.lights,
        ray=options.ray,
    )
    what = "picture" if job.pictures else "view"
    with Progress(options.limit, what) as progress:
        outcome = carry_out(plan, options.out, run_options, progress)
    print(outcome_line(outcome, options.out, what))
    return 1 if outcome.failed else 0


def choose_job(options: argparse.Namespace) -> tuple[Job, str | Path | None]:
    """Return the job that the options name, and the folder that its relative paths start from.

    The folder is None for a job that options describe; its paths may lead anywhere.
    Raises InputError if a job file and such options are given together, or neither.
    """
    from factory.planning import jobs

    if options.job and (options.mesh or options.material or options.light):
        raise InputError(
            "render", "a job, or --mesh, --material and --light", "both", "leave one out"
        )
    given = [name for name in WITHOUT_JOB if getattr(options, name) is not None]
    if options.job and given:
        option = "--" + given[0].replace("_", "-")
        remedy = f"write it into a copy of the job file, or leave {option} out"
        raise InputError(f"render {option}", "no job beside it", f"'{options.job}'", remedy)
    if options.job:
        job, folder = jobs.load(options.job)
        return job, options.assets or folder
    missing = [f"--{name}" for name in ("mesh", "material", "light") if not getattr(options, name)]
    if missing:
        raise InputError(
            "render",
            "a job, or --mesh, --material and --light",
            " and ".join(f"no {option}" for option in missing),
            "python -m factory render --help shows examples",
        )
    defaults = {name: value for name, value in WITHOUT_JOB.items() if name not in given}
    job = jobs.from_options(argparse.Namespace(**vars(options) | defaults))
    return job if options.assets is None else _with_assets(job, options.assets), None


def _with_assets(job: Job, folder: str) -> Job:
    """Return the job with paths changed to --assets for files that exist only there."""
    from msgspec import structs

    from factory.lights.files import is_light_path
    from factory.planning.shape_names import is_shape_path, locate

    return structs.replace(
        job,
        shapes=tuple(locate(s, folder) if is_shape_path(s) else s for s in job.shapes),
        lights=tuple(locate(t, folder) if is_light_path(t) else t for t in job.lights),
    )


def outcome_line(outcome: Outcome, folder: str, what: str = "picture") -> str:
    """Return one line that says how many pictures (or views) were made, skipped and failed."""
    line = f"{number_of(outcome.made, what)} made in {folder}"
    if count := outcome.already_there:
        line += f", {count} {'was' if count == 1 else 'were'} there already"
    if outcome.failed:
        where = f"{folder}/failures*.jsonl"  # parts of a job and of a store have files of their own
        line += f"; {outcome.failed} FAILED, see {where}; the same command tries them again"
    return line


class Progress:
    """A progress bar over a run, with rate and time left.

    Pictures that exist already take no time, so they do not count towards the total.
    """

    def __init__(self, limit: int | None = None, unit: str = "picture"):
        self.unit = unit
        self.limit, self.drawn = limit, 0.0
        self.failed, self.total, self.already_there, self.unread = 0, 0, 0, 0

    def __enter__(self) -> Self:
        from manifests.progress import tqdm

        self.bar = tqdm(
            total=0,
            unit=self.unit,
            desc="rendering",
            dynamic_ncols=True,
            delay=0.5,
            smoothing=0.0,  # a rate of recent pictures would be distorted by the slow start
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def __call__(self, event: str, value: Any) -> None:
        """Show an event; see factory.execution.run.carry_out."""
        if event == "note":
            notice(value)
            return
        if event == "total":
            self.total = value
        elif event == "already_there":
            self.already_there += 1
        elif event == "unread":
            self.unread = value
        elif event == "failed":
            self.failed += 1
        words = [f"{self.failed} failed"] if self.failed else []
        words += [f"{number_of(self.unread, 'shape')} to read"] if self.unread else []
        self.bar.set_postfix_str(", ".join(words), refresh=False)
        # while shapes are still being read, the total is an estimate and may be too small
        total = max(self.total - self.already_there, 0)
        self.bar.total = min(total, self.limit or total)
        if event in ("made", "failed"):
            self.bar.update(1)
        elif time.monotonic() - self.drawn > 0.5:
            self.drawn = time.monotonic()
            self.bar.refresh()
