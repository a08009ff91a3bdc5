"""Web pages of reports: one page with its style sheet, tables, and pictures inside the page."""

import base64
import html
import io
from collections.abc import Iterable, Sequence

import numpy as np
from PIL import Image

from learn.figures.montage import eight_bit

STYLE = """
:root{color-scheme:light dark;--ink:#1f2933;--soft:#5b6b79;--line:#dfe5ea;--back:#fbfcfd;
  --card:#fff;--accent:#2f6f9f;--mine:#e9f2ee;--good:#2e7d4f;--bad:#b3402a}
@media(prefers-color-scheme:dark){:root{--ink:#e6ebef;--soft:#98a7b3;--line:#33414c;
  --back:#141a1f;--card:#1b232a;--accent:#7db7de;--mine:#1d2f29;--good:#7ccf9c;--bad:#ee9079}}
body{font:15px/1.55 system-ui,sans-serif;color:var(--ink);background:var(--back);
  max-width:1180px;margin:0 auto;padding:2rem 1.2rem}
h1{font-size:1.7rem;margin:0 0 .3rem}
h2{font-size:1.15rem;margin:2.4rem 0 .6rem}
p,ul{max-width:74ch}
a{color:var(--accent)}
.soft,.note{color:var(--soft)}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:.86rem;font-variant-numeric:tabular-nums}
th,td{padding:.28rem .7rem;text-align:right;border-bottom:1px solid var(--line);
  white-space:nowrap}
th:first-child,td:first-child{text-align:left}
th{color:var(--soft);font-weight:600}
.good,.good b{color:var(--good)}
.bad,.bad b{color:var(--bad)}
figure{margin:0;background:var(--card);border:1px solid var(--line);border-radius:10px;
  padding:.7rem}
"""


def page(title: str, body: Iterable[str], style: str = "", heading: str | None = None) -> str:
    """Return a web page that needs no other file for its style.

    body     parts in HTML
    style    CSS beside STYLE
    heading  text of the page's heading; None: its title
    """
    head = (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width'>"
        f"<title>{html.escape(title)}</title><style>{STYLE}{style}</style>"
        f"<h1>{html.escape(heading or title)}</h1>"
    )
    return "\n".join([head, *body]) + "</html>\n"


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of plain text; kind: its CSS class."""
    return f"<p{f' class={kind}' if kind else ''}>{html.escape(text)}</p>"


def bullets(items: Iterable[str]) -> str:
    """Return a bulleted list of plain texts."""
    return "<ul>" + "".join(f"<li>{html.escape(item)}</li>" for item in items) + "</ul>"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of plain texts that scrolls sideways where the page is narrow."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<div class=scroll><table><tr>{head}</tr>{body}</table></div>"


def image(source: str, description: str = "") -> str:
    """Return an <img> of a source: an address, or what `encode` or `encode_picture` returns."""
    return f"<img src='{source}' alt='{html.escape(description, quote=True)}'>"


def encode(png: bytes) -> str:
    """Return the source of an <img> that holds a PNG's bytes."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def encode_picture(display: np.ndarray) -> str:
    """Return the source of an <img> that holds display values (H, W, 3) in [0, 255]."""
    buffer = io.BytesIO()
    Image.fromarray(eight_bit(display)).save(buffer, "PNG")
    return encode(buffer.getvalue())
