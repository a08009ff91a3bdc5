"""Draw the picture of docs/app.md: the page with the example, whose cup has another material.

PYTHONPATH=. python docs/app_picture.py docs/results/app.jpg

needs Chromium and its driver, as tests of the page do.
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image

from learn.app import page
from learn.commands.options import EDITING_WEIGHTS
from manifests import files
from tests.support.browser import Browser

SIZE = (1300, 1250)  # pixels of the window
MATERIAL = "green-latex"
RESULT = "[...document.querySelectorAll('#editor img')].some(i => i.src.includes('view-'))"


def page_with_a_material() -> Image.Image:
    """Return a picture of the page once the example's cup is shown in another material."""
    address, end = page.serve(EDITING_WEIGHTS, wait=False)
    try:
        with Browser(*SIZE) as window:

            def wait_for(selector: str, text: str) -> None:
                window.wait(f"document.querySelector({selector!r}).innerText.includes({text!r})")

            window.visit(address)
            window.wait("document.querySelector('#example')")
            window.click("#example")
            window.wait("!document.querySelector('#decompose').disabled")
            window.click("#decompose")
            window.wait("document.querySelector('#editor img')")
            wait_for("#shown", "choose a material")
            window.run(
                "[...document.querySelectorAll('#materials button')]"
                f".find(e => e.innerText.includes({MATERIAL!r})).click()"
            )
            window.wait(RESULT)
            wait_for("#shown", "Exact view")
            x, y, width = window.run(
                "const r = document.querySelector('#editor img').getBoundingClientRect();"
                "return [r.left, (r.top + r.bottom) / 2, r.width]"
            )
            window.drag([(x + share * width, y) for share in (0.5, 0.4, 0.2, 0.1)])
            window.run("await new Promise(done => setTimeout(done, 1000)); scrollTo(0, 0)")
            return Image.open(BytesIO(window.screenshot())).convert("RGB")
    finally:
        end()


def main() -> int:
    """Write the picture; return 0."""
    picture = page_with_a_material()
    buffer = BytesIO()
    picture.save(buffer, "JPEG", quality=88, optimize=True)
    files.write_bytes(Path(sys.argv[1]), buffer.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main())
