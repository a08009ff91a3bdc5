"""What tab 1 of the page shows of what is marked, and what was drawn there."""

import json
from typing import Any

import numpy as np

from learn.app import overlay
from learn.app.session import NEXT, Session
from learn.app.superpixels import BACKGROUND
from manifests.errors import InputError

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
        across, down = map(float, shares)
        inside = 0 <= across <= 1 and 0 <= down <= 1
    except (TypeError, ValueError, OverflowError):
        inside = False
    if not inside:
        remedy = "move the cross with the arrow keys"
        raise InputError("the cross", "a place in the picture", str(place)[:80], remedy)
    width, height = overlay.size_of(opened.selection, opened.scale)
    region = max(1, number) if adds else BACKGROUND
    column, row = min(across * width, width - 1), min(down * height, height - 1)
    opened.click(column, row, region)
    what = {BACKGROUND: "not the object", 1: "the object"}.get(region, f"part {region}")
    return f"Marked as {what}, {across:.0%} from the left and {down:.0%} from the top."


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
