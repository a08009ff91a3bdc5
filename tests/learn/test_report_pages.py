"""The web pages of reports: one document, plain texts escaped, pictures inside the page."""

import base64
import io

import numpy as np
from PIL import Image

from learn.figures import html, montage


def test_a_page_is_one_document_whose_plain_texts_are_escaped():
    text = html.page(
        "<a & b>",
        [
            html.paragraph("1 < 2", "soft"),
            html.bullets(["x & y"]),
            html.table(["<head>"], [["<cell>"]]),
            html.image("a.png", "it's"),
        ],
        style="h3{margin:0}",
    )
    assert text.startswith("<!doctype html>") and text.endswith("</html>\n")
    assert "<title>&lt;a &amp; b&gt;</title>" in text and "h3{margin:0}</style>" in text
    assert "<p class=soft>1 &lt; 2</p>" in text and "<li>x &amp; y</li>" in text
    assert "<th>&lt;head&gt;</th>" in text and "<td>&lt;cell&gt;</td>" in text
    assert "alt='it&#x27;s'" in text


def test_the_style_sheet_keeps_to_a_hundred_columns():
    assert max(map(len, html.STYLE.splitlines())) <= 100


def test_a_picture_inside_a_page_is_the_rounded_display_picture(rng):
    display = rng.uniform(-5, 260, (4, 5, 3))
    source = html.encode_picture(display)
    kind, _, data = source.partition(",")
    assert kind == "data:image/png;base64"
    read = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
    np.testing.assert_array_equal(read, montage.eight_bit(display))
