"""The notebooks of docs/notebooks are the start pages, and run from top to bottom."""

import importlib.util
import json
import os
import subprocess
import sys

import pytest

PAGES = ("installing", "first-edit", "first-data-set", "first-layer")
HEAVIEST = 100_000
# what runs in a process of its own, because Jupyter's warnings are not ours
RUN = """
import sys
import nbformat
from nbclient import NotebookClient
notebook = nbformat.read(sys.argv[1], 4)
NotebookClient(notebook, timeout=280, resources={"metadata": {"path": sys.argv[2]}}).execute()
"""


@pytest.fixture(scope="module")
def maker(root):
    spec = importlib.util.spec_from_file_location("maker", root / "docs" / "make_notebooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_notebooks_are_those_that_the_pages_make(root, maker, tmp_path):
    assert maker.PAGES == PAGES
    maker.write(tmp_path)
    kept = root / "docs" / "notebooks"
    assert sorted(path.name for path in kept.iterdir()) == sorted(f"{p}.ipynb" for p in PAGES)
    for made in tmp_path.iterdir():
        assert (kept / made.name).read_text(encoding="utf-8") == made.read_text(encoding="utf-8"), (
            f"{made.name}: run python docs/make_notebooks.py"
        )


def test_a_page_becomes_cells_in_its_order(maker):
    page = "# A\n\n[b](c.md)\n\n```sh\nls\n```\n\n```python\nx = 1\n```\n\n```text\nno\n```\n"
    cells = json.loads(maker.notebook(page))["cells"]
    assert [(cell["cell_type"], "".join(cell["source"])) for cell in cells] == [
        ("markdown", "# A\n\n[b](../c.md)"),
        ("code", "%%sh -e\nls"),
        ("code", "x = 1"),
        ("markdown", "```text\nno\n```"),
    ]


@pytest.mark.parametrize("page", PAGES)
def test_a_notebook_is_small_and_holds_no_outputs(root, page):
    path = root / "docs" / "notebooks" / f"{page}.ipynb"
    assert path.stat().st_size < HEAVIEST
    assert not any(cell.get("outputs") for cell in json.loads(path.read_text("utf-8"))["cells"])


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES)
def test_a_notebook_runs(root, page, tmp_path):
    for module in ("nbclient", "ipykernel"):
        pytest.importorskip(module, reason="nbclient is not installed (extra docs)")
    for module in ("torch", *["bpy"] * (page == "first-data-set")):
        pytest.importorskip(module)
    programs = tmp_path / "programs"
    programs.mkdir()
    command = programs / "brdfactory"  # of this tree, not of an installed package
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m brdfactory "$@"\n')
    command.chmod(0o755)
    folder = tmp_path / "work"
    folder.mkdir()
    environment = {
        **os.environ,
        "PYTHONPATH": str(root),
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "HOME": str(tmp_path),  # Jupyter and IPython write settings
        "IPYTHONDIR": str(tmp_path / "ipython"),
    }
    path = root / "docs" / "notebooks" / f"{page}.ipynb"
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(path), str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-3000:]
