"""Time every rendering method against the error that it makes: a work-precision chart.

A sphere in materials from matte to mirror under several lights, from far and from near, is rendered
by every method at several settings, and by three rivals: the sum in plain torch, as it is and
compiled by torch.compile, and Mitsuba 3 (--mitsuba). Times are of one thread, forward and backward.
A setting's time is the median over all materials and lights, their 90th percentile or the worst;
its error is the median over all cases, or the worst of them. cases.csv has each single case;
cases.jsonl keeps them, so that the same command continues.

Fewer settings, every third of the materials and the first of the lights are measured on shapes with
few distinct normals, a cube and a cylinder, and on a sphere in a picture of 256².

--renew measures some methods again and keeps the other rows of an earlier report, which must be of
the same materials, lights, cameras and sizes. The new report says which rows are whose.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = (  # those of chart_cases.settings, which needs torch to be imported
    "exact", "culled", "reflectance_map", "median_cut", "hybrid", "quadrature",
    "spherical_harmonics", "split_sum", "spherical_gaussians", "monte_carlo", "monte_carlo_light",
    "monte_carlo_brdf", "auto",
)  # fmt: skip
CAMERAS = ("orthographic", "perspective")
FURTHER = ("cube", "cylinder", "large sphere")
LARGE = 256  # pixels of the large sphere's side


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the materials, lights and cameras, the size of pictures, and the rivals."""
    parser.add_argument(
        "--quick",
        action="store_true",
        help="three materials, two lights and pictures of 64² at most: two minutes",
    )
    options.add_size(parser, 96)
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
        "--further",
        nargs="*",
        choices=FURTHER,
        default=FURTHER,
        help="further shapes and sizes (default: all; without a name: none)",
    )
    parser.add_argument(
        "--no-torch",
        action="store_true",
        help="leave plain torch out, whose compilation takes a minute",
    )
    parser.add_argument(
        "--renew",
        type=Path,
        metavar="FILE",
        help="a report.json, of which only the rows of --method are measured again",
    )
    parser.add_argument(
        "--method",
        nargs="+",
        choices=METHODS,
        metavar="NAME",
        help=f"with --renew: of {', '.join(METHODS)}",
    )
    parser.add_argument(
        "--mitsuba",
        action="store_true",
        help="measure Mitsuba 3 too; needs the extra `witness`, and DRJIT_LIBLLVM_PATH",
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"measured": how much, "settings": pareto_front.summary, "further": {scene: same}}."""
    from learn.experiments.layer import chart_cases, chart_measurement, mitsuba_rival, pareto_front
    from manifests import materials as catalogue
    from manifests.errors import InputError

    earlier = _earlier(arguments)
    if arguments.mitsuba and not mitsuba_rival.is_installed():
        raise InputError("--mitsuba", "the package mitsuba", "none", "pip install .[witness]")
    names = arguments.material or chart_cases.MATERIALS
    lights, size = chart_cases.lights(arguments.lights, arguments.light), arguments.size
    further = [name for name in FURTHER if name in arguments.further]
    if arguments.quick:
        names, lights, size = names[::3], dict(list(lights.items())[:2]), min(size, 64)
        further = []
    labels = {name: catalogue.find(name).label for name in names}
    cases = [
        chart_measurement.Case(m, label, L, light, camera, size)
        for m, label in labels.items()
        for L, light in lights.items()
        for camera in arguments.camera
    ]
    few, one = dict(list(labels.items())[::3]), dict(list(lights.items())[:1])
    scenes = {
        name: ("sphere", LARGE) if name == "large sphere" else (name, size) for name in further
    }
    cases += [
        chart_measurement.Case(m, label, L, light, camera, side, shape, leading=True)
        for shape, side in scenes.values()
        for m, label in few.items()
        for L, light in one.items()
        for camera in arguments.camera
    ]
    rows = chart_measurement.measure_rows(
        cases,
        arguments.out,
        not arguments.no_torch and earlier is None,
        arguments.mitsuba,
        arguments.method,
    )
    _write_cases(arguments.out / "cases.csv", rows)

    def of(shape: str, side: int) -> list[dict[str, Any]]:
        return [row for row in rows if (row["shape"], row["size"]) == (shape, side)]

    main = of("sphere", size)
    measured: dict[str, Any] = {
        f"{name}s": len({row[name] for row in main})
        for name in ("method", "material", "light", "camera")
    }
    measured["pixels"] = max(row["pixels"] for row in main)
    report = {
        "measured": measured,
        "settings": pareto_front.summary(main),
        "further": {
            f"{shape}, {side}²": pareto_front.summary(of(shape, side))
            for shape, side in scenes.values()
            if (shape, side) != ("sphere", size)
        },
    }
    return report if earlier is None else renew_report(earlier, report, arguments.renew)


def _earlier(arguments: argparse.Namespace) -> runner.Report | None:
    """Return the report of --renew, or None. Raises InputError for it without --method, …"""
    from manifests.errors import InputError
    from manifests.reading import read

    if (arguments.renew is None) != (arguments.method is None):
        there, missing = ("--method", "--renew")[:: 1 if arguments.renew is None else -1]
        raise InputError(missing, f"it beside {there}", "none", "give both, or neither")
    if arguments.renew is None:
        return None
    if arguments.mitsuba:
        raise InputError("--mitsuba", "no --renew with it", "both", "leave one of them out")
    return read(arguments.renew, dict[str, Any])


def renew_report(earlier: runner.Report, new: runner.Report, where: Path) -> runner.Report:
    """Return an earlier report in which the settings of a new one take the place of its own.

    where   of the earlier report, for messages
    Raises  InputError if the two did not measure the same
    """
    from manifests.errors import InputError

    def keys(rows: list[dict[str, Any]]) -> set[tuple[str, str, str]]:
        return {(row["camera"], row["method"], row["knob"]) for row in rows}

    methods = sorted({row["method"] for row in new["settings"]})
    counts = {key: value for key, value in earlier["measured"].items() if key != "methods"}
    mine = {key: value for key, value in new["measured"].items() if key != "methods"}
    fine = counts == mine and set(earlier["further"]) == set(new["further"])
    for before, after in [
        (earlier["settings"], new["settings"]),
        *((earlier["further"].get(name, []), rows) for name, rows in new["further"].items()),
    ]:
        own = keys([row for row in before if row["method"] in methods])
        fine = fine and own == keys(after)
    if not fine:
        rule = "a report of the same materials, lights, cameras, sizes and settings"
        remedy = "give the options of the command that its last line names"
        raise InputError(where, rule, f"{earlier['measured']}", remedy)

    def merged(before: list[dict[str, Any]], after: list[dict[str, Any]]) -> list[dict[str, Any]]:
        of = {(row["camera"], row["method"], row["knob"]): row for row in after}
        return [of.get((row["camera"], row["method"], row["knob"]), row) for row in before]

    return {
        "measured": earlier["measured"],
        "settings": merged(earlier["settings"], new["settings"]),
        "further": {
            name: merged(rows, new["further"][name]) for name, rows in earlier["further"].items()
        },
        "renewed": {
            "methods": methods,
            "kept": earlier["made_by"],
            "before": [row for row in earlier["settings"] if row["method"] in methods],
        },
    }


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
    from learn.experiments.layer import chart_drawing

    return chart_drawing.page(report)


def figure(report: runner.Report) -> Figure:
    """Return panels of time against error, with a line per method."""
    from learn.experiments.layer import chart_drawing

    return chart_drawing.chart(report)
