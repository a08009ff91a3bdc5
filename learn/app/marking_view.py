"""What tab 1 of the page shows of what is marked, and what was drawn there."""

import json
import math
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from learn.app.marked_photograph import THE_PAGE, MarkedPhotograph
from learn.app.session import NEXT, Session
from learn.selection import overlay
from learn.selection.superpixels import BACKGROUND
from manifests.errors import InputError

BRUSH = 12  # pixels of the picture that is marked: width of a line at first
LEAST_CORNERS, MOST_CORNERS = 3, 1000  # of a line that keys draw around an object
OPAQUE = 127  # of 255: a stroke covers a pixel where it is more opaque


def strokes_of(drawn: dict | None) -> list[np.ndarray]:
    """Return what was drawn, each (h, w) bool. Raises InputError where nothing was."""
    layers = [] if drawn is None else drawn.get("layers") or []
    strokes = [layer[..., 3] > OPAQUE for layer in layers]
    if not any(covered.any() for covered in strokes):
        raise InputError("the brush", "something drawn", "nothing", "draw on the picture first")
    return strokes


def mark_place(session: Session, number: int, place: str) -> str:
    """Mark what is under the cross that keys move, and return a sentence that says what and where.

    number  of the region that clicks mark
    place   JSON: [[shares of the picture's width and height], whether it is the object]. With
            number 0, which marks background, the object is region 1
    Raises  InputError
    """
    opened = session.opened()
    try:
        shares, adds = json.loads(place)
    except (TypeError, ValueError):
        shares, adds = None, True
    [(across, down)] = _places([shares], place)
    region = max(1, number) if adds else BACKGROUND
    [(column, row)] = _pixels(opened, [(across, down)])
    opened.click(column, row, region)
    said = f"{across:.0%} from the left and {down:.0%} from the top."
    return f"Marked as {_name(region)}, {said}"


def mark_line(session: Session, number: int, line: str) -> str:
    """Take a line whose corners the cross set, and return a sentence that says what for.

    number  of the region that clicks mark
    line    JSON: [[shares of the picture's width and height] of each corner, whether it is closed,
            around the object]. One that is not closed is paint on the region
    Raises  InputError
    """
    opened = session.opened()
    try:
        shares, is_closed = json.loads(line)
        shares = list(shares)
    except (TypeError, ValueError):
        shares, is_closed = [None], False
    least, count = LEAST_CORNERS if is_closed else 1, len(shares)
    if not least <= count <= MOST_CORNERS:
        rule = f"{least} to {MOST_CORNERS} corners"
        raise InputError(THE_PAGE, rule, f"{count}", f"set {rule} with L")
    corners = _pixels(opened, _places(shares, line))
    if is_closed:
        corners.append(corners[0])
    drawn = Image.new("1", overlay.size_of(opened.selection, opened.scale))
    pen = ImageDraw.Draw(drawn)
    pen.line(corners, 1, BRUSH, "curve")
    for column, row in corners:
        pen.circle((column, row), BRUSH / 2, 1)
    if is_closed:
        opened.enclose([np.asarray(drawn)], number)
        return f"Marked what the line encloses as {_name(max(1, number))}: {count} corners."
    opened.paint([np.asarray(drawn)], number)
    return f"Painted along the line as {_name(number)}."


def _places(shares: list, given: str) -> list[tuple[float, float]]:
    """Return shares of the picture's width and height as they were sent. Raises InputError."""
    try:
        places = [(float(across), float(down)) for across, down in shares]
    except (TypeError, ValueError, OverflowError):
        places = [(math.nan, math.nan)]
    if not all(0 <= share <= 1 for place in places for share in place):
        remedy = "move the cross with the arrow keys"
        raise InputError("the cross", "a place in the picture", str(given)[:80], remedy)
    return places


def _pixels(
    opened: MarkedPhotograph, places: list[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return (column, row) of places on the picture of `overlay`."""
    width, height = overlay.size_of(opened.selection, opened.scale)
    return [(min(x * width, width - 1), min(y * height, height - 1)) for x, y in places]


def _name(region: int) -> str:
    """Return a region's name in a sentence."""
    return {BACKGROUND: "not the object", 1: "the object"}.get(region, f"part {region}")


def canvas_of(session: Session) -> dict[str, Any]:
    """Return the picture to draw on, which shows what is marked, without what was drawn before.

    It has the size at which it is shown: a browser would receive a large photograph for a minute.
    """
    shown = session.opened().overlay()
    return {"background": shown, "layers": [], "composite": shown}


def covered_text(session: Session) -> str:
    """Return what is marked, and what to do next, as a sentence or two."""
    labels = session.opened().selection.labels()
    covered = f"{(labels > 0).mean():.0%} of the picture"
    if not labels.any():
        return "Click on the object, or choose *Draw* and draw a line around it."
    count = int(labels.max())
    several = f", in {count} parts" if count > 1 else ""
    return (
        f"The coloured object covers {covered}{several}. Click where it is missing. Where it is too"
        f" much, choose “Not the object” and click there. Then press “{NEXT}”."
    )
