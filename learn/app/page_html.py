"""HTML that the page shows where Gradio has no component: progress, and pictures in a row."""

import html
from pathlib import Path


def progress_bar(share: float, text: str) -> str:
    """Return a progress bar with what is being done; share: 0 to 1."""
    return f'<progress max="1" value="{share:.3f}"></progress><div>{html.escape(text)}</div>'


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
