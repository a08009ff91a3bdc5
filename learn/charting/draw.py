"""The work–precision chart as PNG, CSV and HTML, each with command, commit, machine and date on it."""

import csv
import html
import io
import statistics
from collections import defaultdict

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2rem auto;padding:0 1rem}td,th{padding:.1rem .6rem;text-align:right}"
)
STYLE += "td:first-child,th:first-child{text-align:left}img{max-width:100%}"


def write(rows, made, folder):
    """chart.png, chart.csv, chart.html in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    caption = f"{made['command']} · commit {made['commit']} · {made['date']} · {made['machine']}"
    picture(rows, caption).savefig(folder / "chart.png", dpi=110)
    text = io.StringIO()
    text.write(f"# {caption}\n")
    table = csv.DictWriter(text, fieldnames=list(rows[0]))
    table.writeheader()
    table.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    (folder / "chart.csv").write_text(text.getvalue())
    (folder / "chart.html").write_text(page(rows, caption))


def middle(values):
    """Median, held above 1e-9 for the logarithmic axis."""
    return max(statistics.median(values), 1e-9)


def points(rows, truth):
    """{(camera, method): [(seconds, error, knob)]}: medians over materials and lights."""
    grouped = defaultdict(list)
    for row in rows:
        grouped[row["camera"], row["method"], row["knob"]].append(row)
    found = defaultdict(list)
    for (camera, method, knob), same in grouped.items():
        found[camera, method].append((middle([r["seconds"] for r in same]), middle([r[truth] for r in same]), knob))
    return found


def picture(rows, caption):
    import matplotlib
    from matplotlib.figure import Figure

    cameras = list(dict.fromkeys(row["camera"] for row in rows))
    names = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(figsize=(15, 6.5 * len(cameras)), layout="constrained")
    figure.suptitle(caption, fontsize=9)
    axes = figure.subplots(len(cameras), 2, squeeze=False)
    colours = matplotlib.colormaps["tab20"].colors
    for line, camera in zip(axes, cameras, strict=True):
        for place, truth in zip(line, ("error", "integral"), strict=True):
            for (seen, method), found in points(rows, truth).items():
                if seen == camera:
                    x, y, _ = zip(*sorted(found), strict=True)
                    style = {"lw": 3, "ms": 9} if method == "auto" else {"lw": 1, "ms": 5}
                    place.loglog(x, y, "o-", color=colours[names.index(method) % 20], label=method, **style)
            against = "the paper's sum" if truth == "error" else "the converged integral"
            place.set(title=f"{camera}, against {against}", xlabel="CPU seconds, forward + backward, one thread", ylabel="relative error")
            place.grid(alpha=0.3, which="both")
            place.legend(fontsize=7)
    return figure


def page(rows, caption):
    parts = [f"<!doctype html><meta charset=utf-8><title>Work and precision</title><style>{STYLE}</style><h1>Work and precision</h1>"]
    parts.append(f"<p>{html.escape(caption)}</p><img src=chart.png alt='time against error, a line a method'>")
    parts.append("<p>Medians over materials and lights. Each case is in chart.csv.</p>")
    for camera in dict.fromkeys(row["camera"] for row in rows):
        paper, integral = points(rows, "error"), points(rows, "integral")
        parts.append(f"<h2>{camera}</h2><table><tr><th>method</th><th>knob</th><th>ms</th><th>error: sum</th><th>error: integral</th></tr>")
        for (seen, method), found in paper.items():
            for (seconds, error, knob), (_, other, _) in zip(found, integral[seen, method], strict=True):
                if seen == camera:
                    parts.append(f"<tr><td>{method}<td>{knob}<td>{seconds * 1e3:.1f}<td>{error:.1e}<td>{other:.1e}</tr>")
        parts.append("</table>")
    return "\n".join(parts)
