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
from manifests.outputs import try_file
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
    "edges": "edges: in Cycles a pixel there is a mean over two surfaces, in the layer one of them",
    "noise": "noise of Cycles' samples",
    "node_fit": "the two descriptions of a material, label and nodes, differ",
    "footprint": "in Cycles a pixel is an area, in the layer its centre",
    "look_up": "Cycles looks the light up slightly turned",
    "rest": "what none of these explains",
    "texel_sum": "for comparison: the error of the paper's sum over texels",
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
    like = uncertainty.as_text(
        direct["like_net"],
        direct.get("like_net_error"),
        None if fit is None else direct["limit"] * fit,
    )
    report = (
        "In direct light, which is what the layer models, the pictures of the two renderers differ"
        f" by a display L2 of {like} inside silhouettes and creases, once noise is subtracted."
        f" With edges it is {direct['net']:.2f}; black and white differ by 65,025."
    )
    if fit is None:
        return (
            report
            + " The catalogue does not say how much its two descriptions of a material, one for"
            " each renderer, differ, so there is no limit."
        )
    judged = "within" if direct.get("holds") else "beyond"
    return (
        f"{report} The two descriptions of the materials, one for each renderer, differ by"
        f" {fit:.2f}. The limit is {direct['limit']:g} times that, and the difference is {judged}"
        " it."
        f"{uncertainty.advice(direct.get('noise_may_decide'))}"
    )


def causes(summary: Mapping[str, float | None]) -> str:
    """Return the causes of the direct tier's disagreement as HTML; "" where there are none."""
    rows = [
        [text, f"{value:.3g}"]
        for key, text in CAUSES.items()
        if (value := summary.get(key)) is not None
    ]
    return table(["cause, in direct light", "display L2"], rows) if rows else ""


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

    body = []
    if edits:
        body += [
            "<h2>Edits: the same object in another material</h2>",
            paragraph(
                "Normals, light and material are read from one picture and refined until their"
                " rendering looks like it; then the object is rendered in other materials."
                " What a photographed object would look like in them is not known. A rendered one"
                " is shown beside Blender's picture of it in the new material, the truth."
            ),
            *shown(edits, "edit"),
        ]
    if predictions:
        body += [
            "<h2>What the network reads from one picture, before refinement</h2>",
            paragraph(
                "From left: the picture, predicted normals, light and material, and what the layer"
                " renders from them. In the first sheet the network saw the radiance that Blender"
                " rendered; in the second a picture file, whose exposure is not known."
            ),
            *shown(predictions, "prediction"),
        ]
    if sheets:
        body += [
            "<h2>The data set that Blender rendered</h2>",
            paragraph(
                "Each row is one record: picture, normals, segments, a mirror sphere under its"
                " light, what the layer renders, and four times the difference between the two."
            ),
            *shown(sheets, "contact sheet"),
        ]
    body += [
        "<h2>Do Blender's pictures agree with the layer's?</h2>",
        f"<p>{html.escape(verdict(summary['direct']))}"
        f" <a href='{link(agreement / 'index.html')}'>The whole report</a>.</p>",
    ]
    body += [
        breakdown(name, summary["breakdowns"][name])
        for name in SHOWN
        if summary["breakdowns"].get(name)
    ]
    body += ["<h3>Where the difference comes from</h3>", causes(summary.get("causes") or {})]
    charts = sorted(agreement.glob("*.png"))
    if charts:
        linked_charts = [linked(chart, chart.stem) for chart in charts]
        body += ["<div class=charts>", *linked_charts, "</div>"]
    body += ["<h2>How this page was made</h2>", paragraph(in_one_line(about), "soft")]
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
        try_file(options.out)
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
