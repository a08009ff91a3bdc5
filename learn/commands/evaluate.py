"""`learn evaluate`: compares edits by all methods, and the parts that they are made of, with their
truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from manifests.help_format import HelpFormatter
from manifests.option_types import positive

EPILOG = """example:
  python -m learn evaluate --data test-data --out evaluation"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "evaluate",
        help="measure edits against Cycles' renderings of the same edits",
        description=(
            "Compares edits with the truth. Our method and others edit pictures of a data set, each"
            " into the material of another picture of the same shape, view and light, with which"
            " the edit is then compared. Writes index.html (open it first), report.md and"
            " report.json. Every finished edit is a line in edits.jsonl:"
            " the same command continues a stopped run, and a larger --edits adds to it."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    options.add_data(parser, "a data set with pictures in two materials or more of each view")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_out(parser)
    parser.add_argument(
        "--edits",
        type=positive,
        default=100,
        metavar="N",
        help="number of edits (default 100; the paper has 500)",
    )
    refine = parser.add_mutually_exclusive_group()
    refine.add_argument(
        "--refine",
        action="store_true",
        default=True,
        help="also measure refined predictions, Section 3.5 of the paper (default)",
    )
    refine.add_argument(
        "--no-refine",
        dest="refine",
        action="store_false",
        help="leave refined predictions out, which is many times faster",
    )
    options.add_refinement_method(parser)
    parser.add_argument(
        "--baselines",
        type=Path,
        metavar="DIR",
        help="weights of the baselines of Section 4.5; those that are not there are left out",
    )
    parser.add_argument(
        "--lpips",
        type=Path,
        metavar="FILE",
        help="LPIPS' AlexNet weights, .safetensors (docs/evaluation-methods.md); without them,"
        " reports have no column LPIPS",
    )
    parser.add_argument(
        "--lights",
        type=Path,
        metavar="FILE",
        help=".npz of the light maps that the weights were trained with, for the table of edits by"
        " distance to the nearest of them; not needed if these were the program's measured maps"
        " and the weights say which of them they saw",
    )
    parser.add_argument(
        "--geometry",
        type=Path,
        metavar="DIR",
        help="a data set with geometry of the shapes that the weights were trained on, for the"
        " table of edits by distance to the nearest of them; without it, these rows are left out",
    )
    options.add_materials(
        parser,
        "the training materials whose mean is the row 'mean material': the data set's own, or the"
        " built-in ones (default: dataset)",
    )
    options.add_seed(parser, "seed with which edits are drawn")
    parser.add_argument(
        "--processes",
        type=positive,
        metavar="N",
        help="number of processes (default: one per CPU that this process may use)",
    )
    options.add_ray(parser)
    options.add_count(parser, "--gallery", 12, "number of edits shown as pictures", least=0)
    options.add_allow_overlap(parser)
    options.add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    from learn.data import devices
    from learn.evaluation import report, run
    from manifests import subprocesses
    from manifests.errors import InputError

    options.require_cpu(arguments)
    if arguments.ray is not None and arguments.processes is not None:
        remedy = "leave it out: --ray uses all CPUs of the cluster"
        raise InputError("evaluate --ray", "no --processes", f"{arguments.processes}", remedy)
    if arguments.refinement_method is not None and not arguments.refine:
        remedy = "leave one of them out"
        raise InputError("--refinement-method", "refinement", "--no-refine", remedy)
    names = run.Options.__dataclass_fields__
    given = {name: value for name, value in vars(arguments).items() if name in names}
    device = arguments.device if arguments.ray is None else "cpu"
    given["device"] = str(devices.choose(device))
    given["processes"] = arguments.processes or subprocesses.processors()
    print(report.summary_line(run.evaluate(run.Options(**given))))
    print(f"See {arguments.out / 'index.html'}")
