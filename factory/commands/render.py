"""`render JOB --out DIR`, or `render --mesh … --material … --light … --out DIR`: pictures, normals
and labels into a dataset.
"""

import sys
import time

from manifests.errors import InputError

EPILOG = """examples
  python -m factory render demo --out out/demo                         a preset (all are named below)
  python -m factory render my-job.json --out out/mine --workers 2      your own job
  python -m factory render geometry --out out/geometry --workers 2     geometry alone, with materials and lights to relight it
  python -m factory render my-job.json --out out/mine --shard 3/8      part 3 of a job array of 8; all write into one folder
  python -m factory render --mesh chair.obj --material brass --light city --views 0,6 --size 128 --out out/chair

Presets: agreement, demo, finetune, geometry, multi-material, pretrain, smallest, test; `plan --presets` says what each is for.
Run the same command again to continue: what is there is not rendered twice, and a second job into the same folder adds to it.
Exit status: 0 all pictures made, 1 some failed (failures.jsonl says why), 2 wrong usage."""


def register(subparsers):
    """Add the parser of `render`."""
    import argparse

    parser = subparsers.add_parser(
        "render",
        help="render a job into a dataset",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("job", nargs="?", help="a job file (JSON), or a preset's name")
    parser.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help="the dataset's folder; made if it is not there, added to if it is",
    )
    add_making(parser)
    add_naming(parser)
    parser.add_argument(
        "--limit", type=_whole, metavar="N", help="make at most N pictures in this run"
    )
    parser.add_argument("--shard", metavar="I/N", help="make only part I of N (job arrays)")
    parser.add_argument(
        "--geometry-only",
        action="store_true",
        help="normals, depth and segments of every view, no pictures: for relighting",
    )
    single = parser.add_argument_group("without a job file")
    single.add_argument(
        "--mesh",
        action="append",
        default=[],
        metavar="FILE",
        help="a mesh file, or a shape such as chair:17 or sphere",
    )
    single.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="NAME",
        help="a material, or a set such as merl/test",
    )
    single.add_argument(
        "--light",
        action="append",
        default=[],
        metavar="NAME",
        help="a light's name, or an .hdr or .exr file",
    )
    single.add_argument(
        "--views",
        default="0",
        metavar="LIST",
        help="viewpoints 0 to 23, 15° apart: 0,6 or random:5 (default 0)",
    )
    single.add_argument(
        "--rotations",
        default="0",
        metavar="LIST",
        help="texels 0 to 127 that the light is turned by (default 0)",
    )
    single.add_argument(
        "--size",
        default="256",
        metavar="PIXELS",
        help="128, or 128x256 for height and width (default 256)",
    )
    single.add_argument(
        "--samples", type=_whole, default=64, metavar="N", help="samples per pixel (default 64)"
    )
    single.add_argument(
        "--tier",
        action="append",
        choices=("direct", "shadow", "full"),
        help="light transport (default full)",
    )
    single.add_argument(
        "--light-resolution",
        action="append",
        choices=("64x128", "full"),
        help="resolution of the light's map (default 64x128)",
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
        default=0,
        metavar="N",
        help="random seed of all draws and of the noise (default 0)",
    )
    parser.set_defaults(run=run)


def add_making(parser):
    """Options that say how to carry a job out."""
    parser.add_argument(
        "--workers",
        type=_whole,
        default=1,
        metavar="N",
        help="number of worker processes (default 1, which uses all threads)",
    )
    parser.add_argument(
        "--device",
        default="auto",
        choices=("auto", "cpu", "cuda", "optix", "hip", "metal", "oneapi"),
        help="device that renders (default auto)",
    )


def add_naming(parser):
    """Options that say where names and relative paths lead."""
    parser.add_argument(
        "--assets",
        metavar="DIR",
        help="folder that a job's relative paths start from (default: the job file's folder)",
    )
    parser.add_argument(
        "--lights", metavar="DIR", help="a folder of light maps whose names may be used"
    )
    parser.add_argument(
        "--catalogue",
        action="append",
        default=[],
        metavar="FILE",
        help="a file of materials besides the built-in ones",
    )


def _whole(text):
    import argparse

    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= 10**9):
        raise argparse.ArgumentTypeError(f"expected a whole number of 1 or more, found '{text}'")
    return int(text)


def run(options):
    """Render; 0 if every picture came out."""
    from msgspec import structs

    from factory.execution.run import RunOptions, carry_out, parsed_shard, planned
    from factory.planning import jobs

    job, folder = chosen(options, jobs)
    if options.geometry_only:
        job = structs.replace(job, pictures=False)
    shard = None if options.shard is None else parsed_shard(options.shard)
    plan = planned(job, resolve_assets(job, folder, options))
    for note in plan.assets.notes:
        print(f"factory: {note}", file=sys.stderr)
    run_options = RunOptions(
        workers=options.workers,
        device=options.device,
        shard=shard,
        limit=options.limit,
        library=options.lights,
    )
    what = "pictures" if job.pictures else "views"
    with Progress(options.limit, what[:-1]) as progress:
        outcome = carry_out(plan, options.out, run_options, progress)
    print(outcome_line(outcome, options.out, what))
    return 1 if outcome.failed else 0


def chosen(options, jobs):
    """The job that the options name, and where its paths start."""
    if options.job and (options.mesh or options.material or options.light):
        raise InputError(
            "render", "a job, or --mesh with --material and --light", "both", "leave one out"
        )
    if options.job:
        job, folder = jobs.load(options.job)
        return job, options.assets or folder
    missing = [f"--{name}" for name in ("mesh", "material", "light") if not getattr(options, name)]
    if missing:
        raise InputError(
            "render",
            "a job, or --mesh, --material and --light",
            f"no {', '.join(missing)}",
            "python -m factory render --help shows examples",
        )
    return jobs.from_options(options), None


def resolve_assets(job, folder, options):
    """The job's assets, read with a progress bar when there are many."""
    from functools import partial

    from tqdm import tqdm

    from factory.planning.assets import resolve

    watch = partial(tqdm, leave=False, delay=1.0, mininterval=0.1 if sys.stderr.isatty() else 10.0)
    return resolve(job, folder, options.lights, options.catalogue, watch)


def outcome_line(outcome, folder, what="pictures"):
    """What a run came to, in one line."""
    line = f"{outcome.made} {what} made in {folder}"
    if outcome.already_there:
        line += f", {outcome.already_there} were there"
    if outcome.failed:
        line += (
            f"; {outcome.failed} FAILED, see {folder}/failures.jsonl; the same command tries them"
            " again"
        )
    return line


class Progress:
    """One bar over a run: pictures (or views), rate, time left. What was there already takes no
    time and is taken off the total.
    """

    def __init__(self, limit=None, unit="picture"):
        self.unit = unit
        self.limit, self.failed, self.total, self.drawn = limit, 0, 0, 0.0

    def __enter__(self):
        from tqdm import tqdm

        calm = 0.1 if sys.stderr.isatty() else 10.0  # a log file wants few lines
        self.bar = tqdm(
            total=0,
            unit=self.unit,
            desc="rendering",
            dynamic_ncols=True,
            mininterval=calm,
            delay=0.5,
        )
        return self

    def __exit__(self, *_):
        self.bar.close()

    def __call__(self, event, value):
        if event == "note":
            self.bar.write(f"factory: {value}", file=sys.stderr)
            return
        if event == "total":
            self.total = value
        elif event == "already_there":
            self.total -= 1
        elif event == "failed":
            self.failed += 1
            self.bar.set_postfix_str(f"{self.failed} failed")
        self.bar.total = min(self.total, self.limit or self.total)
        if event in ("made", "failed"):
            self.bar.update(1)
        elif time.monotonic() - self.drawn > 0.5:
            self.drawn = time.monotonic()
            self.bar.refresh()
