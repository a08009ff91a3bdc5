"""The documentation site builds without a warning, all of its links lead somewhere, and nothing in
it is loaded from a network.
"""

import argparse
import importlib.util
import os
import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import brdfactory
import learn.experiments.__main__
from brdfactory import command_line
from tests.support import browser

LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}


class Page(HTMLParser):
    """The links, anchors, loaded files and text of a page."""

    def __init__(self, path: Path):
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = {"", "__top"}
        self.loaded: list[str] = []
        self.text: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and "href" in given:
            self.links.append(given["href"] or "")
        if given.get(LOADED.get(tag, "")) and given.get("rel") != "canonical":
            self.loaded.append(given[LOADED[tag]])

    def handle_data(self, data):
        self.text.append(data)


def broken(folder: Path) -> list[str]:
    """Each link of a folder's pages that leads to no file or anchor of the folder, as "page: link".

    Links to other sites are not followed.
    """
    pages = {path.resolve(): Page(path) for path in sorted(folder.rglob("*.html"))}
    result = []
    for path, page in pages.items():
        for link in [*page.links, *page.loaded]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if path.name == "404.html" and parts.path.startswith("/"):  # a server's own page
                target = folder.resolve() / unquote(parts.path).lstrip("/")
            anchors = pages[target].anchors if target in pages else {unquote(parts.fragment)}
            if not target.is_file() or unquote(parts.fragment) not in anchors:
                result.append(f"{path.relative_to(folder.resolve())}: {link}")
    return result


@pytest.fixture(scope="module")
def module(root):
    """Return a function that loads a module of docs/ by its name."""

    def load(name):
        spec = importlib.util.spec_from_file_location(name, root / "docs" / f"{name}.py")
        loaded = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(loaded)
        return loaded

    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(root / "docs")  # as mkdocs does, for they import each other
        yield load


@pytest.fixture(scope="module")
def site(root, tmp_path_factory):
    for name in ("mkdocs", "material", "mkdocstrings"):
        pytest.importorskip(name, reason="mkdocs is not installed (extra docs)")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root), "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "WARNING" not in done.stderr
    return folder


def test_a_broken_link_is_seen(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html#here">1</a><a href="b.html#gone">2</a><a href="c.html">3</a>'
        '<img src="d.png"><a href="https://example.org/x">5</a><a href="#no">6</a>'
    )
    (tmp_path / "b.html").write_text('<h2 id="here">B</h2>')
    assert broken(tmp_path) == [
        "a.html: b.html#gone",
        "a.html: c.html",
        "a.html: #no",
        "a.html: d.png",
    ]


def test_every_link_of_the_site_leads_somewhere(site):
    assert len(list(site.rglob("*.html"))) > 60
    assert broken(site) == []


def test_nothing_is_loaded_from_a_network(site):
    elsewhere = [
        f"{path.name}: {link}"
        for path in site.rglob("*.html")
        for link in Page(path).loaded
        if urlsplit(link).netloc
    ]
    assert elsewhere == []
    styles = [path for path in site.rglob("*.css") if "@import" in path.read_text("utf-8")]
    assert styles == []


def test_the_reference_has_every_command_and_every_name(site):
    text = " ".join(Page(site / "reference" / "command-line.html").text)
    anchors = Page(site / "reference" / "command-line.html").anchors
    assert set(command_line.COMMANDS) <= anchors
    assert "--white-balance" in text and "materials-preview" in anchors
    api = Page(site / "reference" / "brdfactory.html").anchors
    for name in brdfactory.__all__:
        assert f"{brdfactory._HOMES[name]}.{name}" in api
    schemas = Page(site / "reference" / "schemas.html")
    assert {"job", "record", "camera", "run"} <= schemas.anchors


def test_every_example_of_the_generated_pages_can_be_given(module, capsys):
    pages = module("site_commands")
    text = re.sub(r"\\\n *", "", pages.command_page() + pages.experiments_page())
    program = r"(?:python -m )?(brdfactory|factory|learn|learn\.experiments)"
    lines = re.findall(rf"^ *{program} (.*)$", text, re.M)
    assert len(lines) > 60
    experiments = argparse.ArgumentParser()
    subparsers = experiments.add_subparsers(required=True)
    for register in learn.experiments.__main__.COMMANDS.values():
        register(subparsers)
    parsers = {"learn.experiments": experiments}
    refused = []
    for program, line in lines:
        words = shlex.split(re.split(r"\s{2,}", line)[0])
        if words[-1] in ("COMMAND", "--help") or "[-h]" in words:  # a usage
            continue
        try:
            parsers.get(program, command_line.parser()).parse_args(words)
        except SystemExit:
            refused.append(f"{program} {line}: {capsys.readouterr().err.splitlines()[-1]}")
    assert refused == []


def test_the_gallery_has_a_picture_a_judgement_and_a_licence_for_each_photograph(site):
    page = Page(site / "gallery.html")
    text = " ".join(page.text)
    rows = [link for link in page.loaded if link.startswith("gallery/")]
    assert 3 * len(rows) >= 24
    assert text.count("Photograph:") == len(rows)
    assert "Fails: " in text and "CC-BY-2.0" in text


def test_the_weights_say_how_they_were_made(root, site):
    page = Page(site / "results" / "weights.html")
    for path in (root / "learn" / "weights").glob("*.safetensors"):
        assert path.stem in page.anchors


@pytest.mark.skipif(
    not browser.is_available(), reason="needs Debian's packages chromium and chromium-driver"
)
def test_search_works_in_pages_opened_from_disk(site):
    with browser.Browser() as window:
        window.open(site / "first-edit.html")
        window.wait("document.querySelector('.md-search__input')")
        window.click(".md-search__input")
        window.type(".md-search__input", "reflectance map")
        window.wait("document.querySelector('.md-search-result__link')")
        assert "matching documents" in window.run(
            "return document.querySelector('.md-search-result__meta').textContent"
        )
        assert window.console() == []


def test_links_that_leave_the_folder_of_documents_become_pages(module, root, monkeypatch):
    pytest.importorskip("mkdocs", reason="mkdocs is not installed (extra docs)")
    monkeypatch.syspath_prepend(str(root / "docs"))
    turned = module("hooks").turned_links
    assert turned("[a](docs/editing.md#b)", "README.md", "index.md") == "[a](editing.md#b)"
    assert turned("[a](../CHANGELOG.md)", "docs/editing.md", "editing.md") == "[a](changelog.md)"
    assert turned("[a](results)", "docs/log.md", "log.md") == "[a](results/index.md)"
    assert turned("[a](report.json)", "docs/results/x/report.md", "results/x/report.md") == (
        "[a](report.json)"
    )
    kept = "[a](https://example.org/docs/a.md)\n```text\n[a](../CHANGELOG.md)\n```\n"
    assert turned(kept, "docs/a.md", "a.md") == kept


def test_columns_of_a_docstring_become_a_table(module):
    pytest.importorskip("griffe", reason="mkdocs is not installed (extra docs)")
    as_markdown = module("griffe_columns").as_markdown
    text = "Return x.\n\n    a, b    one\n            or two\n    Raises  InputError\n    "
    assert as_markdown(text) == (
        "Return x.\n\n| | |\n|---|---|\n| `a, b` | one or two |\n| `Raises` | InputError |"
    )
    assert as_markdown("One line.") == "One line."


def test_the_citation_is_valid(root):
    yaml = pytest.importorskip("yaml", reason="mkdocs is not installed (extra docs)")
    cited = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["cff-version"] == "1.2.0" and cited["message"] and cited["type"] == "software"
    works = [cited, cited["preferred-citation"], *cited["references"]]
    for work in works:
        assert work["title"] and work["authors"]
        for author in work["authors"]:
            assert "name" in author or {"family-names", "given-names"} <= set(author)
    for work in works[1:]:
        assert work["type"] in ("article", "conference-paper", "software")
        assert isinstance(work["year"], int)
        assert work["type"] != "article" or work["journal"]
