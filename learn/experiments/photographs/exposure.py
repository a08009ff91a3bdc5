"""Measure the rule that estimates a photograph's exposure, on pictures of known light.

Rendered pictures are exposed as a camera would expose them. The factor that leads back to their
radiance is fitted against the object's brightness, and the fitted rule, the one in use
(learn/data/photographs.py) and one factor for all are compared by how far they miss it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from learn.experiments import runner


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data sets to fit on and to check on."""
    options.add_data(parser, "a data set with pictures to fit the rule on, of the training split")
    parser.add_argument(
        "--check",
        type=Path,
        nargs="*",
        default=[],
        metavar="DIR",
        help="further data sets, to measure the rules on",
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"line", "pictures", "rules", "missed": {data set: {rule: how far it misses}}}."""
    from learn.data.records import Records
    from learn.experiments.photographs import exposure_rule
    from manifests.errors import InputError

    records = [Records(folder) for folder in (arguments.data, *arguments.check)]
    for each in records:
        if not len(each):
            remedy = "render some: python -m factory render JOB --out DIR"
            raise InputError(each.folder, "pictures", "none", remedy)
    return exposure_rule.fit_and_check(records[0], records[1:])


def tables(report: runner.Report) -> str:
    """Return the fitted line with its intervals, and how far each rule misses."""
    lines = [[name, runner.interval(values, 2)] for name, values in report["line"].items()]
    share = next(key for key in next(iter(report["missed"].values()))["fitted"] if "beyond" in key)
    missed = [
        [folder, rule, f"{row['rms_factor']:.2f}", f"{100 * row[share]:.0f} %"]
        for folder, rules in report["missed"].items()
        for rule, row in rules.items()
    ]
    factor = share.removeprefix("share_beyond_")
    head = [
        "data set",
        "rule",
        "root mean square miss, as a factor",
        f"missed by more than {factor}",
    ]
    return (
        "# The exposure of a photograph from its object's brightness\n\n"
        f"X = typical · Y^−dependence, fitted to {report['pictures']} pictures; 95 % intervals over"
        " shapes, materials and lights.\n\n"
        + runner.table(["constant", "fitted"], lines)
        + "\n"
        + runner.table(head, missed)
    )
