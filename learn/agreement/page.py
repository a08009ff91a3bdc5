"""The agreement's report as a web page, index.html, and as text, report.md."""

import html
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from learn.agreement import uncertainty
from learn.agreement.plots import NAMES
from learn.agreement.summary import FIGURES, LIMIT
from learn.figures.html import encode, encode_picture, image, page, paragraph, table
from manifests.provenance import in_one_line, readable

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
# rows of the table of the whole mask
WHOLE = {
    "layer": "the layer alone",
    "facets": "facets, and normals that face away",
    "half_vectors": "half vectors that Cycles draws wrongly",
    "second_surface": "pixels that show several surfaces",
    "predicted": "the layer with all three",
    "predicted_points": "of that, away from edges",
    "predicted_low": "of that, where n·v is below 0.07, beyond the fitted views",
    "node_fit": "node fit at these pixels",
    "nodes": "the nodes' closed form: what is left",
    "nodes_points": "of that, away from edges",
    "nodes_low": "of that, where n·v is below 0.07",
}
DIFFERENCE_GAIN = 4.0  # display steps are shown this many times larger, around grey
STYLE = """
.cards{display:flex;flex-wrap:wrap;gap:.8rem;margin:1.2rem 0}
.card{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:.8rem 1.1rem;
  min-width:9rem}
.card b{display:block;font-size:1.5rem;font-variant-numeric:tabular-nums}
.plots,.panels{display:grid;grid-template-columns:repeat(auto-fit,minmax(300px,1fr));gap:1rem}
.plots img{width:100%;background:#fff;border-radius:6px}
.triple{display:grid;grid-template-columns:repeat(3,1fr);gap:.4rem}
.triple img{width:100%;image-rendering:pixelated;border-radius:4px}
figcaption{font-size:.82rem;color:var(--soft);margin-top:.4rem}
details{margin:.6rem 0}
summary{cursor:pointer;font-weight:600}
"""


def number(figure: str, value: float | None) -> str:
    """Return a figure as text: fractions as per cent, others with three digits."""
    if value is None:
        return "–"
    if figure in PERCENT:
        return f"{100 * value:+.2f}" if figure != "absolute" else f"{100 * value:.2f}"
    return str(value) if isinstance(value, int) else f"{value:.3g}"


def table_rows(
    groups: Mapping[str, Mapping[str, float | None]],
) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return the header and rows (value, cells) of a breakdown {value: figures}, as text."""
    columns = [f for f in TITLES if f == "pictures" or f in FIGURES]
    return [TITLES[c] for c in columns], [
        (value, [number(c, cell[c]) for c in columns]) for value, cell in groups.items()
    ]


def verdict(head: Mapping) -> str:
    """Return the headline in sentences."""
    if not head["conditions"]:
        return (
            "The layer models only the direct tier under the 64×128 map, and there is no such"
            " picture here. Render some: a job's tiers direct, or the option --tier direct."
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
    like = uncertainty.as_text(head["like_net"], head["like_net_error"], head["limit"] * fit)
    return (
        "Direct tier, inside the silhouette, both renderers over the same part of each pixel:"
        f" display L2 net of noise {like}; the materials' own node fit {whose} is {fit:.3g}:"
        f" {judged} the limit of {head['limit']:g} times."
        f"{uncertainty.advice(head['noise_may_decide'])} Over the whole mask, with"
        f" {100 * head['edge_share']:.0f} % of it on edges, the integral stands at"
        f" {head['net']:.3g} and the paper's texel sum at {head['sum_net']:.3g}."
    )


def whole_verdict(whole: Mapping) -> str:
    """Return the limit over the whole mask in sentences."""
    if whole["holds"] is None:
        return "The catalogue states no node fit: the limit over the whole mask cannot be judged."
    judged = "within" if whole["holds"] else "beyond"
    fit = whole["node_fit_catalogue"]
    predicted = uncertainty.as_text(whole["predicted"], whole["predicted_error"], LIMIT * fit)
    return (
        "Over the whole mask, with what Cycles does at facets and at pixels that show several"
        f" surfaces ({100 * whole['beside']:.1f} % of them): display L2 net of noise"
        f" {predicted}; the node fit in the catalogue is {fit:.3g}: {judged} the limit of"
        f" {LIMIT:g} times.{uncertainty.advice(whole['noise_may_decide'])}"
    )


def whole_rows(whole: Mapping) -> list[tuple[str, str]]:
    """Return the rows (what, L2) of the table of the whole mask."""
    predicted = uncertainty.as_text(whole["predicted"], whole["predicted_error"])
    return [
        (title, predicted if key == "predicted" else number(key, whole[key]))
        for key, title in WHOLE.items()
    ]


def markdown(summary: Mapping, about: Mapping[str, object]) -> str:
    """Return report.md."""
    lines = [
        "# Agreement of Cycles and the layer",
        "",
        *(f"- {key}: {readable(value)}" for key, value in about.items()),
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
    if whole := summary.get("whole"):
        lines += ["", "## The whole mask (display L2)", "", whole_verdict(whole), ""]
        lines += ["| | L2 |", "|---|---|"]
        lines += [f"| {title} | {value} |" for title, value in whole_rows(whole)]
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
    for name, groups in summary["breakdowns"].items():
        header, rows = table_rows(groups)
        lines += [
            "",
            f"## By {name}",
            "",
            f"| {name} | {' | '.join(header)} |",
            "|---" * (len(header) + 1) + "|",
        ]
        lines += [f"| {value} | {' | '.join(cells)} |" for value, cells in rows]
    return "\n".join(lines) + "\n"


def web(
    summary: Mapping,
    about: Mapping[str, object],
    plots: Iterable[tuple[bytes, str]],
    panels: Iterable[tuple[str, np.ndarray, np.ndarray]],
) -> str:
    """Return index.html.

    plots   (PNG's bytes, caption) of each chart
    panels  (caption, Cycles' display picture, the layer's) of each picture shown
    """
    body = [
        paragraph(in_one_line(about), "soft"),
        paragraph(verdict(summary["direct"])),
        cards(summary),
        "<h2>Why they differ</h2>",
        paragraph(
            "Each cause is measured on its own, in the direct tier. Texel sum is what the paper's"
            " point sum over the map costs; it is no part of the converged integral's"
            " disagreement.",
            "soft",
        ),
        "<div class=plots>",
        *(_figure(image(encode(png)), caption) for png, caption in plots),
        "</div>",
        *_whole(summary.get("whole")),
        "<h2>Pictures, the worst first</h2>",
        paragraph(
            f"Cycles, the layer, and their difference times {DIFFERENCE_GAIN:g} around grey.",
            "soft",
        ),
        "<div class=panels>",
        *(_panel(*panel) for panel in panels),
        "</div>",
        *(_breakdown(name, groups) for name, groups in summary["breakdowns"].items()),
    ]
    return page("Agreement", body, STYLE, heading="Cycles and the layer, side by side")


def _whole(whole: Mapping | None) -> list[str]:
    """Return the section of the whole mask as HTML."""
    if not whole:
        return []
    return [
        "<h2>The whole mask</h2>",
        paragraph(whole_verdict(whole)),
        table(["", "display L2"], [list(row) for row in whole_rows(whole)]),
    ]


def _figure(content: str, caption: str) -> str:
    return f"<figure>{content}<figcaption>{html.escape(caption)}</figcaption></figure>"


def _panel(caption: str, cycles: np.ndarray, layer: np.ndarray) -> str:
    pictures = (cycles, layer, 128 + DIFFERENCE_GAIN * (layer - cycles))
    images = "".join(image(encode_picture(picture)) for picture in pictures)
    return _figure(f"<div class=triple>{images}</div>", caption)


def _breakdown(name: str, groups: Mapping) -> str:
    header, rows = table_rows(groups)
    is_open = " open" if len(rows) <= 8 else ""
    return (
        f"<details{is_open}><summary>By {html.escape(name)}</summary>"
        + table([name, *header], [[value, *cells] for value, cells in rows])
        + "</details>"
    )


def cards(summary: Mapping) -> str:
    """Return the headline's figures as HTML."""
    head, every = summary["direct"], summary["all"]
    judged = "" if head["holds"] is None else " good" if head["holds"] else " bad"
    fit = head["node_fit_measured"] if head["node_fit"] is None else head["node_fit"]
    limit = None if fit is None else head["limit"] * fit
    like = uncertainty.as_text(head["like_net"], head["like_net_error"], limit)
    shown: Sequence[tuple[str, str, str]] = [
        (judged, like, "direct tier inside, L2 − noise"),
        ("", number("node_fit", fit), "node fit of its materials"),
        ("", number("net", head["net"]), "over the whole mask"),
        ("", number("sum_net", head["sum_net"]), "the same by the paper's sum"),
        ("", number("ssim", every.get("ssim")), "SSIM, all tiers"),
        ("", str(every.get("pictures", 0)), "pictures compared"),
    ]
    each = (f"<div class='card{kind}'><b>{value}</b>{text}</div>" for kind, value, text in shown)
    return f"<div class=cards>{''.join(each)}</div>"
