"""Masks of objects in photographs, from a line around them."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from brdfactory import arguments
from learn.editing.photograph import resolve_example
from learn.selection.points import Point, Points, select
from manifests.errors import InputError


def make_mask(
    photo: str | Path | np.ndarray,
    around: Sequence[Point] = (),
    *,
    without: Sequence[Point] = (),
    on_object: Sequence[Point] = (),
    on_background: Sequence[Point] = (),
) -> np.ndarray:
    """Return the mask (H, W) bool of an object, for `edit` and `decompose`.

    A point is (x, y) in pixels from the photograph's top left corner, or a text such as "25%,40%"
    of its width and height. A photograph of more than 25 megapixels has a mask of the smaller size
    at which it is edited.

    photo          a file; "example:espresso-cup"; or an array (H, W, 3 or 4): uint8 display
                   values, or floats of linear radiance
    around         two opposite corners of a rectangle around the object, or three or more corners
                   of a polygon; the closer to the object, the better
    without        corners of a rectangle or polygon around something in it that is not the object
    on_object      points on the object, on what the mask lacks
    on_background  points beside the object, on what the mask should not have
    Raises         InputError: neither a line nor a point on the object, a point outside the
                   picture, a mask of nearly nothing or of everything
    """
    picture = arguments.require_picture("photo", photo)
    source = picture if isinstance(picture, np.ndarray) else resolve_example(picture, [], None)[0]
    names = ("around", "without", "on_object", "on_background")
    for name, points in zip(names, (around, without, on_object, on_background), strict=True):
        if not isinstance(points, Iterable):
            rule, remedy = "a list of points", "write [(30, 20), (570, 380)]"
            raise InputError(name, rule, arguments.shown(points), remedy)
    lines, others = ([line] if len(line) else [] for line in (around, without))
    marks = list(on_object), list(on_background)  # each may be an array, too
    return select(source, Points(lines, others, *marks, names)).labels() > 0
