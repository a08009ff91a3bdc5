"""Time every rendering method against the error that it makes: a work-precision chart.

A sphere in materials from matte to mirror under several lights, from far and from near, is rendered
by every method at several settings. A setting's time is the median over all materials and lights,
of one thread, forward and backward; its error is the median over all cases, or the worst of them.
cases.csv has each single case.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAMERAS = ("orthographic", "perspective")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the materials, lights and cameras, the size of pictures and the number of processes."""
    parser.add_argument(
        "--quick",
        action="store_true",
        help="three materials, two lights and pictures of 64² at most: two minutes",
    )
    options.add_size(parser, 256)
    parser.add_argument(
        "--material",
        action="append",
        metavar="NAME",
        help="a material of the catalogue; repeatable (default: eight from matte to mirror)",
    )
    parser.add_argument(
        "--lights",
        type=Path,
        metavar="DIR",
        help="a folder of .exr maps, or a data set, to light with (default: computed lights)",
    )
    parser.add_argument(
        "--light",
        action="append",
        metavar="NAME",
        help="use only this light; repeatable (default: all)",
    )
    parser.add_argument(
        "--camera", nargs="+", choices=CAMERAS, default=CAMERAS, help="cameras (default: both)"
    )
    parser.add_argument(
        "--processes",
        type=positive,
        default=1,
        metavar="N",
        help="number of cases measured side by side, on one thread each (default 1)",
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"measured": how much, "settings": learn.experiments.pareto_front.summary}."""
    from learn.experiments import chart_cases, chart_measurement, pareto_front
    from manifests import materials as catalogue

    names = arguments.material or chart_cases.MATERIALS
    lights, size = chart_cases.lights(arguments.lights, arguments.light), arguments.size
    if arguments.quick:
        names, lights, size = names[::3], dict(list(lights.items())[:2]), min(size, 64)
    labels = {name: catalogue.find(name).label for name in names}
    rows = chart_measurement.measured(labels, lights, arguments.camera, size, arguments.processes)
    _write_cases(arguments.out / "cases.csv", rows)
    measured: dict[str, Any] = {
        f"{name}s": len({row[name] for row in rows})
        for name in ("method", "material", "light", "camera")
    }
    measured["pixels"] = max(row["pixels"] for row in rows)
    return {"measured": measured, "settings": pareto_front.summary(rows)}


def _write_cases(path: Path, rows: list[dict[str, Any]]) -> None:
    import csv
    import io

    from manifests import files

    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows(
        {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows
    )
    files.write_text(path, text.getvalue())


def tables(report: runner.Report) -> str:
    """Return times and errors of all settings, and the fastest setting for each error."""
    from learn.experiments import chart_drawing

    return chart_drawing.page(report)


def figure(report: runner.Report) -> Figure:
    """Return time against error, with a line per method."""
    from learn.experiments import chart_drawing

    return chart_drawing.chart(report)
