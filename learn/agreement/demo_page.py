"""`python -m learn.agreement.demo_page`: one web page over what the commands left on disk: contact
sheet, agreement table, charts.

It reads report.json of `python -m learn agree` and links to pictures where they lie, so that the
page is small.
"""

import argparse
import html
import json
import os
import sys
from pathlib import Path

from manifests.errors import InputError
from manifests.files import write_text

COLUMNS = {
    "pictures": ("pictures", "{:d}"),
    "l2": ("L2", "{:.3g}"),
    "noise": ("noise", "{:.3g}"),
    "net": ("L2 − noise", "{:.3g}"),
    "like_net": ("inside", "{:.3g}"),
    "ssim": ("SSIM", "{:.4f}"),
    "signed": ("mean error", "{:+.2%}"),
    "absolute": ("absolute error", "{:.2%}"),
    "node_fit": ("node fit L2", "{:.3g}"),
}
CAUSES = {
    "edges": "edges: a pixel there is a mean over two surfaces in Cycles, one of them in the layer",
    "noise": "Cycles' noise",
    "node_fit": "label and nodes are two forms of a material",
    "footprint": "a pixel is an area in Cycles, its centre in the layer",
    "look_up": "a turn of the light against its look-up",
    "rest": "what none of these explains",
    "texel_sum": "beside them: what the paper's sum over texels would cost",
}
# breakdowns on this page; the report itself has all of them
SHOWN = ("tier and light resolution", "material", "light", "category")
STYLE = """
:root{color-scheme:light dark;--ink:#1f2933;--soft:#5b6b79;--line:#dfe5ea;--back:#fbfcfd;--card:#fff;--accent:#2f6f9f}
@media(prefers-color-scheme:dark){:root{--ink:#e6ebef;--soft:#98a7b3;--line:#33414c;--back:#141a1f;--card:#1b232a;--accent:#7db7de}}
body{font:15px/1.55 system-ui,sans-serif;color:var(--ink);background:var(--back);max-width:1180px;margin:0 auto;padding:2rem 1.2rem}
h1{font-size:1.7rem;margin:0}
h2{font-size:1.15rem;margin:2.4rem 0 .6rem}
p{max-width:72ch}
a{color:var(--accent)}
.soft{color:var(--soft)}
.scroll{overflow-x:auto}
.sheet{width:100%;background:#202428;border-radius:10px}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(330px,1fr));gap:1rem}
.charts img{width:100%;background:#fff;border:1px solid var(--line);border-radius:10px}
table{border-collapse:collapse;font-size:.88rem;font-variant-numeric:tabular-nums;margin-bottom:1.2rem}
th,td{padding:.28rem .75rem;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th:first-child,td:first-child{text-align:left}
th{color:var(--soft);font-weight:600}
"""


def read(path, command):
    """JSON of a file that `command` writes. Raises InputError if it is not there or damaged."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "a file", "none", f"run `{command}` first") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "JSON", str(error), f"run `{command}` again") from None


def table(name, groups):
    """A breakdown {value: figures} as an HTML table, with the columns that hold figures."""
    held = [key for key in COLUMNS if any(cell.get(key) is not None for cell in groups.values())]
    head = "".join(f"<th>{COLUMNS[key][0]}</th>" for key in held)
    rows = []
    for value, cell in groups.items():
        cells = "".join(
            f"<td>{'–' if cell.get(key) is None else COLUMNS[key][1].format(cell[key])}</td>"
            for key in held
        )
        rows.append(f"<tr><td>{html.escape(str(value))}</td>{cells}</tr>")
    return (
        "<div"
        f" class=scroll><table><tr><th>{html.escape(name)}</th>{head}</tr>{''.join(rows)}</table></div>"
    )


def verdict(direct):
    """The report's headline in words."""
    if direct.get("net") is None or direct.get("like_net") is None:
        return (
            "No picture was rendered with two seeds: the noise is unknown, so the direct tier"
            " cannot be judged."
        )
    report = (
        "In the direct tier, the light transport that the layer models, the two renderers'"
        " pictures differ inside silhouettes and creases by a display L2 of"
        f" {direct['like_net']:.2f} once noise is taken off (black and white differ by 65,025);"
        f" edges included, by {direct['net']:.2f}."
    )
    if direct.get("node_fit") is None:
        return (
            report
            + " The catalogue does not say how far its materials' two forms, label and nodes, are"
            " apart, so there is no limit."
        )
    kept = "within" if direct.get("holds") else "beyond"
    fit = f" The materials' two forms, label and nodes, differ by {direct['node_fit']:.2f}"
    return f"{report}{fit}; the limit inside is {direct['limit']:g} times that: {kept} it."


def causes(found):
    """The direct tier's disagreement taken apart, as an HTML table; empty where the report has no
    causes.
    """
    known = [(text, found[key]) for key, text in CAUSES.items() if found.get(key) is not None]
    rows = "".join(
        f"<tr><td>{html.escape(text)}</td><td>{value:.3g}</td></tr>" for text, value in known
    )
    return (
        "<div class=scroll><table><tr><th>cause, direct"
        f" tier</th><th>L2</th></tr>{rows}</table></div>"
        if rows
        else ""
    )


def page(out, sheets, agreement, title, predictions=(), edits=()):
    """The page's text; its links are relative to out's folder.

    sheets, predictions, edits   paths of pictures
    agreement                    folder of the report
    """
    report = read(agreement / "report.json", "python -m learn agree DIR --out DIR2")
    summary, about = report["summary"], report["about"]

    def link(path):
        return html.escape(Path(os.path.relpath(path, out.parent)).as_posix(), quote=True)

    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport"
        " content='width=device-width'>"
    ]
    parts += [
        f"<title>{html.escape(title)}</title><style>{STYLE}</style><h1>{html.escape(title)}</h1>"
    ]
    parts += [
        "<p class=soft>" + " · ".join(html.escape(str(value)) for value in about.values()) + "</p>"
    ]
    parts += [
        f"<p>{html.escape(verdict(summary['direct']))} <a"
        f" href='{link(agreement / 'index.html')}'>The whole report</a>.</p>"
    ]
    parts += ["<h2>What was rendered</h2>"]
    parts += [
        f"<p><a href='{link(sheet)}'><img class=sheet src='{link(sheet)}' alt='contact"
        " sheet'></a></p>"
        for sheet in sheets
    ]
    if predictions:
        parts += [
            "<h2>What a network reads from one picture</h2><p>Picture, predicted normals, light and"
            " material, and what the layer makes of "
        ]
        parts += [
            "them again; above from the record's radiance, below from a picture file, whose"
            " exposure nobody knows.</p>"
        ]
        parts += [
            f"<p><a href='{link(sheet)}'><img class=sheet src='{link(sheet)}'"
            " alt='prediction'></a></p>"
            for sheet in predictions
        ]
    if edits:
        parts += ["<h2>The same object in another material</h2>"]
        parts += [
            "<p>What was read from one picture, refined until it explains that picture, and"
            " rendered again in other materials: "
        ]
        parts += [
            "a record's, beside what Cycles makes of the same edit where it was rendered; then a"
            " photograph, where nobody knows.</p>"
        ]
        parts += [
            f"<p><a href='{link(sheet)}'><img class=sheet src='{link(sheet)}' alt='edit'></a></p>"
            for sheet in edits
        ]
    parts += ["<h2>How far Cycles and the layer are apart</h2>"]
    parts += [
        table(name, summary["breakdowns"][name])
        for name in SHOWN
        if summary["breakdowns"].get(name)
    ]
    parts += ["<h2>Why</h2>", causes(summary.get("causes") or {})]
    charts = sorted(agreement.glob("*.png"))
    parts += ["<div class=charts>"] if charts else []
    parts += [
        f"<a href='{link(chart)}'><img src='{link(chart)}' alt='{html.escape(chart.stem)}'></a>"
        for chart in charts
    ]
    return "\n".join(parts) + ("</div>" if charts else "") + "</html>\n"


def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python -m learn.agreement.demo_page", description=__doc__.split(": ", 1)[1]
    )
    parser.add_argument(
        "--sheet",
        action="append",
        type=Path,
        default=[],
        metavar="PNG",
        help="a contact sheet; repeatable",
    )
    parser.add_argument(
        "--prediction",
        action="append",
        type=Path,
        default=[],
        metavar="PNG",
        help="a sheet of `learn predict`; repeatable",
    )
    parser.add_argument(
        "--edit",
        action="append",
        type=Path,
        default=[],
        metavar="PNG",
        help="a sheet of `learn edit`; repeatable",
    )
    parser.add_argument(
        "--agreement",
        required=True,
        type=Path,
        metavar="DIR",
        help="what `python -m learn agree` wrote",
    )
    parser.add_argument(
        "--title", default="brdfactory", help="the page's heading (default: %(default)s)"
    )
    parser.add_argument("--out", required=True, type=Path, metavar="HTML", help="the page to write")
    options = parser.parse_args(arguments)
    try:
        absent = [
            sheet
            for sheet in (*options.sheet, *options.prediction, *options.edit)
            if not sheet.is_file()
        ]
        if absent:
            raise InputError(
                absent[0], "a picture", "none", "run `python -m factory preview DIR` first"
            )
        text = page(
            options.out,
            options.sheet,
            options.agreement,
            options.title,
            options.prediction,
            options.edit,
        )
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_text(options.out, text)
    except (InputError, OSError) as problem:
        print(f"learn.agreement.demo_page: {problem}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
