"""Which setting reaches an error in the least time, over all cases at once: the Pareto front.

A setting (method and knob) is chosen before the case is known, so that it is judged by all of its
cases: by the median of its errors or the worst of them, and by its median, 90th-percentile or worst
time. An error is relative, as in learn.experiments.layer.chart_measurement.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

LEVELS = (5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
OURS = "auto"
CLOCKS, ERRORS = ("seconds", "forward"), ("error", "integral", "forward_error")
JUDGES: dict[str, Callable[[list[float]], float]] = {"median": statistics.median, "worst": max}
TIMES: dict[str, Callable[[list[float]], float]] = JUDGES | {
    "90th percentile": lambda values: float(np.quantile(values, 0.9))
}
# the judges of errors and of times that go together: a typical case, and a limit that must hold
PAIRS = (("median", "median"), ("worst", "90th percentile"), ("worst", "worst"))


class Point(NamedTuple):
    """A setting as a point of the chart; points are ordered by time."""

    seconds: float
    error: float
    knob: str


class Front(NamedTuple):
    """The fastest setting that reaches an error; ours: seconds of OURS, None if it does not."""

    method: str
    seconds: float
    ours: float | None


def summary(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a dictionary per camera and setting, with its judged times and errors over all cases.

    rows     of learn.experiments.layer.chart_measurement, one per case and setting
    Returns  [{"camera", "method", "knob", clock: {judge: value}, error: {judge: value}}]
    """
    grouped = defaultdict(list)
    for row in rows:
        grouped[row["camera"], row["method"], row["knob"]].append(row)
    return [
        {"camera": camera, "method": method, "knob": knob}
        | {
            figure: {name: judge([row[figure] for row in same]) for name, judge in judges.items()}
            for figures, judges in ((CLOCKS, TIMES), (ERRORS, JUDGES))
            for figure in figures
        }
        for (camera, method, knob), same in grouped.items()
    ]


def points(
    settings: Sequence[Mapping[str, Any]],
    camera: str,
    error: str,
    judge: str,
    clock: str = "seconds",
    time: str = "median",
) -> dict[str, list[Point]]:
    """Return {method: its points} of a camera; settings are those of `summary`.

    judge, time  of JUDGES and TIMES: which of a setting's errors and times counts
    """
    result = defaultdict(list)
    for row in settings:
        if row["camera"] == camera:
            result[row["method"]].append(Point(row[clock][time], row[error][judge], row["knob"]))
    return dict(result)


def cheapest(of_methods: Mapping[str, Sequence[Point]], level: float) -> dict[str, Point]:
    """Return {method: its fastest point} whose error is at most `level`."""
    best = {
        method: min((p for p in of_method if p.error <= level), default=None)
        for method, of_method in of_methods.items()
    }
    return {method: point for method, point in best.items() if point}


def front(
    settings: Sequence[Mapping[str, Any]],
    camera: str,
    error: str,
    judge: str,
    clock: str = "seconds",
    time: str = "median",
) -> dict[float, Front]:
    """Return {level: fastest setting} of those LEVELS that any setting reaches."""
    of_methods, result = points(settings, camera, error, judge, clock, time), {}
    for level in LEVELS:
        if best := cheapest(of_methods, level):
            method = min(best, key=lambda name: best[name])
            ours = best[OURS].seconds if OURS in best else None
            result[level] = Front(method, best[method].seconds, ours)
    return result
