"""Captions: a text that fits stays, and a longer one keeps its two ends and fits."""

import numpy as np
import pytest
from PIL import Image, ImageDraw

from manifests.captions import LINE, shorten, write_caption


def ink(text, width, canvas=400):
    """Which pixels (LINE, canvas) a caption of at most `width` pixels darkens."""
    image = Image.new("L", (canvas, LINE), 255)
    write_caption(ImageDraw.Draw(image), (0, 0), text, width, "black")
    return np.asarray(image) < 128


def test_a_caption_that_fits_is_whole_and_a_longer_one_keeps_both_ends():
    name = "a-measured-material-with-a-long-name"
    assert shorten(name, 400) == name
    short = shorten(name, 120)
    beginning, end = short.split("…")
    assert name.startswith(beginning) and name.endswith(end) and len(beginning) >= 4 <= len(end)
    assert shorten(name, 1) == "…"


@pytest.mark.parametrize("text", ["M" * 50, "i" * 200, "Grüße aus 東京 " * 9])
@pytest.mark.parametrize("width", [40, 90, 300])
def test_a_caption_stays_within_its_width_and_fills_most_of_it(text, width):
    columns = np.flatnonzero(ink(text, width).any(axis=0))
    assert width - 24 <= columns.max() < width


def test_words_of_a_caption_are_apart_and_a_colon_after_a_t_is_seen():
    colon = ink("light:", 400).sum() - ink("light", 400).sum()
    assert colon >= 4
    columns = np.flatnonzero(ink("what is", 400).any(axis=0))
    assert np.diff(columns).max() >= 3
