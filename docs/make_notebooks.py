"""Write the start pages as notebooks: python docs/make_notebooks.py [DIR].

A page is the source. Its text becomes cells of Markdown, its Python blocks cells of code, and its
blocks of commands cells that a shell runs; notebooks hold no outputs.
"""

import hashlib
import json
import re
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PAGES = ("installing", "first-edit", "first-data-set", "first-layer")
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```\n", flags=re.M | re.S)


def notebook(page: str) -> str:
    """Return the notebook of a page's text, as JSON."""
    cells = []
    position = 0
    for block in BLOCK.finditer(page):
        cells.append(_markdown(page[position : block.start()]))
        code = block[2] if block[1] == "python" else f"%%sh -e\n{block[2]}"
        cells.append(_cell("code", code.strip()) | {"execution_count": None, "outputs": []})
        position = block.end()
    cells.append(_markdown(page[position:]))
    kept = [cell for cell in cells if cell["source"]]
    for number, cell in enumerate(kept):
        digest = hashlib.sha256(f"{number} {''.join(cell['source'])}".encode())
        cell["id"] = digest.hexdigest()[:12]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {
        "cells": kept,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _markdown(text: str) -> dict:
    """Return a cell of text, whose links start from the notebooks' folder."""
    moved = re.sub(r"\]\((?!https?:|#)([^)]+)\)", r"](../\1)", text)
    return _cell("markdown", moved.strip())


def _cell(kind: str, text: str) -> dict:
    return {"cell_type": kind, "metadata": {}, "source": text.splitlines(keepends=True)}


def write(folder: Path) -> None:
    """Write all notebooks into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in PAGES:
        page = (DOCS / f"{name}.md").read_text(encoding="utf-8")
        (folder / f"{name}.ipynb").write_text(notebook(page), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS / "notebooks")
