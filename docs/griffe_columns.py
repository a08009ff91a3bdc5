"""Docstrings of this project have their arguments in columns; the site shows them as tables.

An extension of griffe, which reads the docstrings for mkdocstrings.
"""

import inspect
import re
from typing import Any

import griffe

ROW = re.compile(r"^(\S+(?:,? \S+)*?) {2,}(\S.*)$")


def as_markdown(text: str) -> str:
    """Return a docstring whose blocks of two columns are tables of Markdown."""
    return "\n\n".join(_block(block) for block in re.split(r"\n\s*\n", inspect.cleandoc(text)))


def _block(block: str) -> str:
    lines = block.split("\n")
    begins = next((i for i, line in enumerate(lines) if ROW.match(line)), None)
    if begins is None:
        return block
    rows: list[list[str]] = []
    last = max(i for i, line in enumerate(lines) if ROW.match(line) or line.startswith("  "))
    for line in lines[begins : last + 1]:
        if match := ROW.match(line):
            rows.append([match[1], match[2]])
        else:
            rows[-1][1] += f" {line.strip()}"
    before, after = "\n".join(lines[:begins]), "\n".join(lines[last + 1 :])
    table = ["| | |", "|---|---|", *(f"| `{name}` | {cell(text)} |" for name, text in rows)]
    return "\n\n".join(part for part in (before, "\n".join(table), after) if part)


def cell(text: str) -> str:
    """Return text as it can stand in a cell of a table."""
    parts = text.split("`")
    for i in range(0, len(parts), 2):  # outside of `code`
        parts[i] = re.sub(r"([*_\[\]<>])", r"\\\1", parts[i])
        for character in "{}|":
            parts[i] = parts[i].replace(character, f"&#{ord(character)};")
    return "`".join(parts)


class Columns(griffe.Extension):
    """Changes every docstring before it is rendered."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Rewrite the docstring of a module, class, function or attribute."""
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)
