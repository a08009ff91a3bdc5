"""The agreement as a page and as text: index.html with its pictures inside, report.md."""

import base64
import html
import io

import numpy as np
from PIL import Image

from learn.agreement.plots import NAMES
from learn.agreement.summary import FIGURES

TITLES = {
    "pictures": "pictures",
    "l2": "L2",
    "noise": "noise",
    "net": "L2 − noise",
    "like_net": "inside, like for like",
    "ssim": "SSIM",
    "signed": "signed %",
    "absolute": "absolute %",
    "sum_signed": "sum: signed %",
    "sum_net": "sum: L2 − noise",
    "node_fit": "node fit L2",
}
PERCENT = ("signed", "absolute", "sum_signed")
DIFFERENCE_GAIN = 4.0  # display steps are shown this many times larger, around grey
STYLE = """
:root{color-scheme:light dark;--ink:#1f2933;--soft:#5b6b79;--line:#dfe5ea;--back:#fbfcfd;--card:#fff;--good:#2e7d4f;--bad:#b3402a}
@media(prefers-color-scheme:dark){
:root{--ink:#e6ebef;--soft:#98a7b3;--line:#33414c;--back:#141a1f;--card:#1b232a;--good:#7ccf9c;--bad:#ee9079}}
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--back);max-width:1080px;margin:0 auto;padding:2rem 1.2rem}
h1{font-size:1.6rem;margin:0}
h2{font-size:1.1rem;margin:2.2rem 0 .6rem}
p{max-width:70ch}
.soft{color:var(--soft)}
.cards{display:flex;flex-wrap:wrap;gap:.8rem;margin:1.2rem 0}
.card{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:.8rem 1.1rem;min-width:9rem}
.card b{display:block;font-size:1.5rem;font-variant-numeric:tabular-nums}
.good b{color:var(--good)}
.bad b{color:var(--bad)}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:.86rem;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .7rem;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th:first-child,td:first-child{text-align:left}
th{color:var(--soft);font-weight:600}
.plots,.panels{display:grid;grid-template-columns:repeat(auto-fit,minmax(300px,1fr));gap:1rem}
figure{margin:0;background:var(--card);border:1px solid var(--line);border-radius:10px;padding:.7rem}
.plots img{width:100%;background:#fff;border-radius:6px}
.triple{display:grid;grid-template-columns:repeat(3,1fr);gap:.4rem}
.triple img{width:100%;image-rendering:pixelated;border-radius:4px}
figcaption{font-size:.82rem;color:var(--soft);margin-top:.4rem}
details{margin:.6rem 0}
summary{cursor:pointer;font-weight:600}
"""


def png(display):
    """An <img> source of display values (H, W, 3) in [0, 255]."""
    buffer = io.BytesIO()
    Image.fromarray(np.clip(np.rint(display), 0, 255).astype(np.uint8)).save(buffer, "PNG")
    return encoded(buffer.getvalue())


def number(figure, value):
    """A figure as text: fractions as per cent, others with three digits."""
    if value is None:
        return "–"
    if figure in PERCENT:
        return f"{100 * value:+.2f}" if figure != "absolute" else f"{100 * value:.2f}"
    return str(value) if isinstance(value, int) else f"{value:.3g}"


def table_rows(table):
    """Header and rows of text for a breakdown {value: figures}."""
    columns = [f for f in TITLES if f == "pictures" or f in FIGURES]
    return [TITLES[c] for c in columns], [
        (value, [number(c, cell[c]) for c in columns]) for value, cell in table.items()
    ]


def verdict(head):
    """The headline in sentences."""
    if not head["conditions"]:
        return (
            "No picture of the direct tier under the 64×128 map: what the layer models was not"
            " rendered. Render with tiers direct."
        )
    if head["like_net"] is None:
        return (
            "The direct tier has no second seed: its noise is unknown, and the limit cannot be"
            " judged. Render with repeats = 2."
        )
    fit, whose = (
        (head["node_fit"], "in the catalogue")
        if head["node_fit"] is not None
        else (head["node_fit_measured"], "measured here")
    )
    judged = "within" if head["holds"] else "beyond"
    return (
        "Direct tier, inside the silhouette, both renderers over the same part of each pixel:"
        f" display L2 net of noise {head['like_net']:.3g}; the materials' own node fit {whose} is"
        f" {fit:.3g}: {judged} the limit of {head['limit']:g} times. Over the whole mask, with"
        f" {100 * head['edge_share']:.0f} % of it on edges, the integral stands at"
        f" {head['net']:.3g} and the paper's texel sum at {head['sum_net']:.3g}."
    )


def markdown(summary, about):
    """report.md."""
    lines = [
        "# Agreement of Cycles and the layer",
        "",
        *(f"- {key}: {value}" for key, value in about.items()),
        "",
        verdict(summary["direct"]),
        "",
    ]
    result = summary["causes"]
    lines += ["## Causes in the direct tier (display L2)", "", "| cause | L2 |", "|---|---|"]
    lines += [f"| {NAMES[key]} | {number(key, result.get(key))} |" for key in NAMES]
    if result["look_up_texels"]:
        shift = result["look_up_texels"]
        lines += [
            "",
            (
                f"The light's turn that explains most: median {shift['median']:+.3f} texels,"
                f" largest {shift['largest']:.3f}."
            ),
        ]
    lines += [
        "",
        "## By grazing angle",
        "",
        "| degrees | pixels | L2 | signed % |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {b['from_deg']}–{b['to_deg']} | {b['pixels']} | {number('l2', b['l2'])} |"
        f" {number('signed', b['signed'])} |"
        for b in summary["grazing"]
    ]
    for name, table in summary["breakdowns"].items():
        header, rows = table_rows(table)
        lines += [
            "",
            f"## By {name}",
            "",
            f"| {name} | {' | '.join(header)} |",
            "|---" * (len(header) + 1) + "|",
        ]
        lines += [f"| {value} | {' | '.join(cells)} |" for value, cells in rows]
    return "\n".join(lines) + "\n"


def web(summary, about, plots, panels):
    """index.html.

    plots   [(PNG's bytes, caption)]; panels  list of (caption, Cycles' display picture, the
    layer's)
    """
    head = summary["direct"]
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport"
        f" content='width=device-width'><title>Agreement</title><style>{STYLE}</style>"
    ]
    parts += [
        "<h1>Cycles and the layer, side by side</h1>",
        f"<p class=soft>{' · '.join(html.escape(str(v)) for v in about.values())}</p>",
    ]
    parts += [f"<p>{html.escape(verdict(head))}</p>", cards(summary)]
    parts += [
        "<h2>Why they differ</h2><p class=soft>Each cause is measured on its own, in the direct"
        " tier. Texel sum is what the paper's point sum over the map costs; it is no part of the"
        " converged integral's disagreement.</p><div class=plots>"
    ]
    parts += [
        f"<figure><img src='{encoded(png)}'"
        f" alt=''><figcaption>{html.escape(caption)}</figcaption></figure>"
        for png, caption in plots
    ]
    parts += [
        "</div><h2>Pictures, the worst first</h2><p class=soft>Cycles, the layer, and their"
        f" difference times {DIFFERENCE_GAIN:g} around grey.</p><div class=panels>"
    ]
    for caption, cycles, layer in panels:
        images = (cycles, layer, 128 + DIFFERENCE_GAIN * (layer - cycles))
        row = "".join(f"<img src='{png(image)}' alt=''>" for image in images)
        parts.append(
            "<figure><div"
            f" class=triple>{row}</div><figcaption>{html.escape(caption)}</figcaption></figure>"
        )
    parts.append("</div>")
    for name, table in summary["breakdowns"].items():
        header, rows = table_rows(table)
        top = "".join(f"<th>{h}</th>" for h in (html.escape(name), *header))
        body = "".join(
            f"<tr><td>{html.escape(value)}</td>{''.join(f'<td>{c}</td>' for c in cells)}</tr>"
            for value, cells in rows
        )
        opened = " open" if len(rows) <= 8 else ""
        parts.append(
            f"<details{opened}><summary>By {html.escape(name)}</summary><div class=scroll>"
        )
        parts.append(f"<table><tr>{top}</tr>{body}</table></div></details>")
    return "\n".join(parts) + "</html>\n"


def cards(summary):
    head, every = summary["direct"], summary["all"]
    judged = "" if head["holds"] is None else " good" if head["holds"] else " bad"
    shown = [
        (judged, number("like_net", head["like_net"]), "direct tier inside, L2 − noise"),
        (
            "",
            number(
                "node_fit",
                head["node_fit_measured"] if head["node_fit"] is None else head["node_fit"],
            ),
            "node fit of its materials",
        ),
        ("", number("net", head["net"]), "over the whole mask"),
        ("", number("sum_net", head["sum_net"]), "the same by the paper's sum"),
        ("", number("ssim", every.get("ssim")), "SSIM, all tiers"),
        ("", str(every.get("pictures", 0)), "pictures compared"),
    ]
    return (
        "<div class=cards>"
        + "".join(f"<div class='card{c}'><b>{value}</b>{text}</div>" for c, value, text in shown)
        + "</div>"
    )


def encoded(png):
    """An <img> source of a PNG's bytes."""
    return "data:image/png;base64," + base64.b64encode(png).decode()
