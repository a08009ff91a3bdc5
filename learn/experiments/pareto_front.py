"""Which setting reaches an error in the least time, over all cases at once: the Pareto front, and
who is on it.

A setting (method, knob) is chosen before the case is known, so it is judged by all of its cases: by
its median time, and by the median of its errors or by the worst of them. An error is relative, as
in learn.experiments.chart_measurement.
"""

import statistics
from collections import defaultdict

LEVELS = (5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
OURS = "auto"


def points(rows, camera, error, judge, clock="seconds"):
    """{method: [(seconds, error, knob)]} of a camera: median time; judge(errors), statistics.median
    or max.
    """
    grouped = defaultdict(list)
    for row in rows:
        if row["camera"] == camera:
            grouped[row["method"], row["knob"]].append(row)
    result = defaultdict(list)
    for (method, knob), same in grouped.items():
        result[method].append(
            (statistics.median(r[clock] for r in same), judge([r[error] for r in same]), knob)
        )
    return dict(result)


def cheapest(found, level):
    """{method: (seconds, error, knob)}: each method's fastest setting whose error is at most
    `level`.
    """
    best = {
        method: min((p for p in settings if p[1] <= level), default=None)
        for method, settings in found.items()
    }
    return {method: point for method, point in best.items() if point}


def front(rows, camera, error, judge, clock="seconds"):
    """[(level, fastest method, its seconds, seconds of OURS or None)] of LEVELS that any setting
    reaches.
    """
    result, lines = points(rows, camera, error, judge, clock), []
    for level in LEVELS:
        best = cheapest(result, level)
        if best:
            method = min(best, key=best.get)
            lines.append((level, method, best[method][0], best[OURS][0] if OURS in best else None))
    return lines
