"""Tables of `painted-photographs`: the error of edits by paint and method. E: number of edits."""

from __future__ import annotations

from typing import Any

import numpy as np

from learn.experiments import runner
from learn.experiments.photographs.painted_photographs import BEFORE, IN_USE, METHODS, PREDICTED
from learn.experiments.photographs.painting import KINDS
from learn.experiments.photographs.photographed_fit import SCALES
from learn.metrics import bootstrap

FIGURES = {
    "L2": "l2",
    "L2 as bright as the truth": "as_bright",
    "brightness off by": "stops",
    "green off by": "green",
    "red over blue off by": "red_blue",
}
COMPARED = ((PREDICTED, BEFORE), (PREDICTED, IN_USE), (BEFORE, IN_USE))

Edits = dict[tuple[str, str], list[dict[str, Any]]]  # by paint and method


def edits_of(report: runner.Report) -> Edits:
    """Return {(paint, method): edits} of photographs that every method edits, in one order.

    An edit: {"shape", "light", "target", "group", "l2", "as_bright", "stops", "green", "red_blue"}
    """
    rows = {(row["paint"], row["method"], row["photograph"]): row for row in report["rows"]}
    result: Edits = {}
    for paint in KINDS:
        names = sorted({name for kind, _, name in rows if kind == paint})
        whole = [
            name
            for name in names
            if all(rows.get((paint, m, name), {"edits": []})["edits"] for m in METHODS)
        ]
        for method in METHODS:
            result[paint, method] = [
                {key: rows[paint, method, name][key] for key in ("shape", "light", "group")}
                | edit
                | {"l2": edit["l2"][SCALES.index(0.0)], "as_bright": at_truth_brightness(edit)}
                for name in whole
                for edit in rows[paint, method, name]["edits"]
            ]
    return result


def at_truth_brightness(edit: dict[str, Any]) -> float:
    """Return an edit's L2 if it were as bright as its truth, interpolated between SCALES."""
    return float(np.interp(-edit["stops"], SCALES, edit["l2"]))


def page(report: runner.Report) -> str:
    """Return the report's tables in Markdown."""
    edits = edits_of(report)
    if not any(edits.values()):
        return "# Edits of painted objects\n\nNo photograph was edited by every method.\n"
    result = ["# Edits of painted objects\n", *(f"**{sentence}**\n" for sentence in report["seen"])]
    counts = {paint: len(edits[paint, PREDICTED]) for paint in KINDS}
    refused = sum("refused" in row for row in report["rows"])
    result.append(
        f"Weights {report['weights']}; "
        + ", ".join(
            f"{count} edits of objects in {paint}" for paint, count in counts.items() if count
        ).replace("objects in as it was", "objects as they were")
        + f"; decompositions that were refused: {refused}.\n\n"
        "L2 is that of display values, in the photograph's own exposure; *as bright as the truth*:"
        " if the edit's mean luminance over the object were right. *Off by*: root mean square, in"
        " stops, of the mean over the object beyond the truth's; *green* is above the mean of red"
        " and blue. Brackets are 95 % intervals that draw shapes, target materials and lights.\n"
    )
    paints = [paint for paint in KINDS if counts[paint]]
    result += ["## By paint and method\n", _figures(edits, paints)]
    result.append("## Ratios\n\nOf means over the same edits.\n")
    result.append(_ratios(edits, paints))
    return "\n".join(result)


def _figures(edits: Edits, paints: list[str]) -> str:
    lines = []
    for paint in paints:
        weights = _weights(edits[paint, PREDICTED])
        for method in METHODS:
            line: list[object] = [paint, method]
            for key in FIGURES.values():
                values = np.array([edit[key] for edit in edits[paint, method]])
                if key in ("l2", "as_bright"):
                    line.append(runner.mean_interval(values, weights, 0))
                else:
                    line.append(f"{np.sqrt((values**2).mean()):.2f}")
            lines.append(line)
    return runner.table(["paint", "method", *FIGURES], lines)


def _ratios(edits: Edits, paints: list[str]) -> str:
    lines = []
    for paint in paints:
        weights = _weights(edits[paint, PREDICTED])
        for before, after in COMPARED:
            line: list[object] = [paint, f"{after} ÷ {before}"]
            for key in ("l2", "as_bright"):
                was, now = (
                    np.array([edit[key] for edit in edits[paint, method]])
                    for method in (before, after)
                )
                line.append(runner.ratio_interval(was, now, weights, 2))
            lines.append([*line, f"{(now < was).sum()} of {len(now)}"])
    head = ["paint", "methods", "L2", "L2 as bright as the truth", "edits better, as bright"]
    return runner.table(head, lines)


def _weights(edits: list[dict[str, Any]]) -> np.ndarray:
    return bootstrap.draws_of_rows(edits, ("shape", "target", "light"))
