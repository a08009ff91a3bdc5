"""The work-precision chart and its tables, of a report by work_precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from learn.experiments import pareto_front, runner

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANELS = (
    ("error", "median", "against the paper's sum, median case"),
    ("error", "worst", "against the paper's sum, worst case"),
    ("integral", "median", "against the converged integral, median case"),
)
NOTE = (
    "A setting's time is the median over all materials and lights, of one thread, forward and"
    " backward; its error is the median of all cases, or the worst of them."
)
ON_FRONT = (
    "For each error: the setting of least time that keeps it over all cases, and the time of"
    " auto's. Bold where auto is the fastest or within a tenth of it. The median forgives a setting"
    " that fails for up to half of the cases; the worst case forgives nothing."
)


def cameras(report: runner.Report) -> list[str]:
    """Return the cameras of a report, in its order."""
    return list(dict.fromkeys(row["camera"] for row in report["settings"]))


def chart(report: runner.Report) -> Figure:
    """Return time against error, a row of panels per camera and a line per method."""
    import matplotlib
    from matplotlib.figure import Figure

    settings = report["settings"]
    names = list(dict.fromkeys(row["method"] for row in settings))
    figure = Figure(figsize=(21, 6.5 * len(cameras(report))), layout="constrained")
    axes = figure.subplots(len(cameras(report)), len(PANELS), squeeze=False)
    colours = matplotlib.colormaps["tab20"].colors  # type: ignore[attr-defined]  # of this map
    for line, camera in zip(axes, cameras(report), strict=True):
        for place, (error, judge, title) in zip(line, PANELS, strict=True):
            for method, points in pareto_front.points(settings, camera, error, judge).items():
                ordered = sorted(points)
                style = {"lw": 3, "ms": 9} if method == pareto_front.OURS else {"lw": 1, "ms": 5}
                place.loglog(
                    [point.seconds for point in ordered],
                    [max(point.error, 1e-8) for point in ordered],  # for the logarithmic axis
                    "o-",
                    color=colours[names.index(method) % 20],
                    label=method,
                    **style,
                )
            place.set(
                title=f"{camera}, {title}",
                xlabel="CPU seconds, forward + backward, one thread",
                ylabel="relative error",
            )
            place.axhspan(1e-5, 5e-2, color="0.95", zorder=0)
            place.grid(alpha=0.3, which="both")
            place.legend(fontsize=7)
    return figure


def page(report: runner.Report) -> str:
    """Return the tables of all settings and of the fronts in Markdown."""
    measured = ", ".join(f"{count} {name}" for name, count in report["measured"].items())
    parts = ["# Work and precision", "", f"{NOTE} {measured}.", ""]
    for camera in cameras(report):
        parts += [f"## {camera}", "", settings_table(report["settings"], camera)]
        parts += ["### The fastest setting for each error", "", ON_FRONT, ""]
        for clock, error, task in (
            ("seconds", "error", "Forward and backward"),
            ("forward", "forward_error", "Forward alone"),
        ):
            parts += [f"{task}:", "", fronts(report["settings"], camera, error, clock)]
    return "\n".join(parts)


def settings_table(settings: list[dict[str, Any]], camera: str) -> str:
    """Return every setting's times and errors."""
    head = ["method", "knob", "ms forward", "ms with backward", "sum: median", "worst"]
    rows = [
        [
            row["method"],
            row["knob"],
            f"{1e3 * row['forward']:.1f}",
            f"{1e3 * row['seconds']:.1f}",
            *(
                f"{row[error][judge]:.1e}"
                for error in ("error", "integral")
                for judge in pareto_front.JUDGES
            ),
        ]
        for row in settings
        if row["camera"] == camera
    ]
    return runner.table([*head, "integral: median", "worst"], rows)


def fronts(settings: list[dict[str, Any]], camera: str, error: str, clock: str) -> str:
    """Return the fastest setting and ours at each error, by the median and by the worst case."""
    judged = [
        pareto_front.front(settings, camera, error, judge, clock) for judge in pareto_front.JUDGES
    ]
    head = ["error", "median: fastest", "ms", "auto, ms", "worst: fastest", "ms", "auto, ms"]
    rows = [
        [f"{level:g}", *(cell for lines in judged for cell in _cells(lines.get(level)))]
        for level in pareto_front.LEVELS
    ]
    return runner.table(head, rows)


def _cells(line: pareto_front.Front | None) -> list[str]:
    if line is None:
        return ["none", "–", "–"]
    own = "–" if line.ours is None else f"{line.ours * 1e3:.1f}"
    if line.ours is not None and line.ours <= 1.1 * line.seconds:
        own = f"**{own}**"
    return [line.method, f"{line.seconds * 1e3:.1f}", own]
