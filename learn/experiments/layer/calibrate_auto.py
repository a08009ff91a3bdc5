"""Fit the constants by which method="auto" plans: errors of maps, and seconds of sums.

They decide how fast auto is and not how accurate, because what it renders is checked. To use
them, put the report's "calibration" in the place of learn/methods/calibration.json.
"""

from __future__ import annotations

import argparse

from learn.commands import options
from learn.experiments import runner


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the size of the pictures that are timed."""
    options.add_size(parser, 192)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"calibration": the content of learn/methods/calibration.json}."""
    from learn.experiments.layer import auto_calibration

    return {"calibration": auto_calibration.fit(arguments.size)}


def tables(report: runner.Report) -> str:
    """Return the fitted constants beside those in use."""
    from pathlib import Path

    from manifests.reading import read

    in_use = read(Path(__file__).parents[2] / "methods" / "calibration.json", dict)
    rows = [
        [group, name, f"{value:.3g}", f"{in_use[group][name]:.3g}"]
        for group, constants in report["calibration"].items()
        for name, value in constants.items()
    ]
    head = ["group", "constant", "fitted", "in use"]
    return '# Constants by which method="auto" plans\n\n' + runner.table(head, rows)
