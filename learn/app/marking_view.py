"""What tab 1 of the page shows of what is marked, and what was drawn there."""

from typing import Any

import numpy as np

from learn.app.session import NEXT, Session
from manifests.errors import InputError

OPAQUE = 127  # of 255: a stroke covers a pixel where it is more opaque


def strokes_of(drawn: dict | None) -> list[np.ndarray]:
    """Return what was drawn, each (h, w) bool. Raises InputError where nothing was."""
    layers = [] if drawn is None else drawn.get("layers") or []
    strokes = [layer[..., 3] > OPAQUE for layer in layers]
    if not any(covered.any() for covered in strokes):
        raise InputError("the brush", "something drawn", "nothing", "draw on the picture first")
    return strokes


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
