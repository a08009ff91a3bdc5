"""Masks from coordinates: a rectangle or a polygon around an object, and points on and beside it.

A coordinate is a number of pixels of the photograph's file, upright as viewers show it, or a
percentage of its width or height, such as 25%. x goes to the right and y down, from the top left
corner.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from learn.data import photographs, picture_arrays, picture_decoding
from learn.selection.display import display_for_marking
from learn.selection.marks import Selection
from learn.selection.superpixels import BACKGROUND
from manifests.errors import InputError

OBJECT = 1
NUMBER = re.compile(r"\s*(-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s*(%?)\s*")
REMEDY = "write X,Y in pixels, such as 120,80, or in per cent, such as 25%,40%"
Coordinate = float | str  # pixels, or a text such as "25%"
Point = str | Sequence[Coordinate]  # "X,Y", or (X, Y)


@dataclass(frozen=True)
class Points:
    """Where an object is.

    around         lines around it, each of two opposite corners of a rectangle, or of three or
                   more corners of a polygon
    without        lines, of the same kinds, around what is not the object
    on_object      points on the object
    on_background  points beside it
    names          of these four in messages
    """

    around: Sequence[Sequence[Point]] = ()
    without: Sequence[Sequence[Point]] = ()
    on_object: Sequence[Point] = ()
    on_background: Sequence[Point] = ()
    names: tuple[str, str, str, str] = ("--around", "--without", "--object", "--background")


def select(photo: Path | np.ndarray, points: Points) -> Selection:
    """Return the Selection of the object in a photograph; `labels() > 0` is its mask.

    The mask has the size at which photographs are edited: large ones are made smaller.

    photo   a file; or (H, W, 3 or 4) uint8 display values or floats of linear radiance
    Raises  InputError: no picture, no line and no point on the object, a point outside the picture,
            a line that encloses nothing, a mask of nearly nothing or of everything
    """
    around, without, on_object, on_background = points.names
    if not points.around and not points.on_object:
        remedy = "name two corners of a rectangle around the object, such as 120,80 520,460"
        raise InputError(around, f"a line around the object, or {on_object}", "neither", remedy)
    if isinstance(photo, Path):
        name = str(photo)
        radiance, _ = photographs.read_pixels(photo)
        is_linear = photographs.holds_radiance(photo)
        divisor = 1 if is_linear else picture_decoding.divisor_of(photo)
    else:
        name = "photo"
        radiance, _, is_linear = picture_arrays.read_picture(photo, name)
        divisor = 1 if is_linear else round(photo.shape[0] / radiance.shape[0])
    photographs.require_finite(name, radiance)
    selection = Selection(display_for_marking(radiance, is_linear)[0])
    for line in points.around:
        inside = _inside(around, line, selection.size, divisor)
        selection.enclose_pixels(inside, OBJECT, around, "name points all around it")
    for line in points.without:
        selection.paint(_inside(without, line, selection.size, divisor), BACKGROUND)
    for option, region, places in (
        (on_object, OBJECT, points.on_object),
        (on_background, BACKGROUND, points.on_background),
    ):
        for each in places:
            _click(selection, option, each, region, divisor)
    mask = selection.labels() > 0
    if mask.all():
        rule = "a line that leaves background outside, or points on the background"
        remedy = f"move it closer to the object, or give {on_background}"
        raise InputError(around, rule, "the whole picture", remedy)
    photographs.require_object(name, mask.astype(np.float32))
    return selection


def _click(selection: Selection, option: str, point: Point, region: int, divisor: int) -> None:
    x, y = _place(option, point, selection.size, divisor)
    height, width = selection.size
    if not (0 <= x < width and 0 <= y < height):
        rule = f"a point of the picture, {divisor * width} × {divisor * height} pixels"
        raise InputError(option, rule, _text(point), REMEDY)
    selection.click(x, y, region)


def _place(option: str, point: Point, size: tuple[int, int], divisor: int) -> tuple[float, float]:
    """Return x and y of a point in pixels of the picture as it was read; size: (H, W)."""
    parts = _text(point).split(",")
    matches = [NUMBER.fullmatch(part) for part in parts]
    if len(parts) != 2 or not all(matches):
        raise InputError(option, "points X,Y", _text(point), REMEDY)
    x, y = (
        float(match[1]) * (side / 100 if match[2] else 1 / divisor)
        for match, side in zip(matches, size[::-1], strict=True)
        if match
    )
    return x, y


def _text(point: Point) -> str:
    if isinstance(point, str) or not isinstance(point, Iterable):  # a number where a pair belongs
        return str(point)
    return ",".join(str(each) for each in point)


def _inside(option: str, line: Sequence[Point], size: tuple[int, int], divisor: int) -> np.ndarray:
    """Return pixels (H, W) bool inside a polygon, or a rectangle of which two corners are given.

    Raises  InputError for a single point
    """
    corners = [_place(option, each, size, divisor) for each in line]
    if len(corners) < 2:
        rule = "two corners of a rectangle, or more of a polygon"
        raise InputError(option, rule, "one point", "name another one")
    height, width = size
    for point, (x, y) in zip(line, corners, strict=True):
        if not (-width <= x <= 2 * width and -height <= y <= 2 * height):
            rule = (
                f"a point of the picture or near it, {divisor * width} × {divisor * height} pixels"
            )
            raise InputError(option, rule, _text(point), REMEDY)
    if len(corners) == 2:
        (left, top), (right, bottom) = corners
        corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    picture = Image.new("1", size[::-1])
    ImageDraw.Draw(picture).polygon(corners, fill=1)
    return np.array(picture, bool)
