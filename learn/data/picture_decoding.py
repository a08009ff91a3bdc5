"""Picture files of 8 and 16 bits, decoded by Pillow: refused by their headers, and upright.

Of 16-bit colour Pillow reads the upper eight bits; of 16-bit grey all. The file's orientation is
applied; colour profiles are not read.
"""

import functools
import math
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, UnidentifiedImageError

from learn.data.file_kinds import kind_of
from manifests.errors import InputError
from manifests.inputs import require_file

# What Pillow may open. Left out are formats that start other programs (EPS starts Ghostscript),
# hold several sizes (ICO, ICNS), are read line by line in Python (plain PPM), or that no camera and
# no painting program writes by default.
FORMATS = ("PNG", "JPEG", "WEBP", "AVIF", "TIFF", "BMP", "GIF")
FORMATS_TEXT = "PNG, JPEG, WebP, AVIF, TIFF, BMP, GIF or EXR"
MOST_PIXELS = 64_000_000
MOST_SIDE = 65_535  # as JPEG; Pillow keeps a list of a picture's rows
MOST_BYTES = 1 << 30  # of a file: MOST_PIXELS of four 32-bit channels
# What Pillow's parsers raise on damaged files, besides OSError
DAMAGED = (
    SyntaxError,
    EOFError,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    struct.error,
    zlib.error,
    Image.DecompressionBombError,
)
TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}  # by the value of Exif's Orientation
TILE_WIDTH, TILE_LENGTH = 322, 323  # tags of a TIFF


def decode(
    path: str | Path,
    values_of: Callable[[Image.Image], np.ndarray],
    most_pixels: int | None = None,
) -> np.ndarray:
    """Return what `values_of` takes from the Pillow image of a file, which is whole and upright.

    most_pixels  of a picture, None: MOST_PIXELS; a larger one is refused by its header
    Raises       InputError
    """
    require_file(path, "a picture", "check the name", MOST_BYTES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of harmless oddities in a file's metadata
            with Image.open(path, formats=formats()) as opened:
                _require_readable(path, opened, most_pixels or MOST_PIXELS)
                opened.seek(0)  # of an animation, the first frame
                return values_of(_upright(opened))
    except InputError:
        raise
    except UnidentifiedImageError:
        rule = f"a picture in one of the formats {FORMATS_TEXT}"
        raise InputError(path, rule, *kind_of(path)) from None
    except (OSError, *DAMAGED) as error:
        result = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
        remedy = "copy or send it again, or save it again as PNG or JPEG: it is damaged"
        raise InputError(path, f"a whole picture ({FORMATS_TEXT})", result, remedy) from None


@functools.cache
def formats() -> list[str]:
    """Return those of FORMATS that the Pillow in use has: older ones have no AVIF."""
    Image.init()
    return [name for name in FORMATS if name in Image.OPEN]


def _require_readable(path, picture, most_pixels):
    """Raises InputError for a Pillow image, of which only the header was read, that is too large or
    holds no display values.
    """
    tags = getattr(picture, "tag_v2", {})  # of a TIFF, whose decoder takes memory for a whole tile
    for what, width, height in (
        ("", *picture.size),
        ("tiles of ", tags.get(TILE_WIDTH), tags.get(TILE_LENGTH)),
    ):
        sides = [side for side in (width, height) if isinstance(side, int)]
        if math.prod(sides) > most_pixels or max(sides, default=0) > MOST_SIDE:
            rule = f"at most {most_pixels / 1e6:g} megapixels, and {MOST_SIDE} a side"
            remedy = "make it smaller"
            if sides == [width, height] and not what:
                share = min((most_pixels / math.prod(sides)) ** 0.5, MOST_SIDE / max(sides))
                fitting = " × ".join(f"{int(share * side)}" for side in sides)
                remedy += f", {fitting} at most"
            raise InputError(path, rule, f"{what}{width} × {height}", remedy)
    if picture.mode == "F":
        raise InputError(path, "8 or 16 bit values", "floating point", "save it as EXR")


def _upright(picture):
    """The picture as its orientation says; one whose orientation cannot be read stays as it is."""
    picture.load()
    try:
        orientation = picture.getexif().get(ExifTags.Base.Orientation)
    except (OSError, *DAMAGED):  # a sound picture beside damaged metadata
        return picture
    turn = TURNS.get(orientation) if isinstance(orientation, int) else None
    return picture if turn is None else picture.transpose(turn)
