"""Events of `mkdocs build`: generated pages are added, and links that leave docs/ are turned.

Pages are written for readers of the repository too, where README.md, CHANGELOG.md and
CONTRIBUTING.md lie above docs/ and a folder is a page. The site has all of these as pages.
"""

import posixpath
import re
from pathlib import Path

import site_pages
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
# a page of the site, and the file above docs/ that it shows
ABOVE = {
    "index.md": "README.md",
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
    "license.md": "LICENSE",
}
# what a link may name that is no page of docs/, from the repository's folder, and its page
PAGES = {
    **{file: page for page, file in ABOVE.items()},
    "docs/README.md": "index.md",
    "docs/results": "results/index.md",
    "docs/jobs": "jobs/index.md",
    "docs/jobs/evaluation": "jobs/index.md",
    "docs/jobs/evaluation-regions": "jobs/index.md",
    "docs/results/photographs/index.html": "gallery.md",
}
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from code, from results and from files above docs/."""
    for page, source in ABOVE.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=_as_page(text, source)))
    citation = (ROOT / "CITATION.cff").read_bytes()
    files.append(File.generated(config, "CITATION.cff", content=citation))
    for path, content in site_pages.all_files(ROOT).items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return a page's text with links that the site can follow."""
    if page.is_homepage:
        page.meta["hide"] = ["navigation"]
    source = ABOVE.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    return turned_links(markdown, source, page.file.src_uri)


def turned_links(markdown: str, source: str, page: str) -> str:
    """Return a document's text with its links as the site needs them.

    source  the document's path from the repository's folder, from which its links start
    page    its path in the site
    """

    def turned(match: re.Match[str]) -> str:
        link, anchor = match[1], match[2] or ""
        if ":" in link:
            return match[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
        home = PAGES.get(target, target.removeprefix("docs/"))
        return posixpath.relpath(home, posixpath.dirname(page) or ".") + anchor

    fences = re.split(r"(^```.*?^```$)", markdown, flags=re.M | re.S)
    return "".join(part if part.startswith("```") else LINK.sub(turned, part) for part in fences)


def _as_page(text: str, source: str) -> str:
    """Return the text of a file above docs/ as Markdown."""
    return text if source.endswith(".md") else f"# Licence of the code\n\n```text\n{text}```\n"
