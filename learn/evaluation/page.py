"""The report as text and as one self-contained web page."""

import html

from learn.figures.html import encoded_picture as png
from learn.evaluation import gallery
from learn.evaluation.gallery import FULL
from learn.evaluation.methods import GIVEN_TRUTH

STYLE = """
:root{color-scheme:light dark;--ink:#1f2933;--soft:#5b6b79;--line:#dfe5ea;--back:#fbfcfd;--card:#fff;--mine:#e9f2ee;
--good:#2e7d4f;--bad:#b3402a}
@media(prefers-color-scheme:dark){:root{--ink:#e6ebef;--soft:#98a7b3;--line:#33414c;--back:#141a1f;--card:#1b232a;--mine:#1d2f29;
--good:#7ccf9c;--bad:#ee9079}}
body{font:15px/1.55 system-ui,sans-serif;color:var(--ink);background:var(--back);max-width:1240px;margin:0 auto;padding:2rem 1.2rem}
h1{font-size:1.7rem;margin:0 0 .3rem}
h2{font-size:1.2rem;margin:2.6rem 0 .3rem}
p,ul{max-width:78ch}
.soft,.note{color:var(--soft)}
.note{margin:.1rem 0 .7rem;font-size:.92rem}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:.84rem;font-variant-numeric:tabular-nums;background:var(--card)}
th,td{padding:.32rem .55rem;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th{white-space:normal;min-width:3.4rem}
th:first-child,td:first-child{text-align:left}
th{color:var(--soft);font-weight:600;vertical-align:bottom;line-height:1.25}
tr.mine{background:var(--mine)}
tr.mine td:first-child{font-weight:600}
td.best{font-weight:700}
.ci{display:block;color:var(--soft);font-size:.76rem;font-weight:400}
.good{color:var(--good)}
.bad{color:var(--bad)}
figure{margin:0 0 1.4rem;background:var(--card);border:1px solid var(--line);border-radius:10px;padding:.8rem;overflow-x:auto}
figcaption{margin-bottom:.5rem}
.strip{display:grid;gap:.35rem}
.strip div{font-size:.74rem;line-height:1.25;color:var(--soft);min-width:84px}
.strip b{display:block;color:var(--ink);font-size:.82rem}
.strip img{width:100%;display:block;border-radius:4px;margin-bottom:.2rem}
"""
WORDS = {"better": "good", "yes": "good", "worse": "bad", "no": "bad"}


def text_of(cell, column, interval=True):
    """A cell as text."""
    if cell is None:
        return "–"
    if isinstance(cell, str):
        return cell
    digits = column["digits"]
    if isinstance(cell, list):
        mean, low, high = (f"{x:.{digits}f}" for x in cell)
        return f"{mean} [{low}, {high}]" if column["interval"] and interval else mean
    return f"{cell:.{digits}f}"


def markdown(report):
    """report.md."""
    lines = ["# Edits, their truth, and what they are made of", ""]
    lines += [*(f"- {sentence}" for sentence in report["headline"]), ""]
    for each in report["tables"].values():
        lines += [f"## {each['title']}", "", each["note"], ""]
        lines += [
            "| | " + " | ".join(c["label"] for c in each["columns"]) + " |",
            "|---" * (len(each["columns"]) + 1) + "|",
        ]
        for row in each["rows"]:
            lines.append(
                f"| {row['name']} | "
                + " | ".join(text_of(row["cells"].get(c["key"]), c) for c in each["columns"])
                + " |"
            )
        lines.append("")
    return (
        "\n".join(
            [*lines, "## How it was made", "", *(f"- {item}" for item in origin(report["about"]))]
        )
        + "\n"
    )


def origin(about):
    """Sentences about the run."""
    made = about["made"]
    lines = [
        (
            f"{about['edits']} edits of {about['pictures']} pictures, drawn with seed"
            f" {about['asked']['seed']} from {about['data']} ({'; '.join(about['tiers'])}). An"
            " edit's truth is the picture of the same shape, view and light in the wanted"
            " material."
        ),
        (
            f"Display values: {about['tone curve']}. Brackets: 95 % intervals, shapes and materials"
            " drawn with replacement."
        ),
        f"`{made['command']}`, commit {made['commit']}, {made['date']}; {made['machine']}; weights"
        f" {about['weights']}"
        + (f", LPIPS weights {about['lpips']}" if about["lpips"] else "")
        + (f"; edits made at {', '.join(about['lines'])}" if "lines" in about else ""),
    ]
    return lines + [f"Left out: {name}: {why}." for name, why in about["missing"].items()]


def web(report, shown, names):
    """index.html. shown: [(row of edits.jsonl, path of its gallery PNG)]; names: of the methods,
    the columns of the gallery.
    """
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport"
        " content='width=device-width'>"
    ]
    parts += [
        f"<title>Evaluation</title><style>{STYLE}</style><h1>Edits, their truth, and what they are"
        " made of</h1>"
    ]
    parts += [
        "<p class=soft>A method is shown one picture and a wanted material; Cycles rendered the"
        " same shape, view and light in it.</p>"
    ]
    parts += [
        "<ul>"
        + "".join(f"<li>{html.escape(sentence)}</li>" for sentence in report["headline"])
        + "</ul>"
    ]
    for key, each in report["tables"].items():
        parts.append(
            f"<h2>{html.escape(each['title'])}</h2><p"
            f" class=note>{html.escape(each['note'])}</p>{web_table(each)}"
        )
        if key == "edits" and shown:
            parts.append(web_gallery(shown, names))
    parts += [
        "<h2>How it was made</h2><ul>"
        + "".join(
            f"<li>{html.escape(item).replace('`', '')}</li>" for item in origin(report["about"])
        )
    ]
    return "\n".join(parts) + "</ul></html>\n"


def web_table(each):
    """HTML of one table of learn.evaluation.tables, intervals beneath the figures, the best of each
    column marked.
    """
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


def _best(rows, column):
    """The name of the row that does best in a column with an arrow, all that is given truth left
    out.
    """
    sign = 1 if "↓" in column["label"] else -1 if "↑" in column["label"] else 0
    given = (*GIVEN_TRUTH, *(row["name"] for row in rows if "true" in row["name"]))
    cells = {
        row["name"]: row["cells"].get(column["key"]) for row in rows if row["name"] not in given
    }
    there = {name: sign * cell[0] for name, cell in cells.items() if isinstance(cell, list)}
    return min(there, key=there.get) if sign and len(there) > 1 else None


def web_gallery(shown, names):
    """The first edits: input, truth, every method's edit, and the error of each beneath."""
    parts = [
        "<h2>Pictures of the first edits</h2><p class=note>Above: the picture a method was shown,"
        " Cycles' truth of the edit, and what each method made of it. Beneath: its error, black"
        f" where there is none, white from {FULL:g} of 255 display steps on. The number is L2 over"
        " the mask.</p>"
    ]
    for row, path in shown:
        requested, was = (" + ".join(dict.fromkeys(row[key])) for key in ("wanted", "materials"))
        caption = (
            f"<b>{html.escape(was)} → {html.escape(requested)}</b> · {html.escape(row['shape'])},"
            f" {html.escape(row['light'])}"
        )
        columns = []
        heads = [
            ("shown", ""),
            ("truth", ""),
            *((name, f"{row['methods'][name]['l2']:.0f}") for name in names),
        ]
        for (name, l2), (above, below) in zip(heads, gallery.cells(path, len(heads)), strict=True):
            pictures = f"<img src='{png(above)}' alt='{html.escape(name)}'>"
            pictures += f"<img src='{png(below)}' alt='error'>" if l2 else ""
            columns.append(f"<div>{pictures}<b>{l2}</b>{html.escape(name)}</div>")
        width = f"grid-template-columns:repeat({len(columns)},minmax(84px,1fr))"
        parts.append(
            f"<figure><figcaption>{caption}</figcaption><div class=strip"
            f" style='{width}'>{''.join(columns)}</div></figure>"
        )
    return "".join(parts)
