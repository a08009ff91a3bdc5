"""The evaluation's report as text, report.md, and as one self-contained web page, index.html."""

import html
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from learn.evaluation import gallery
from learn.evaluation.gallery import FULL
from learn.evaluation.methods import GIVEN_TRUTH
from learn.evaluation.table import Cell, Column, Table, TableRow
from learn.figures.html import bullets, encode_picture, image, page, paragraph
from manifests.wording import number_of

TITLE = "Edits, their truth, and their parts"
STYLE = """
body{max-width:1240px}
.note{margin:.1rem 0 .7rem;font-size:.92rem}
table{font-size:.84rem;background:var(--card)}
th,td{padding:.32rem .55rem}
th{white-space:normal;min-width:3.4rem;vertical-align:bottom;line-height:1.25}
tr.mine{background:var(--mine)}
tr.mine td:first-child{font-weight:600}
td.best{font-weight:700}
.ci{display:block;color:var(--soft);font-size:.76rem;font-weight:400}
figure{margin:0 0 1.4rem;padding:.8rem;overflow-x:auto}
figcaption{margin-bottom:.5rem}
.strip{display:grid;gap:.35rem}
.strip div{font-size:.74rem;line-height:1.25;color:var(--soft);min-width:84px}
.strip b{display:block;color:var(--ink);font-size:.82rem}
.strip img{width:100%;display:block;border-radius:4px;margin-bottom:.2rem}
"""
WORDS = {"better": "good", "yes": "good", "worse": "bad", "no": "bad"}


def text_of(cell: Cell, column: Column, interval: bool = True) -> str:
    """Return a cell as text; interval: whether its interval is part of it."""
    if cell is None:
        return "–"
    if isinstance(cell, str):
        return cell
    digits = column["digits"]
    if isinstance(cell, list):
        mean, low, high = (f"{x:.{digits}f}" for x in cell)
        return f"{mean} [{low}, {high}]" if column["interval"] and interval else mean
    return f"{cell:.{digits}f}"


def markdown(report: Mapping) -> str:
    """Return report.md."""
    lines = [f"# {TITLE}", ""]
    for sentence in report["about"].get("seen", ()):
        lines += [f"**{sentence}**", ""]
    lines += [*(f"- {sentence}" for sentence in report["headline"]), ""]
    for each in report["tables"].values():
        lines += table_lines(each)
    return (
        "\n".join(
            [*lines, "## How it was made", "", *(f"- {item}" for item in origin(report["about"]))]
        )
        + "\n"
    )


def table_lines(each: Table) -> list[str]:
    """Return a table as lines of Markdown, with its title and note."""
    lines = [
        f"## {each['title']}",
        "",
        each["note"],
        "",
        "| | " + " | ".join(c["label"] for c in each["columns"]) + " |",
        "|---" * (len(each["columns"]) + 1) + "|",
    ]
    for row in each["rows"]:
        texts = [text_of(row["cells"].get(c["key"]), c) for c in each["columns"]]
        lines.append(f"| {row['name']} | " + " | ".join(texts) + " |")
    return [*lines, ""]


def origin(about: Mapping) -> list[str]:
    """Return sentences about the run that made the report."""
    made = about["made"]
    lines = [
        (
            f"{number_of(about['edits'], 'edit')} of"
            f" {number_of(about['pictures'], 'picture')}, drawn with seed"
            f" {about['asked']['seed']} from {about['data']} ({'; '.join(about['tiers'])}). An"
            " edit's truth is the picture of the same shape, view and light in the target"
            " material."
        ),
        (
            f"Display values: {about['tone curve']}. Brackets: 95 % intervals, shapes, materials"
            " and lights drawn with replacement."
        ),
        f"`{made['command']}`, commit {made['commit']}, {made['date']}; {made['machine']}; weights"
        f" {about['weights']}"
        + (f", LPIPS weights {about['lpips']}" if about["lpips"] else "")
        + (f"; edits made at {', '.join(about['lines'])}" if "lines" in about else ""),
    ]
    return lines + [f"Left out: {name}: {why}." for name, why in about["missing"].items()]


def web(report: Mapping, shown: Iterable[tuple[Mapping, Path]], names: Sequence[str]) -> str:
    """Return index.html.

    shown  (row of edits.jsonl, path of its gallery PNG) of the edits shown as pictures
    names  of the methods: the columns of the gallery
    """
    shown = list(shown)
    body = [
        *(paragraph(sentence) for sentence in report["about"].get("seen", ())),
        paragraph(
            "A method is given one picture and a target material; Cycles rendered the same shape,"
            " view and light in that material.",
            "soft",
        ),
        bullets(report["headline"]),
    ]
    for key, each in report["tables"].items():
        body += [
            f"<h2>{html.escape(each['title'])}</h2>",
            paragraph(each["note"], "note"),
            web_table(each),
        ]
        if key == "edits" and shown:
            body.append(web_gallery(shown, names))
    made = [item.replace("`", "") for item in origin(report["about"])]
    return page("Evaluation", [*body, "<h2>How it was made</h2>", bullets(made)], STYLE, TITLE)


def web_table(each: Table) -> str:
    """Return a table as HTML: intervals beneath the figures, and the best of each column marked."""
    head = "".join(f"<th>{html.escape(c['label'])}</th>" for c in each["columns"])
    best = {c["key"]: _best(each["rows"], c) for c in each["columns"]}
    body = []
    for row in each["rows"]:
        cells = []
        for c in each["columns"]:
            cell = row["cells"].get(c["key"])
            text = html.escape(text_of(cell, c, interval=False))
            if isinstance(cell, list) and c["interval"]:
                text += (
                    f"<span class=ci>{cell[1]:.{c['digits']}f} … {cell[2]:.{c['digits']}f}</span>"
                )
            word = WORDS.get(cell) if isinstance(cell, str) else None
            kind = word or ("best" if row["name"] == best[c["key"]] else "")
            cells.append(f"<td class='{kind}'>{text}</td>" if kind else f"<td>{text}</td>")
        mine = " class=mine" if row["name"].startswith("ours") and "−" not in row["name"] else ""
        body.append(f"<tr{mine}><td>{html.escape(row['name'])}</td>{''.join(cells)}</tr>")
    return f"<div class=scroll><table><tr><th></th>{head}</tr>{''.join(body)}</table></div>"


def _best(rows: Sequence[TableRow], column: Column) -> str | None:
    """The name of the best row in a column with an arrow, without rows that are given truth."""
    sign = 1 if "↓" in column["label"] else -1 if "↑" in column["label"] else 0
    given = (*GIVEN_TRUTH, *(row["name"] for row in rows if "true" in row["name"]))
    cells = {
        row["name"]: row["cells"].get(column["key"]) for row in rows if row["name"] not in given
    }
    means = {name: sign * cell[0] for name, cell in cells.items() if isinstance(cell, list)}
    return min(means, key=means.__getitem__) if sign and len(means) > 1 else None


def web_gallery(shown: Iterable[tuple[Mapping, Path]], names: Sequence[str]) -> str:
    """Return the first edits as HTML: input, truth, every method's edit, and its error beneath."""
    parts = [
        "<h2>Pictures of the first edits</h2>",
        paragraph(
            "Above: the input, Cycles' truth of the edit, and each method's edit. Beneath: its"
            f" error, black where there is none, white from {FULL:g} of 255 display steps on. The"
            " number is L2 over the mask.",
            "note",
        ),
    ]
    for row, path in shown:
        heads = [
            ("shown", ""),
            ("truth", ""),
            *((name, f"{row['methods'][name]['l2']:.0f}") for name in names),
        ]
        columns = []
        for (name, l2), (above, below) in zip(heads, gallery.cells(path, len(heads)), strict=True):
            pictures = image(encode_picture(above), name)
            pictures += image(encode_picture(below), "error") if l2 else ""
            columns.append(f"<div>{pictures}<b>{l2}</b>{html.escape(name)}</div>")
        width = f"grid-template-columns:repeat({len(columns)},minmax(84px,1fr))"
        parts.append(
            f"<figure><figcaption>{_caption(row)}</figcaption>"
            f"<div class=strip style='{width}'>{''.join(columns)}</div></figure>"
        )
    return "".join(parts)


def _caption(row: Mapping) -> str:
    target, own = (
        html.escape(" + ".join(dict.fromkeys(row[key]))) for key in ("wanted", "materials")
    )
    where = html.escape(f"{row['shape']}, {row['light']}")
    return f"<b>{own} → {target}</b> · {where}"
