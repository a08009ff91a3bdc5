"""Chart all methods of editing against their cost, from reports that other commands have made.

No command measures all of them on the same pictures. So each report is a row of charts of its own,
with its rung and its data above it: edits' error against processor seconds of an edit, where the
report has them, and against processor hours of training, which are named: --hours "Baseline 1=.52".
Reports of `learn evaluate`, and of the experiments edit-cost and mitsuba-comparison, are read. What
is measured on different pictures cannot be compared from row to row.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.experiments import runner
from learn.experiments.editing import edit_cost
from manifests.errors import InputError
from manifests.reading import read

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("evaluation", "edit-cost", "mitsuba")
MITSUBA = {  # {key of a row of mitsuba-comparison: what the chart calls it}
    "predicted": "its start, predicted",
    "held": "refined, normals held",
    "refined": "refined",
    "mitsuba": "Mitsuba 3, descent as long",
    "longer": "Mitsuba 3, descent longer",
}
AXES = {"seconds": "processor seconds of an edit", "hours": "processor hours of training"}
NOT_METHODS = ("input unchanged", "the layer alone")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the reports and the hours of training."""
    for kind, what in {
        "evaluation": "of `learn evaluate`",
        "edit-cost": "of the experiment edit-cost",
        "mitsuba": "of the experiment mitsuba-comparison",
    }.items():
        parser.add_argument(
            f"--{kind}",
            type=Path,
            metavar="FILE",
            help=f"a report.json {what}",
        )
    parser.add_argument(
        "--hours",
        nargs="*",
        type=edit_cost.hours,
        default=[],
        metavar="NAME=H",
        help="processor hours of training of the methods whose names begin so",
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"sets": [{"title", "source", "methods": [method]}]}.

    A method is {"name", "edit": [mean, low, high], "median", "seconds", "hours"}; None where a
    report has no such figure. Raises InputError without any report, for a report of another
    command, and for names in --hours that no method has.
    """
    readers = {"evaluation": _evaluation, "edit-cost": _edit_cost, "mitsuba": _mitsuba}
    sets: list[dict[str, Any]] = []
    for kind, reader in readers.items():
        path = getattr(arguments, kind.replace("-", "_"))
        if path is None:
            continue
        report = read(path, dict[str, Any])
        try:
            made = reader(report)
        except (KeyError, TypeError, IndexError):
            remedy = "name the report.json that the command wrote"
            raise InputError(path, f"a report for --{kind}", "another one", remedy) from None
        source = path.parent.name
        sets += [each | {"source": source} for each in made]
    if not sets:
        raise InputError("edit-methods", "a report", "none", f"give one: --{KINDS[0]} FILE")
    hours = dict(arguments.hours)
    methods = [method for each in sets for method in each["methods"]]
    for name in hours:
        if not any(method["name"].startswith(name) for method in methods):
            known = ", ".join(sorted({method["name"] for method in methods}))
            raise InputError("--hours", f"the beginning of a method: {known}", name, "rename it")
    for method in methods:
        matching = [name for name in hours if method["name"].startswith(name)]
        method["hours"] = hours[max(matching, key=len)] if matching else None
    return {"sets": sets}


def _evaluation(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the methods of a report of `learn evaluate`, which has no seconds."""
    about = report["about"]
    name = str(about["asked"]["weights"]).rpartition("/")[2].removesuffix(".safetensors")
    methods = [
        {
            "name": row["name"].replace("ours", name, 1),
            "edit": row["cells"]["l2"],
            "median": row["cells"]["median"],
            "seconds": None,
        }
        for row in report["tables"]["edits"]["rows"]
    ]
    _, _, side = about["data"].partition("; ")
    words = [f"{about['edits']} edits of {about['pictures']} pictures", side, *about["tiers"]]
    title = "; ".join(each for each in words if each)
    return [{"title": title, "methods": methods}]


def _edit_cost(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the methods of a report of edit-cost, a set for each rung."""
    rows = report["rows"]
    about = f"{len({row['scene'] for row in rows})} edits of"
    about += f" {len({row['shape'] for row in rows})} shapes of the ladder's development side"
    result = []
    for rung, by_method in edit_cost.summary(rows).items():
        methods = [
            {
                "name": name,
                "edit": of["edit_l2"],
                "median": of["median"],
                "seconds": None if of["seconds"] < edit_cost.LEAST_SECONDS else of["seconds"],
            }
            for name, of in by_method.items()
        ]
        result.append({"title": f"{about}, rung {rung}", "methods": methods})
    return result


def _mitsuba(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the methods of a report of mitsuba-comparison."""
    import numpy as np

    from learn.metrics import bootstrap

    rows = report["rows"]
    weights = bootstrap.draws_of_rows(rows, ("shape", "target", "light"))
    name = str(report["weights"]).removesuffix(".safetensors")
    methods = []
    for key, words in MITSUBA.items():
        edits = np.array([row[key]["edit"] for row in rows])
        seconds = float(np.mean([row[key].get("seconds") or 0.0 for row in rows]))
        methods.append(
            {
                "name": words if words.startswith("Mitsuba") else f"{name}, {words}",
                "edit": bootstrap.interval(edits, weights),
                "median": float(np.median(edits)),
                "seconds": seconds or None,
            }
        )
    title = f"{len(rows)} edits of {len(rows)} shapes of the ladder's development side, rung direct"
    return [{"title": title, "methods": methods}]


def tables(report: runner.Report) -> str:
    """Return a table for each set of pictures."""
    result = [
        "# Methods of editing and their cost\n",
        "Collected from the reports named. Display L2 of edits over the mask, means with 95 %"
        " intervals over shapes, target materials and lights. Each table has other pictures, so"
        " that figures are compared within a table alone. Seconds are of the processor for an edit,"
        " hours of the processor for the training, on one thread; – is not measured, or no"
        " training.\n",
        "![Error against seconds and hours](chart.png)\n",
    ]
    for each in report["sets"]:
        lines = [
            [
                method["name"],
                runner.interval(method["edit"], 0),
                f"{method['median']:.0f}",
                "–" if method["seconds"] is None else f"{method['seconds']:.2f}",
                "–" if method["hours"] is None else f"{method['hours']:.2g}",
            ]
            for method in each["methods"]
        ]
        head = ["method", "edit L2", "median", "seconds", "hours of training"]
        result += [
            f"## {each['title']}\n",
            f"From the report {each['source']}.\n",
            runner.table(head, lines),
        ]
    return "\n".join(result)


def figure(report: runner.Report) -> Figure:
    """Return a row of charts for each set: all methods by name, against seconds, against hours.

    Points beside the names are numbered as the names are.
    """
    from matplotlib.figure import Figure as Drawing

    sets = report["sets"]
    heights = [max(len(each["methods"]) * 0.24, 2.2) for each in sets]
    drawing = Drawing(figsize=(12.5, sum(heights) + 0.8 * len(sets)), layout="constrained")
    rows = drawing.subplots(
        len(sets), 3, squeeze=False, height_ratios=heights, width_ratios=(3, 2, 2)
    )
    for each, (left, *others) in zip(sets, rows, strict=True):
        methods = [m for m in each["methods"] if m["name"] not in NOT_METHODS]
        methods.sort(key=lambda method: method["edit"][0])
        places = [-place for place in range(len(methods))]
        mean, low, high = zip(*(m["edit"] for m in methods), strict=True)
        below = [max(m - a, 0) for m, a in zip(mean, low, strict=True)]
        above = [max(b - m, 0) for m, b in zip(mean, high, strict=True)]
        left.errorbar(mean, places, xerr=[below, above], fmt="o", ms=4, lw=1, capsize=2)
        names = [f"{m['name']}  {number}" for number, m in enumerate(methods, 1)]
        left.set_yticks(places, names, fontsize=7)
        left.set_xlabel("edit, display L2 (mean, 95 %)", fontsize=8)
        left.set_xlim(left=0)
        left.set_title(each["title"], fontsize=9, loc="left")
        for axis, (key, unit) in zip(others, AXES.items(), strict=True):
            _against(axis, methods, key, unit)
        for axis in (left, *others):
            axis.grid(alpha=0.3)
            axis.tick_params(axis="x", labelsize=7)
    return drawing


def _against(axis: Any, methods: Sequence[Mapping[str, Any]], key: str, unit: str) -> None:
    """Draw the methods that have a figure `key` against it, numbered from 1 in their order."""
    axis.set_xlabel(unit, fontsize=8)
    shown = {number: m for number, m in enumerate(methods, 1) if m[key] is not None}
    if len({round(method[key], 2) for method in shown.values()}) < 2:
        words = "the same for all" if shown else "not measured"
        axis.text(0.5, 0.5, words, ha="center", transform=axis.transAxes, fontsize=8)
        axis.set(xticks=[], yticks=[])
        return
    widest = max(method[key] for method in shown.values())
    highest = max(method["edit"][0] for method in shown.values())
    beside: dict[tuple[int, int], list[int]] = {}  # points that nearly coincide share a text
    for number, method in shown.items():
        axis.plot(method[key], method["edit"][0], "o", color="C3", ms=4)
        cell = round(20 * method[key] / widest), round(16 * method["edit"][0] / highest)
        beside.setdefault(cell, []).append(number)
    for numbers in beside.values():
        first = shown[numbers[0]]
        text = ", ".join(str(number) for number in numbers)
        place = (first[key], first["edit"][0])
        axis.annotate(text, place, xytext=(5, 2), textcoords="offset points", fontsize=7)
    axis.set(xlim=(-0.05 * widest, 1.2 * widest), ylim=(0, 1.1 * highest))
    axis.set_ylabel("edit, display L2", fontsize=8)
    axis.tick_params(axis="y", labelsize=7)
