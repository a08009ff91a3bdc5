"""Check whether method="auto" keeps its tolerance, in random materials, lights and cameras.

Each case is rendered exactly and by auto at tolerances from 5e-2 to 1e-4. The report holds the
share of cases that kept each tolerance, and every case that did not.
"""

from __future__ import annotations

import argparse

from learn.commands import options
from learn.experiments import runner


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the number of cases, the size of their pictures and the seed."""
    options.add_count(parser, "--cases", 500, "number of random cases")
    options.add_size(parser, 128)
    options.add_seed(parser, "seed of the random cases")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"cases", "kept": {tolerance: share of cases}, "misses": [row]}."""
    from learn.experiments.layer import random_scenes
    from manifests import materials as catalogue

    labels = [
        material.label for material in catalogue.load_catalogue(catalogue.BUILT_IN[0]).values()
    ]
    rows = random_scenes.compare_scenes(labels, arguments.cases, arguments.size, arguments.seed)
    kept = {
        f"{t:g}": sum(row["kept"] for row in rows if row["tolerance"] == t) / arguments.cases
        for t in random_scenes.TOLERANCES
    }
    misses = [row for row in rows if not row["kept"]]
    return {"cases": arguments.cases, "kept": kept, "misses": misses}


def tables(report: runner.Report) -> str:
    """Return the share of cases that kept each tolerance, and the worst of the others."""
    rows = []
    for tolerance, share in report["kept"].items():
        errors = [m["error"] for m in report["misses"] if m["tolerance"] == float(tolerance)]
        worst = f"{max(errors) / float(tolerance):.2f}" if errors else "–"
        rows.append([tolerance, f"{100 * share:.1f} %", len(errors), worst])
    head = ["tolerance", "kept", "misses", "worst miss ÷ tolerance"]
    return (
        '# Tolerances of method="auto" in random scenes\n\n'
        f"{report['cases']} random cases; errors are relative to a picture's mean radiance.\n\n"
        + runner.table(head, rows)
    )
