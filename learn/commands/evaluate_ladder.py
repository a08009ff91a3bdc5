"""`learn evaluate-ladder`: weights from the layer's own pictures up to photographs of objects."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from manifests.help_format import HelpFormatter
from manifests.option_types import positive
from manifests.wording import number_of

SIDES = ("development", "test", "second-test")
RUNGS = ("direct", "shadow", "full", "square", "8-bit", "camera")
MESHES = 6  # number of meshes of a folder that are used, unless --mesh-count is given

EPILOG = """examples:
  python -m learn evaluate-ladder --jobs ladder-jobs
  python -m learn evaluate-ladder --data ladder-data --out ladder"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "evaluate-ladder",
        help="measure weights from direct light, rung by rung, up to photographs",
        description=(
            "Measures weights on pictures of the same objects that come closer to a photograph"
            " with each rung: direct light only, with shadows, with interreflection, with square"
            " pixels, as an 8-bit PNG, and from an unknown camera. Reports normals, light and"
            " edits for the program's own families of shapes, for held-out families and for"
            " outside meshes. First write the jobs with --jobs DIR and render them; then measure"
            " the pictures with --data and --out. The same command continues a stopped run."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="the data set that these jobs rendered"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument(
        "--jobs",
        type=Path,
        metavar="DIR",
        help="write the jobs that render the pictures into this folder, and measure nothing",
    )
    parser.add_argument(
        "--side",
        choices=SIDES,
        default="development",
        help=(
            "development (default); test, which may be used only once; or second-test, which has"
            " families that no training has, and only the rungs direct and 8-bit"
        ),
    )
    parser.add_argument(
        "--meshes",
        type=Path,
        metavar="FOLDER",
        help="with --jobs: a folder of outside meshes (default: none, and that group is skipped)",
    )
    parser.add_argument(
        "--mesh-count",
        type=positive,
        metavar="N",
        help=f"with --meshes: number of meshes that are used (default {MESHES})",
    )
    options.add_weights(parser)
    parser.add_argument(
        "--scenes",
        type=positive,
        metavar="N",
        help="number of scenes of each group (default: all)",
    )
    parser.add_argument(
        "--rungs",
        nargs="+",
        choices=RUNGS,
        default=RUNGS,
        metavar="RUNG",
        help=f"rungs that are measured: {', '.join(RUNGS)} (default: all of the side)",
    )
    options.add_count(
        parser,
        "--refined",
        0,
        "number of scenes of each group that are refined on every rung as well",
        least=0,
    )
    parser.add_argument(
        "--incomplete",
        action="store_true",
        help="measure the scenes that are there on every rung although others were not rendered",
    )
    options.add_ray(parser)
    options.add_allow_overlap(parser)
    options.add_device(parser)
    parser.set_defaults(run=run, result_folders=("out", "jobs"))


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    from learn.data import devices
    from learn.evaluation import ladder
    from manifests.errors import InputError

    if arguments.jobs is not None:
        _write_jobs(arguments)
        return
    for name, value in (("meshes", arguments.meshes), ("mesh-count", arguments.mesh_count)):
        if value is not None:
            remedy = "leave it out: the data set has its meshes"
            raise InputError(f"--{name}", "--jobs DIR with it", "none", remedy)
    missing = [name for name in ("data", "out") if getattr(arguments, name) is None]
    if missing:
        raise InputError(
            f"--{missing[0]}", "a folder", "none", "give --data DIR --out DIR, or --jobs DIR"
        )
    options.require_cpu(arguments)
    device = arguments.device if arguments.ray is None else "cpu"
    report = ladder.evaluate(
        ladder.Options(
            data=arguments.data,
            weights=arguments.weights,
            out=arguments.out,
            side=arguments.side,
            scenes=arguments.scenes,
            refined=arguments.refined,
            device=str(devices.choose(device)),
            allow_overlap=arguments.allow_overlap,
            incomplete=arguments.incomplete,
            ray=arguments.ray,
            rungs=arguments.rungs,
        )
    )
    for sentence in report["headline"]:
        print(sentence)
    print(f"See {arguments.out / 'report.md'}")


def _write_jobs(arguments: argparse.Namespace) -> None:
    """Write the jobs that render the pictures, and print the commands that do so."""
    from learn.evaluation import ladder, ladder_design

    count = MESHES if arguments.mesh_count is None else arguments.mesh_count
    paths = ladder.write_jobs(arguments.side, arguments.jobs, arguments.meshes, count)
    print(f"{arguments.jobs}: {number_of(len(paths), 'job')}. These commands render them:")
    if seeds := ladder_design.light_seeds(ladder_design.preset(arguments.side)):
        span = f"--first {seeds[0]} --count {len(seeds)}"
        print(f"python -m factory lights make {span} --library LIGHTS")
    assets = f" --assets {arguments.meshes}" if arguments.meshes is not None else ""
    for path in paths.values():
        print(f"python -m factory render {path} --out DATA --lights LIGHTS{assets}")
    print(f"python -m learn evaluate-ladder --side {arguments.side} --data DATA --out OUT")
