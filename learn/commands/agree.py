"""`learn agree`: how closely the rendering layer reproduces the pictures of a data set, and why it
differs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from manifests.help_format import HelpFormatter
from manifests.option_types import positive

# exit status: the report is complete, and says that the renderers disagree beyond the limit
DISAGREE = 3

EPILOG = """example:
  python -m learn agree demo-data --out agreement

Exit status: 0 if the two renderers agree within the limit, or if the pictures do not suffice to
judge it; 3 if they disagree beyond it; 1 and 2 as for every command."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "agree",
        help="compare Cycles' pictures with the layer's, and say why they differ",
        description=(
            "Renders every record of a data set again with the differentiable layer, from its"
            " label, normals and light, and compares the result with Cycles' picture. Writes"
            " index.html (open it first), report.md, report.json and charts. Pictures that were"
            " rendered twice with different seeds (a job's repeats = 2) let it separate noise"
            " from disagreement."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "dataset", type=Path, metavar="DIR", help="a folder that `python -m factory render` wrote"
    )
    options.add_out(parser, "folder for the report")
    parser.add_argument(
        "--limit",
        type=positive,
        metavar="N",
        help="compare about N pictures, spread over the data set (default: all)",
    )
    parser.add_argument(
        "--tolerance",
        type=fraction,
        default=4e-3,
        metavar="X",
        help=(
            "relative error allowed in the layer's integral (default 0.004; a smaller one takes"
            " longer)"
        ),
    )
    options.add_device(parser)
    parser.set_defaults(run=run)


def fraction(text: str) -> float:
    """Return a text's number above 0 and below 1. Raises ValueError for any other text."""
    value = float(text)
    if not 0 < value < 1:
        raise ValueError(text)
    return value


def run(arguments: argparse.Namespace) -> int:
    """Return the exit status: DISAGREE if the limit can be judged and is exceeded, else 0."""
    from learn.agreement import page, report
    from learn.data import devices

    device = devices.choose(arguments.device)
    summary = report.make(
        report.Options(
            arguments.dataset, arguments.out, arguments.limit, arguments.tolerance, device
        )
    )
    print(page.verdict(summary["direct"]))
    if summary["whole"]:
        print(page.whole_verdict(summary["whole"]))
    print(f"See {arguments.out / 'index.html'}")
    return DISAGREE if summary["direct"]["holds"] is False else 0
