"""Picture files of 8 and 16 bits, decoded: refused by their headers, upright, in sRGB, reduced.

Pillow decodes them, and learn.data.heic those of iPhones. Of 16-bit colour Pillow reads the upper
eight bits; of 16-bit grey all. The file's orientation is applied, and its colour profile
(learn.data.colour_profiles).

A picture of more than MOST_PIXELS is made smaller: its sides are divided by the smallest whole
number that makes it fit, and rounded up. Masks are read in the same way, so one of the full size
and one of the reduced size both fit the picture. MOST_DECODED bounds the memory for decoding.
"""

import functools
import math
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, JpegImagePlugin, UnidentifiedImageError

from learn.data import cicp, colour_profiles, heic
from learn.data.file_kinds import HEAD, is_heic, kind_of
from manifests.errors import InputError
from manifests.inputs import require_file

# What Pillow may open. Left out are formats that start other programs (EPS starts Ghostscript),
# hold several sizes (ICO, ICNS), are read line by line in Python (plain PPM), or that no camera and
# no painting program writes by default.
FORMATS = ("PNG", "JPEG", "WEBP", "AVIF", "TIFF", "BMP", "GIF")
FORMATS_TEXT = "PNG, JPEG, HEIC, WebP, AVIF, TIFF, BMP, GIF or EXR"
# Of a picture after it was made smaller; cameras and phones of 24 megapixels have up to 24.5
# million pixels. An edit takes up to 200 bytes per pixel.
MOST_PIXELS = 25_000_000
MOST_DECODED = 640_000_000  # bytes of memory for a picture while it is decoded
# Phones make JPEGs of up to 200 megapixels; one of a single pass is decoded at its reduced size
MOST_JPEG_PIXELS = 210_000_000
MOST_SIDE = 65_535  # as JPEG; Pillow keeps a list of a picture's rows
MOST_BYTES = 1 << 30  # of a file: many pixels of four 32-bit channels
# Bytes per pixel in the memory of Pillow, which stores three channels as four
PIXEL_BYTES = {"1": 1, "L": 1, "P": 1, "I;16": 2, "I;16L": 2, "I;16B": 2}
OTHER_PIXEL_BYTES = 4
# Beside it, where pixels are mixed: copies in the modes in which Pillow mixes them
COPIES_BYTES = {"1": 1, "P": 8, "PA": 8, "LA": 4, "RGBA": 4, "I;16": 4, "I;16L": 4, "I;16B": 4}
# Beside it: each channel's coefficients of a JPEG of several passes, and the planes that HEIC and
# AVIF decode to
COEFFICIENT_BYTES, PLANES_BYTES = 2, 8
START_OF_PASS = b"\xff\xda"  # of a JPEG
DRAFTS = (8, 4, 2)  # divisors by which JPEG is decoded smaller
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


def decode(path: str | Path, values_of: Callable[[Image.Image], np.ndarray]) -> np.ndarray:
    """Return what `values_of` takes from the Pillow image of a file.

    The image is whole, upright, in sRGB, and reduced to MOST_PIXELS. Raises InputError.
    """

    def values(opened: Image.Image) -> np.ndarray:
        converted = colour_profiles.to_srgb(reduce_size(opened, Image.Resampling.BOX))
        return values_of(_upright(converted, opened))

    return _apply_to_image(path, values)


def decode_labels(path: str | Path, values_of: Callable[[Image.Image], np.ndarray]) -> np.ndarray:
    """Return what `values_of` takes from the Pillow image of a file whose values are labels.

    As `decode`, but values are neither mixed nor converted. Raises InputError.
    """

    def values(opened: Image.Image) -> np.ndarray:
        return values_of(_upright(reduce_size(opened, Image.Resampling.NEAREST), opened))

    return _apply_to_image(path, values, is_mixed=False)


def describe_file_reduction(path: str | Path, size: tuple[int, ...]) -> str | None:
    """Return a sentence that says that a file was made smaller when it was read, else None.

    size    (H, W) of what was read
    Raises  InputError
    """

    def sentence(opened: Image.Image) -> str | None:
        return describe_reduction(opened.size, size)

    return _apply_to_image(path, sentence)


def divisor_of(path: str | Path) -> int:
    """Return the number by which a picture's width and height are divided when it is read.

    Raises InputError.
    """
    return int(_apply_to_image(path, lambda opened: _divisor(opened.size)))


def describe_reduction(full: tuple[int, int], size: tuple[int, ...]) -> str | None:
    """Return a sentence that says that a picture was made smaller, None if it was not.

    full  width and height that it had; size: (H, W) that it has now, perhaps turned
    """
    divisor = _divisor(full)
    if divisor == 1:
        return None
    if _quotients(full, divisor) != (size[1], size[0]):
        full = full[::-1]
    return (
        f"the photograph has {full[0]} × {full[1]} pixels, more than"
        f" {MOST_PIXELS / 1e6:g} megapixels, and is read at 1/{divisor} of its width and"
        f" height: the edit has {size[1]} × {size[0]} pixels"
    )


def _apply_to_image(path, function, is_mixed=True):
    """Return what a function returns for a file's Pillow image, of which only the header was read.

    is_mixed  whether pixels are mixed if the picture is made smaller
    """
    require_file(path, "a picture", "check the name", MOST_BYTES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of harmless oddities in a file's metadata
            with _open(path) as opened:
                _require_readable(path, opened, is_mixed)
                return function(opened)
    except InputError:
        raise
    except Image.DecompressionBombError:  # of a file that is not JPEG, by its header
        rule = f"at most {2 * (Image.MAX_IMAGE_PIXELS or 0) / 1e6:.3g} megapixels"
        raise InputError(path, rule, "more", "make it smaller") from None
    except UnidentifiedImageError:
        rule = f"a picture in one of the formats {FORMATS_TEXT}"
        raise InputError(path, rule, *kind_of(path)) from None
    except (OSError, *DAMAGED) as error:
        result = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
        remedy = "copy or send it again, or save it again as PNG or JPEG: it is damaged"
        raise InputError(path, f"a whole picture ({FORMATS_TEXT})", result, remedy) from None


def _open(path):
    """Return the Pillow image of a file, of which only the header is read.

    Of an animation it is the first frame.
    """
    with open(path, "rb") as file:
        head = file.read(HEAD)
    if is_heic(head):
        return heic.open_image(path)
    if head.startswith(b"\xff\xd8\xff"):
        # Image.open refuses 179 megapixels whatever they take, unless a setting of the whole
        # process is changed
        file = open(path, "rb")  # noqa: SIM115  the image closes it
        try:
            jpeg = JpegImagePlugin.jpeg_factory(file, str(path))
        except BaseException:
            file.close()
            raise
        jpeg._exclusive_fp = True
        return jpeg
    opened = Image.open(path, formats=formats())
    opened.seek(0)
    if opened.format in ("PNG", "AVIF"):
        with open(path, "rb") as file:
            opened.info["nclx_profile"] = cicp.read_cicp(file)
    return opened


@functools.cache
def formats() -> list[str]:
    """Return those of FORMATS that the Pillow in use has: older ones have no AVIF."""
    Image.init()
    return [name for name in FORMATS if name in Image.OPEN]


def _require_readable(path, picture, is_mixed=True):
    """Raise InputError for a Pillow image that is too large or holds no display values.

    Only its header was read.
    """
    tags = getattr(picture, "tag_v2", {})  # of a TIFF, whose decoder takes memory for a whole tile
    most_pixels = _most_pixels(picture, is_mixed)
    for what, width, height in (
        ("", *picture.size),
        ("tiles of ", tags.get(TILE_WIDTH), tags.get(TILE_LENGTH)),
    ):
        sides = [side for side in (width, height) if isinstance(side, int)]
        if math.prod(sides) > most_pixels or max(sides, default=0) > MOST_SIDE:
            rule = f"at most {most_pixels / 1e6:.3g} megapixels, and {MOST_SIDE} a side"
            remedy = "make it smaller"
            if sides == [width, height] and not what:
                share = min((most_pixels / math.prod(sides)) ** 0.5, MOST_SIDE / max(sides))
                fitting = " × ".join(f"{int(share * side)}" for side in sides)
                remedy += f", {fitting} at most"
            raise InputError(path, rule, f"{what}{width} × {height}", remedy)
    if picture.mode == "F":
        raise InputError(path, "8 or 16 bit values", "floating point", "save it as EXR")


def _most_pixels(picture, is_mixed):
    """Return how many pixels a Pillow image may have, by the memory that decoding takes."""
    each = PIXEL_BYTES.get(picture.mode, OTHER_PIXEL_BYTES)
    if picture.format in ("JPEG", "MPO"):
        if not _has_several_passes(picture):
            return MOST_JPEG_PIXELS
        # the picture itself is decoded at its reduced size
        return min(MOST_DECODED // (COEFFICIENT_BYTES * picture.layers + 1), MOST_JPEG_PIXELS)
    if picture.format in ("HEIF", "AVIF"):
        each += PLANES_BYTES
    if is_mixed:
        each += COPIES_BYTES.get(picture.mode, 0)
    return MOST_DECODED // each


def _has_several_passes(picture):
    """Return whether the decoder of a JPEG keeps all coefficients in memory.

    It does so for a progressive JPEG, and for one whose first pass has not all channels. Only the
    header was read.
    """
    if picture.info.get("progressive"):
        return True
    at = picture.fp.tell()
    picture.fp.seek(2)
    marker, length = _segment(picture.fp)
    while marker[:1] == b"\xff" and marker != START_OF_PASS and length >= 2:
        picture.fp.seek(length - 2, 1)
        marker, length = _segment(picture.fp)
    channels = picture.fp.read(1)
    picture.fp.seek(at)
    return marker != START_OF_PASS or channels != bytes([picture.layers])


def _segment(file):
    """Read the marker of a JPEG's segment, and the number of its bytes without the marker."""
    return file.read(2), int.from_bytes(file.read(2), "big")


def _divisor(size):
    """Return the smallest whole number that, dividing both sides, leaves MOST_PIXELS at most."""
    divisor = max(1, math.isqrt(math.prod(size) // MOST_PIXELS))
    while math.prod(_quotients(size, divisor)) > MOST_PIXELS:
        divisor += 1
    return divisor


def _quotients(size, divisor):
    return tuple(math.ceil(side / divisor) for side in size)


def reduce_size(picture: Image.Image, resampling: Image.Resampling) -> Image.Image:
    """Return a Pillow image, loaded, with MOST_PIXELS at most."""
    divisor = _divisor(picture.size)
    size = _quotients(picture.size, divisor)
    if divisor > 1 and picture.format in ("JPEG", "MPO"):
        draft = next((each for each in DRAFTS if each <= divisor), 1)
        # sides that Pillow divides to find the divisor of its decoder
        width, height = (max(1, side // draft) for side in picture.size)
        picture.draft(picture.mode, (width, height))
    picture.load()
    if picture.size == size or divisor == 1:
        return picture
    info = picture.info
    if resampling != Image.Resampling.NEAREST:
        if picture.mode in ("P", "1", "PA"):  # palettes and two values are not mixed
            picture = picture.convert("L" if picture.mode == "1" else "RGBA")
        elif picture.mode.startswith("I;16"):
            picture = picture.convert("I")
    small = picture.resize(size, resampling)
    small.info = info  # with the colour profile
    return small


def _upright(picture, opened):
    """Return a picture turned upright by the orientation of the opened file.

    It stays as it is if the orientation cannot be read.
    """
    try:
        orientation = opened.getexif().get(ExifTags.Base.Orientation)
    except (OSError, *DAMAGED):  # a sound picture beside damaged metadata
        return picture
    turn = TURNS.get(orientation) if isinstance(orientation, int) else None
    return picture if turn is None else picture.transpose(turn)
