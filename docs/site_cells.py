"""Cells of the tables of the site's pages, in Markdown."""

import html
import re

COLUMNS = "| | |\n|---|---|"


def cell(text: str) -> str:
    """Return text as it can stand in a cell of a table of Markdown; `code` stays code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return _escaped(" ".join(text.replace("`", "'").split()))
    shown = [f"`{part}`" if i % 2 else _escaped(part) for i, part in enumerate(parts)]
    return " ".join("".join(shown).split())


def _escaped(text: str) -> str:
    """Return text without a meaning in Markdown; braces would be read as attributes."""
    escaped = re.sub(r"([\\*_\[\]])", r"\\\1", html.escape(text, quote=False))
    for character in "{}|":
        escaped = escaped.replace(character, f"&#{ord(character)};")
    return escaped
