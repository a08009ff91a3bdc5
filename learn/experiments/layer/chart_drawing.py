"""The work-precision chart and its tables, of a report by work_precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from learn.experiments import runner
from learn.experiments.layer import pareto_front

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRUTHS = {"error": "against the paper's sum", "integral": "against the converged integral"}
NOTE = (
    "Times are of one thread, forward and backward. A setting's time is the median over all"
    " materials and lights, their 90th percentile or the worst of them; its error is the median of"
    " all cases, or the worst of them."
)
RIVALS = {
    "torch": "the sum in plain torch",
    "torch.compile": "the same, compiled",
    "mitsuba": "Mitsuba 3; knob: samples per pixel",
}
ABOUT_RIVALS = (
    "`torch` and `torch.compile` are the sum in plain torch operators, their times scaled from a"
    " few pixels. `mitsuba` is Mitsuba 3's integrator `direct` on the same sphere; the knob is"
    " samples per pixel, and its derivatives are by material and light alone."
)
ON_FRONT = (
    "For each error: the setting of least time that keeps it over all cases, and the time of"
    " auto's. Bold where auto is the fastest or within a tenth of it. The median forgives a setting"
    " that fails for up to half of the cases; the worst case forgives nothing."
)
LEAST = 1e-8  # error at which a logarithmic axis shows what is exact
MARKERS = "osD^vP"


def cameras(report: runner.Report) -> list[str]:
    """Return the cameras of a report, in its order."""
    return list(dict.fromkeys(row["camera"] for row in report["settings"]))


def chart(report: runner.Report) -> Figure:
    """Return time against error, rows of panels per camera and a line per method."""
    from matplotlib.figure import Figure

    settings, further = report["settings"], report["further"]
    names = list(dict.fromkeys(row["method"] for row in settings))
    kinds = [(*pair, error) for error in TRUTHS for pair in pareto_front.PAIRS]
    rows_of_camera = 2 + (len(further) > 0)
    rows = rows_of_camera * len(cameras(report))
    figure = Figure(figsize=(18, 5 * rows + 1.2), layout="constrained")
    axes = figure.subplots(rows, len(pareto_front.PAIRS), squeeze=False)
    for number, camera in enumerate(cameras(report)):
        places = axes[rows_of_camera * number : rows_of_camera * (number + 1)].ravel()
        for place, (judge, time, error) in zip(places, kinds, strict=False):
            panel(place, settings, names, (camera, error, judge, time))
            place.set_title(f"{camera}: {judge} error {TRUTHS[error]}")
        rest = places[len(kinds) :]
        for place, (scene, same) in zip(rest, further.items(), strict=False):
            panel(place, same, names, (camera, "error", "worst", "90th percentile"))
            place.set_title(f"{camera}, {scene}: worst error {TRUTHS['error']}")
        for place in rest[len(further) :]:
            place.set_axis_off()
    handles: dict[str, Any] = {}
    for place in axes.flat:
        for handle, label in zip(*place.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    shown = [name for name in names if name in handles]
    figure.legend(
        [handles[name] for name in shown],
        [f"{name} ({RIVALS[name]})" if name in RIVALS else name for name in shown],
        loc="outside upper center",
        ncols=6,
        fontsize=12,
        title="Lower left is better. A line joins a method's settings; grey: errors from 1e-5 to"
        " 5e-2; what is exact is drawn at 1e-8.",
        title_fontsize=13,
    )
    return figure


def panel(
    place: Any, settings: list[dict[str, Any]], names: list[str], judged: tuple[str, str, str, str]
) -> None:
    """Draw time against error into one panel.

    names   of all methods, in the order of their colours
    judged  camera, and which error, by which judge of it and of times
    """
    import matplotlib

    colours = matplotlib.colormaps["tab10"].colors  # type: ignore[attr-defined]  # of this map
    camera, error, judge, time = judged
    for method, points in pareto_front.points(settings, camera, error, judge, time=time).items():
        number = names.index(method)
        colour = "black" if method == pareto_front.OURS else colours[number % 10]
        style: dict[str, Any] = {"lw": 1.3, "ms": 6}
        if method == pareto_front.OURS:
            style = {"lw": 3, "ms": 9, "zorder": 5}
        place.loglog(
            [point.seconds for point in points],
            [max(point.error, LEAST) for point in points],
            "--" if method in RIVALS else "-",
            marker=MARKERS[number // 10 + number % 3 * 2],
            color=colour,
            label=method,
            **style,
        )
    place.set(xlabel=f"processor seconds, forward + backward, {time} case", ylabel="relative error")
    place.axhspan(1e-5, 5e-2, color="0.94", zorder=0)
    place.grid(alpha=0.3, which="major")


def page(report: runner.Report) -> str:
    """Return the tables of all settings and of the fronts in Markdown."""
    measured = ", ".join(f"{count} {name}" for name, count in report["measured"].items())
    parts = ["# Work and precision", "", f"{NOTE} {measured}.", "", ABOUT_RIVALS, ""]
    if "renewed" in report:
        parts += [_about_renewed(report), ""]
    for camera in cameras(report):
        parts += [f"## {camera}", "", settings_table(report["settings"], camera)]
        parts += ["### The fastest setting for each error", "", ON_FRONT, ""]
        for clock, error, task in (
            ("seconds", "error", "Against the sum, forward and backward"),
            ("forward", "forward_error", "Against the sum, forward alone"),
            ("seconds", "integral", "Against the converged integral, forward and backward"),
        ):
            parts += [f"{task}:", "", fronts(report["settings"], camera, error, clock)]
    for scene, settings in report["further"].items():
        parts += [f"## {scene}", ""]
        for camera in cameras(report):
            parts += [f"{camera}:", "", settings_table(settings, camera)]
    return "\n".join(parts)


def _about_renewed(report: runner.Report) -> str:
    """Say which rows are of the last command, and what these settings took before."""
    renewed = report["renewed"]
    names = " and ".join(f"`{name}`" for name in renewed["methods"])
    now = {(row["camera"], row["method"], row["knob"]): row for row in report["settings"]}
    lines = []
    for before in renewed["before"]:
        key = (before["camera"], before["method"], before["knob"])
        rows = (before, now[key])
        lines.append(
            [*key]
            + [
                f"{1e3 * row['seconds'][judge]:.1f}"
                for judge in ("median", "worst")
                for row in rows
            ]
            + [f"{row['integral']['worst']:.1e}" for row in rows]
        )
    head = ["camera", "method", "knob", "median ms, earlier", "now", "worst ms, earlier", "now"]
    head += ["integral, worst, earlier", "now"]
    return (
        f"The rows of {names} are of the command in the last line; all others are kept from an"
        f" earlier run: {runner.stamp(renewed['kept'])}. What the renewed rows were then:\n\n"
        + runner.table(head, lines)
    )


def settings_table(settings: list[dict[str, Any]], camera: str) -> str:
    """Return every setting's times and errors."""
    head = ["method", "knob", "ms forward", "ms with backward", "90th percentile", "worst"]
    rows = [
        [
            row["method"],
            row["knob"],
            f"{1e3 * row['forward']['median']:.1f}",
            *(f"{1e3 * row['seconds'][time]:.1f}" for time in ("median", *head[4:])),
            *(
                f"{row[error][judge]:.1e}"
                for error in ("error", "integral")
                for judge in pareto_front.JUDGES
            ),
        ]
        for row in settings
        if row["camera"] == camera
    ]
    errors = ["sum: median", "worst", "integral: median", "worst"]
    return runner.table([*head, *errors], rows)


def fronts(settings: list[dict[str, Any]], camera: str, error: str, clock: str) -> str:
    """Return the fastest setting and ours at each error, by each of PAIRS."""
    judged = [
        pareto_front.front(settings, camera, error, judge, clock, time)
        for judge, time in pareto_front.PAIRS
    ]
    head = ["error"]
    for judge, time in pareto_front.PAIRS:
        head += [f"{judge} error, {time} time: fastest", "ms", "auto, ms"]
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
