"""Captions of contact sheets: lines of text that can be read, shortened where they do not fit."""

from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # reading and writing data sets needs no pictures
    from PIL import ImageDraw, ImageFont

FONT = 12  # pixels; at Pillow's usual size of 10, some spaces and colons disappear
LINE = 16  # pixels from the top of a caption to what is below it


def write_caption(
    draw: "ImageDraw.ImageDraw",
    place: tuple[float, float],
    text: str,
    width: float,
    fill: str | tuple[int, int, int],
    anchor: str = "la",
) -> None:
    """Write a line of text into a picture.

    place   x, y in pixels of the point that the anchor names
    width   in pixels; a longer text is shortened
    anchor  Pillow's: "la" is the upper left corner, "ma" the middle of the upper edge
    """
    draw.text(place, shorten(text, width), fill=fill, anchor=anchor, font=_font())


def shorten(text: str, width: float) -> str:
    """Return a text that fits into a width in pixels; a longer one keeps its beginning and end."""
    length = _font().getlength
    if length(text) <= width:
        return text
    for kept in range(len(text) - 1, 0, -1):
        end = kept // 2
        shorter = f"{text[: kept - end]}…{text[len(text) - end :]}"
        if length(shorter) <= width:
            return shorter
    return "…"


@cache
def _font() -> "ImageFont.FreeTypeFont | ImageFont.ImageFont":
    """Return the font of captions."""
    from PIL import ImageFont

    return ImageFont.load_default(FONT)
