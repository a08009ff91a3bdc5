"""The page of edited photographs, docs/results/photographs, on a desk and on a telephone."""

import base64
import json
import re
from pathlib import Path

import pytest

from tests.learn import measure_photographs
from tests.support import browser
from tests.support.browser import Browser

PUBLISHED = measure_photographs.FOLDER / "index.html"


def test_the_published_page_is_what_its_command_writes(tmp_path: Path) -> None:
    """Made again of the published rows, it is the same; so that its text follows the code."""
    text = PUBLISHED.read_text(encoding="utf-8")
    rows = {}
    for name, data in re.findall(r"<h2>([^<]+)</h2>.*?base64,([^']+)'", text, re.DOTALL):
        rows[name] = tmp_path / f"{name}.jpg"
        rows[name].write_bytes(base64.b64decode(data))
    assert len(rows) == 20 + len(measure_photographs.shaped()) == 24
    judged = json.loads((measure_photographs.FOLDER / "judged.json").read_text())
    about = json.loads((measure_photographs.FOLDER / "report.json").read_text())
    credits = {n: credit for n, (_, _, credit) in measure_photographs.sources(tmp_path).items()}
    assert measure_photographs.page(rows, credits, judged, about) == text


@pytest.mark.skipif(
    not browser.is_available(), reason="needs Debian's packages chromium and chromium-driver"
)
def test_a_row_can_be_recognised_on_a_telephone_and_seen_whole_on_a_desk() -> None:
    width = "return document.querySelector('.scroll img').getBoundingClientRect().width"
    page_width = "return document.documentElement.scrollWidth"
    with Browser(1300, 850) as window:
        window.resize(390, 844)
        window.open(PUBLISHED)
        assert window.run(page_width) <= 390
        pictures = 4 + len(measure_photographs.MATERIALS)
        assert window.run(width) / pictures > 140  # each of a row's pictures
        window.resize(1300, 850)
        assert 1000 < window.run(width) < 1180 and window.run(page_width) <= 1300
