"""Chart the errors of edits from several reports, beside unedited pictures and other methods.

The upper chart has a row for each kind of picture, with two errors against the true edit: that of
the unedited picture and that of the edit. --photographs names reports of the experiments
room-photographs and photographed-edits, --ladder those of `learn ladder`, and --evaluation those of
`learn evaluate`; the words before = name the row. Its rows have different pictures and cannot be
compared with each other. The lower chart compares several methods on the same edits (--methods).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.experiments import runner
from manifests.errors import InputError
from manifests.reading import read

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# {row of a report of `learn evaluate`: what the chart calls it}
METHODS = {
    "input unchanged": "not edited",
    "Baseline 1": "Baseline 1 of the paper",
    "Baseline 2, refined": "Baseline 2 of the paper, refined",
    "Lombardi-like, true normals": "optimisation alone, given the true normals",
    "ours, refined": "this program",
}
LADDER_ROW = "outside meshes: 8-bit"  # what is hardest for the program, as a camera stores it
TICKS = (250, 500, 1000, 2000, 4000, 8000)
STATES = {"before": ("not edited", "#9a9a9a"), "after": ("edited", "#0b5fa5")}  # words, colour


def named_report(text: str) -> tuple[str, Path]:
    """Parse WORDS=FILE. Raises argparse.ArgumentTypeError."""
    words, equals, path = text.partition("=")
    if not (words and equals and path):
        raise argparse.ArgumentTypeError(f"expected WORDS=FILE, found {text}")
    return words, Path(path)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that take reports, with the words that name them in the chart."""
    for name, what in {
        "--photographs": "reports of room-photographs and photographed-edits",
        "--ladder": f"reports of `learn ladder`, of whose rows {LADDER_ROW} is shown",
        "--evaluation": "reports of `learn evaluate`",
        "--methods": "reports of `learn evaluate` on the same pictures, whose methods are compared;"
        " a later one replaces the baselines of an earlier one",
    }.items():
        parser.add_argument(
            name,
            nargs="+",
            type=named_report,
            default=[],
            metavar="WORDS=FILE",
            help=what,
        )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"pictures": [{"name", "source", "before", "after"}], "methods": {"name", "rows"}}.

    "before" and "after" are [mean, low, high] of display L2, unedited and edited; "before" is None
    for ladders. "methods" has as its "name" the words of the first report, and as its "rows"
    [{"name", "source", "edit": [mean, low, high]}], the worst first; it is None without --methods.

    Raises  InputError without any report, and for a report of another command
    """
    pictures = [
        {"name": words, "source": path.parent.name} | _read(path, reader)
        for reader, reports in (
            (_photographs, arguments.photographs),
            (_ladder, arguments.ladder),
            (_evaluation, arguments.evaluation),
        )
        for words, path in reports
    ]
    methods: dict[str, dict[str, Any]] = {}
    for _, path in arguments.methods:
        for name, l2 in _read(path, _rows).items():
            if name in METHODS and (name not in methods or name.startswith("Baseline")):
                methods[name] = {"name": METHODS[name], "source": path.parent.name, "edit": l2}
    if not pictures and not methods:
        raise InputError("edit-summary", "a report", "none", "give one: --photographs WORDS=FILE")
    rows = sorted(methods.values(), key=lambda row: -row["edit"][0])
    compared = {"name": arguments.methods[0][0], "rows": rows} if rows else None
    return {"pictures": pictures, "methods": compared}


def _read(path: Path, reader: Callable[[Mapping[str, Any]], dict[str, Any]]) -> dict[str, Any]:
    try:
        return reader(read(path, dict[str, Any]))
    except (KeyError, TypeError, IndexError):
        remedy = "name the report.json of a command that --help names"
        raise InputError(path, "a report of that command", "another one", remedy) from None


def _photographs(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return "before" and "after" of a report of room-photographs or photographed-edits."""
    from learn.experiments.photographs import photographed_fit
    from learn.metrics import bootstrap

    edits = photographed_fit.edits_of(dict(report))
    weights = photographed_fit.weights_of(edits)
    after = edits.error(photographed_fit.in_use(edits))
    return {
        "before": bootstrap.interval(edits.unchanged, weights),
        "after": bootstrap.interval(after, weights),
    }


def _ladder(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return "before", None, and "after" of a report of `learn ladder`."""
    rows = {row["name"]: row["cells"] for row in report["tables"]["ladder"]["rows"]}
    return {"before": None, "after": rows[LADDER_ROW]["edit"]}


def _evaluation(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return "before" and "after" of a report of `learn evaluate`."""
    rows = _rows(report)
    return {"before": rows["input unchanged"], "after": rows["ours, refined"]}


def _rows(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return {method: [mean, low, high] of display L2} of a report of `learn evaluate`."""
    return {row["name"]: row["cells"]["l2"] for row in report["tables"]["edits"]["rows"]}


def tables(report: runner.Report) -> str:
    """Return a table of the pictures and one of the methods."""
    result = [
        "# How good edits are, at a glance\n",
        "Collected from the reports named. Display L2 over the object between an edit and its"
        " truth, means with 95 % intervals. Each row of the first table has its own pictures, so"
        " that rows cannot be compared; those of the second table have the same pictures.\n",
        "![Errors before and after an edit, and of other methods](chart.png)\n",
    ]
    lines = [
        [
            row["name"],
            *("–" if row[key] is None else runner.interval(row[key], 0) for key in STATES),
            row["source"],
        ]
        for row in report["pictures"]
    ]
    if lines:
        result.append(runner.table(["pictures", "not edited", "edited", "report"], lines))
    if report["methods"]:
        lines = [
            [row["name"], runner.interval(row["edit"], 0), row["source"]]
            for row in report["methods"]["rows"]
        ]
        result += [
            f"## {report['methods']['name']}\n",
            runner.table(["method", "edits", "report"], lines),
        ]
    return "\n".join(result)


def figure(report: runner.Report) -> Figure:
    """Return the chart of the pictures above that of the methods, on one logarithmic axis."""
    from matplotlib.figure import Figure as Drawing

    charts: list[tuple[str, dict[str, dict[str, Any]]]] = []
    if report["pictures"]:
        values = {key: {row["name"]: row[key] for row in report["pictures"]} for key in STATES}
        charts.append(("Each row has its own pictures", values))
    if report["methods"]:
        rows = report["methods"]["rows"]
        values = {"before": {}, "after": {}}
        for row in rows:
            values["before" if row["name"] == STATES["before"][0] else "after"][row["name"]] = row[
                "edit"
            ]
        charts.append((report["methods"]["name"], values))
    heights = [len({name for each in values.values() for name in each}) for _, values in charts]
    size = (9, 0.36 * sum(heights) + 0.6 * len(heights) + 0.5)
    drawing = Drawing(figsize=size, layout="constrained")
    axes = drawing.subplots(len(charts), 1, sharex=True, squeeze=False, height_ratios=heights)
    for axis, (title, values) in zip(axes[:, 0], charts, strict=True):
        _draw(axis, values)
        axis.set_title(title, fontsize=9, loc="left")
    axes[0, 0].legend(fontsize=9, loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
    bottom = axes[-1, 0]
    bottom.set_xscale("log")
    bottom.set_xticks(TICKS, [f"{tick:,}" for tick in TICKS])
    bottom.minorticks_off()
    bottom.set_xlabel("distance from the true edit: display L2, mean and 95 % interval", fontsize=9)
    return drawing


def _draw(axis: Axes, values: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw {key of STATES: {name: [mean, low, high], or None}}, the first name on top."""
    names = list(dict.fromkeys(name for each in values.values() for name in each))
    for key, each in values.items():
        words, colour = STATES[key]
        label: str | None = words
        for name, interval in each.items():
            if interval is None:
                continue
            mean, low, high = interval
            y = -names.index(name)
            axis.plot([low, high], [y, y], "|-", color=colour, lw=1.5, ms=7)
            axis.plot(mean, y, "o", color=colour, ms=6, label=label)
            label = None  # one entry of the legend
            axis.annotate(
                f"{mean:,.0f}",
                (mean, y),
                xytext=(0, 5),
                textcoords="offset points",
                ha="center",
                fontsize=8,
                color=colour,
            )
    axis.set_yticks([-place for place in range(len(names))], names, fontsize=9)
    axis.set_ylim(-len(names) + 0.4, 0.7)
    axis.grid(axis="x", alpha=0.3)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
