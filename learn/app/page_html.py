"""HTML that the page shows where Gradio has no component: progress, and pictures in a row."""

import html
import re
from collections.abc import Sequence
from pathlib import Path


def progress_bar(share: float, text: str) -> str:
    """Return a progress bar with what is being done; share: 0 to 1."""
    return f'<progress max="1" value="{share:.3f}"></progress><div>{html.escape(text)}</div>'


def without_markup(text: str) -> str:
    """Return Markdown that shows a text as it is: names come from files that users are sent."""
    return re.sub(r"([\\`*_{}\[\]()<>#!|~&])", r"\\\1", " ".join(text.split()))


def address_of(path: Path) -> str:
    """Return the address under which the page's server has a file, relative to the page."""
    return f"gradio_api/file={path}"


def figures(pictures: list[tuple[Path, str]]) -> str:
    """Return pictures, (file, caption), in a row."""
    each = (
        f'<figure><img src="{html.escape(address_of(path))}" alt="">'
        f'<figcaption class="caption">{html.escape(caption)}</figcaption></figure>'
        for path, caption in pictures
    )
    return f'<div class="tiles">{"".join(each)}</div>'


def kept_tiles(pictures: Sequence[tuple[Path, str]], beside: int | None) -> str:
    """Return pictures, (file, caption), side by side, each with buttons for what it can do.

    beside  number of the one that the view shows on its left, 0 the first, or None
    """
    each = []
    for number, (path, caption) in enumerate(pictures):
        text, which = html.escape(caption), f'data-name="{html.escape(path.name)}"'
        chosen = "true" if number == beside else "false"
        each.append(
            f'<figure><button data-act="show" {which} aria-label="Show {text}">'
            f'<img src="{html.escape(address_of(path))}" alt=""></button>'
            f'<figcaption class="caption">{text}</figcaption>'
            f'<button data-act="beside" {which} aria-pressed="{chosen}"'
            f' aria-label="Show {text} on the left">On the left</button>'
            f'<button data-act="remove" {which} aria-label="Remove {text}">'
            "Remove</button></figure>"
        )
    return f'<div class="tiles">{"".join(each)}</div>' if each else ""
