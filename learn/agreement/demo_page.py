"""`python -m learn.agreement.demo_page`: a web page over contact sheets, agreement and charts.

It reads report.json of `python -m learn agree` and links to pictures where they are, so that the
page is small.
"""

import argparse
import html
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from learn.agreement import uncertainty
from learn.figures.html import image, page, paragraph, table
from manifests.errors import InputError
from manifests.files import write_text
from manifests.provenance import in_one_line

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
# breakdowns on this page; the report itself has them all
SHOWN = ("tier and light resolution", "material", "light", "category")
STYLE = """
.sheets img{width:100%;background:#202428;border-radius:10px}
.sheets{max-width:none}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(330px,1fr));gap:1rem}
.charts img{width:100%;background:#fff;border:1px solid var(--line);border-radius:10px}
table{margin-bottom:1.2rem}
"""


def read(path: Path, command: str) -> dict:
    """Return the JSON of a file that `command` writes. Raises InputError where there is none."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "a file", "none", f"run `{command}` first") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "JSON", str(error), f"run `{command}` again") from None


def breakdown(name: str, groups: Mapping[str, Mapping]) -> str:
    """Return a breakdown {value: figures} as HTML, with the columns that hold figures."""
    columns = {
        key: column
        for key, column in COLUMNS.items()
        if any(cell.get(key) is not None for cell in groups.values())
    }
    rows = [
        [
            str(value),
            *(
                "–" if cell.get(key) is None else pattern.format(cell[key])
                for key, (_, pattern) in columns.items()
            ),
        ]
        for value, cell in groups.items()
    ]
    return table([name, *(title for title, _ in columns.values())], rows)


def verdict(direct: Mapping) -> str:
    """Return the report's headline in words."""
    if direct.get("net") is None or direct.get("like_net") is None:
        return (
            "No picture was rendered with two seeds: the noise is unknown, so the direct tier"
            " cannot be judged."
        )
    fit = direct.get("node_fit")
    like = uncertainty.written(
        direct["like_net"],
        direct.get("like_net_error"),
        None if fit is None else direct["limit"] * fit,
    )
    report = (
        "In the direct tier, the light transport that the layer models, the two renderers'"
        " pictures differ inside silhouettes and creases by a display L2 of"
        f" {like} once noise is taken off (black and white differ by 65,025);"
        f" edges included, by {direct['net']:.2f}."
    )
    if fit is None:
        return (
            report
            + " The catalogue does not say how far its materials' two forms, label and nodes, are"
            " apart, so there is no limit."
        )
    judged = "within" if direct.get("holds") else "beyond"
    return (
        f"{report} The materials' two forms, label and nodes, differ by {fit:.2f}; the limit"
        f" inside is {direct['limit']:g} times that: {judged} it."
        f"{uncertainty.advice(direct.get('noise_may_decide'))}"
    )


def causes(summary: Mapping[str, float | None]) -> str:
    """Return the causes of the direct tier's disagreement as HTML; "" where there are none."""
    rows = [
        [text, f"{value:.3g}"]
        for key, text in CAUSES.items()
        if (value := summary.get(key)) is not None
    ]
    return table(["cause, direct tier", "L2"], rows) if rows else ""


def demo_page(
    out: Path,
    sheets: Sequence[Path],
    agreement: Path,
    title: str,
    predictions: Sequence[Path] = (),
    edits: Sequence[Path] = (),
) -> str:
    """Return the page's text; its links are relative to the folder of `out`.

    sheets, predictions, edits  paths of contact sheets
    agreement                   folder of the report
    """
    report = read(agreement / "report.json", "python -m learn agree DIR --out DIR2")
    summary, about = report["summary"], report["about"]

    def link(path: Path) -> str:
        return html.escape(Path(os.path.relpath(path, out.parent)).as_posix(), quote=True)

    def linked(path: Path, description: str) -> str:
        return f"<a href='{link(path)}'>{image(link(path), description)}</a>"

    def shown(paths: Sequence[Path], description: str) -> list[str]:
        return [f"<p class=sheets>{linked(path, description)}</p>" for path in paths]

    body = [
        paragraph(in_one_line(about), "soft"),
        f"<p>{html.escape(verdict(summary['direct']))}"
        f" <a href='{link(agreement / 'index.html')}'>The whole report</a>.</p>",
        "<h2>What was rendered</h2>",
        *shown(sheets, "contact sheet"),
    ]
    if predictions:
        body += [
            "<h2>What a network reads from one picture</h2>",
            paragraph(
                "Picture, predicted normals, light and material, and their rendering by the layer;"
                " above from the record's radiance, below from a picture file, whose exposure is"
                " not known."
            ),
            *shown(predictions, "prediction"),
        ]
    if edits:
        body += [
            "<h2>The same object in another material</h2>",
            paragraph(
                "The decomposition of one picture, refined until it explains that picture, and"
                " rendered in other materials: first a record, beside Cycles' rendering of the"
                " same edit where there is one; then a photograph, whose truth is not known."
            ),
            *shown(edits, "edit"),
        ]
    body += ["<h2>How far Cycles and the layer are apart</h2>"]
    body += [
        breakdown(name, summary["breakdowns"][name])
        for name in SHOWN
        if summary["breakdowns"].get(name)
    ]
    body += ["<h2>Why</h2>", causes(summary.get("causes") or {})]
    charts = sorted(agreement.glob("*.png"))
    if charts:
        linked_charts = [linked(chart, chart.stem) for chart in charts]
        body += ["<div class=charts>", *linked_charts, "</div>"]
    return page(title, body, STYLE)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page as the command line says, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m learn.agreement.demo_page", description=__doc__.split(": ", 1)[1]
    )
    for option, what in (
        ("--sheet", "a contact sheet"),
        ("--prediction", "a contact sheet of `learn predict`"),
        ("--edit", "a contact sheet of `learn edit`"),
    ):
        parser.add_argument(
            option,
            action="append",
            type=Path,
            default=[],
            metavar="PNG",
            help=f"{what}; repeatable",
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
        sheets = (*options.sheet, *options.prediction, *options.edit)
        absent = [picture for picture in sheets if not picture.is_file()]
        if absent:
            raise InputError(
                absent[0], "a picture", "none", "run `python -m factory preview DIR` first"
            )
        text = demo_page(
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
