"""The work–precision chart as PNG, CSV and HTML, each with command, commit, machine and date on
it.
"""

import csv
import html
import io
import statistics
import textwrap

from learn.experiments import pareto_front
from manifests import files

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:1200px;margin:2rem auto;padding:0"
    " 1rem}td,th{padding:.1rem .6rem;text-align:right}"
)
STYLE += "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
PANELS = (
    ("error", statistics.median, "against the paper's sum, median case"),
    ("error", max, "against the paper's sum, worst case"),
    ("integral", statistics.median, "against the converged integral, median case"),
)
NOTE = (
    "A setting's time is the median over all materials and lights, of one thread, forward and"
    " backward; its error is the median of all cases, or the worst of them. Each single case is in"
    " chart.csv, the forward picture's time and error too."
)
ON_FRONT = (
    "For each error: the setting of least time that keeps it, over all cases, and the time of"
    " auto's. Bold where auto is the fastest or within a tenth of it. The median forgives a setting"
    " that fails for up to half of the cases; the worst case forgives nothing."
)


def write(rows, made, folder):
    """chart.png, chart.csv, chart.html in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    caption = (
        f"{made['command']} · commit {made['commit']} · {made['date']} · {made['machine']} ·"
        f" {size(rows)}"
    )
    text = io.StringIO()
    text.write(f"# {caption}\n")
    table = csv.DictWriter(text, fieldnames=list(rows[0]))
    table.writeheader()
    table.writerows(
        {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows
    )
    with files.transaction():
        files.write_figure(folder / "chart.png", picture(rows, caption), dpi=100)
        files.write_text(folder / "chart.csv", text.getvalue())
        files.write_text(folder / "chart.html", page(rows, caption))


def size(rows):
    """How much was measured, in words."""
    counts = {
        name: len({row[name] for row in rows}) for name in ("method", "material", "light", "camera")
    }
    return (
        ", ".join(f"{count} {name}s" for name, count in counts.items())
        + f", {max(row['pixels'] for row in rows)} pixels"
    )


def cameras(rows):
    return list(dict.fromkeys(row["camera"] for row in rows))


def picture(rows, caption):
    import matplotlib
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(figsize=(21, 6.5 * len(cameras(rows))), layout="constrained")
    figure.suptitle(textwrap.fill(caption, 250), fontsize=9)
    axes = figure.subplots(len(cameras(rows)), len(PANELS), squeeze=False)
    colours = matplotlib.colormaps["tab20"].colors
    for line, camera in zip(axes, cameras(rows), strict=True):
        for place, (error, judge, title) in zip(line, PANELS, strict=True):
            for method, result in pareto_front.points(rows, camera, error, judge).items():
                x, y, _ = zip(*sorted(result), strict=True)
                style = {"lw": 3, "ms": 9} if method == pareto_front.OURS else {"lw": 1, "ms": 5}
                height = [max(e, 1e-8) for e in y]  # for the logarithmic axis
                place.loglog(
                    x, height, "o-", color=colours[names.index(method) % 20], label=method, **style
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


def page(rows, caption):
    parts = [
        "<!doctype html><meta charset=utf-8><title>Work and"
        f" precision</title><style>{STYLE}</style><h1>Work and precision</h1>"
    ]
    parts.append(
        f"<p>{html.escape(caption)}</p><img src=chart.png alt='time against error, a line a"
        f" method'><p>{NOTE}</p>"
    )
    for camera in cameras(rows):
        parts += [
            f"<h2>{camera}</h2>",
            table(rows, camera),
            f"<h3>Who is on the front</h3><p>{ON_FRONT}</p>",
        ]
        for clock, kind, task in (
            ("seconds", "error", "Forward and backward"),
            ("forward", "forward_error", "Forward alone"),
        ):
            parts += [f"<h4>{task}</h4>", fronts(rows, camera, kind, clock)]
    return "\n".join(parts)


def table(rows, camera):
    """Every setting's times and errors."""
    forward = pareto_front.points(rows, camera, "forward_error", statistics.median, "forward")
    columns = [
        pareto_front.points(rows, camera, error, judge)
        for error in ("error", "integral")
        for judge in (statistics.median, max)
    ]
    parts = [
        "<table><tr><th>method<th>knob<th>ms forward<th>ms with backward<th>sum:"
        " median<th>worst<th>integral: median<th>worst</tr>"
    ]
    for method, settings in forward.items():
        for i, (seconds, _, knob) in enumerate(settings):
            errors = "".join(f"<td>{column[method][i][1]:.1e}" for column in columns)
            parts.append(
                f"<tr><td>{method}<td>{knob}<td>{seconds * 1e3:.1f}<td>{columns[0][method][i][0] * 1e3:.1f}{errors}</tr>"
            )
    return "\n".join([*parts, "</table>"])


def fronts(rows, camera, error, clock):
    """The fastest setting and ours at each error, by the median and by the worst case."""
    judged = [
        {line[0]: line[1:] for line in pareto_front.front(rows, camera, error, judge, clock)}
        for judge in (statistics.median, max)
    ]
    parts = [
        "<table><tr><th>error<th>median: fastest<th>ms<th>auto, ms<th>worst: fastest<th>ms<th>auto,"
        " ms</tr>"
    ]
    for level in pareto_front.LEVELS:
        cells = "".join(cell(lines.get(level)) for lines in judged)
        parts.append(f"<tr><td>{level:g}{cells}</tr>")
    return "\n".join([*parts, "</table>"])


def cell(line):
    if line is None:
        return "<td>none<td>–<td>–"
    method, seconds, ours = line
    own = (
        "–"
        if ours is None
        else f"<b>{ours * 1e3:.1f}</b>"
        if ours <= 1.1 * seconds
        else f"{ours * 1e3:.1f}"
    )
    return f"<td>{method}<td>{seconds * 1e3:.1f}<td>{own}"
