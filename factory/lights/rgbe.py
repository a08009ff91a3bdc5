"""Radiance's .hdr pictures: four bytes per pixel with a shared exponent e.

value = mantissa · 2^(e − 136), 0 where e = 0. A scanline is flat, old-style (a pixel 1 1 1 n
repeats the one before n times, successive ones shift n by 8 bits), or new-style (2 2 and the width
in two bytes, then each of the four components by itself: a count above 128 repeats one byte count
− 128 times, another is followed by that many bytes). Source: Greg Ward, "Real Pixels", Graphics
Gems II. Radiance itself adds ½ to the mantissa; Blender, whose picture this must be, does not (a
test compares the two).
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from manifests.errors import InputError

MAX_HEADER = 64 * 1024  # bytes; real headers hold a few hundred
ROWS = 64  # scanlines that are unpacked together
PIECE = 1 << 22  # bytes of the file that are read at once
# bytes per pixel of a scanline: each pixel by itself, and four repeats of no length (the old style)
LONGEST = 20
REMEDY = "export the map again as Radiance .hdr or OpenEXR"


def read(path: Path, check_size: Callable[[int, int, int], None]) -> np.ndarray:
    """Return the pixels (H, W, 3) float32 of a Radiance file.

    check_size  function of (height, width, bytes needed) that raises InputError before memory is
                taken for a picture that is too large
    Raises      InputError

    It takes the memory of the picture, of ROWS scanlines and of PIECE bytes of the file.
    """
    with open(path, "rb") as file:
        data = file.read(MAX_HEADER)
        start, height, width, exposure = _header(data, path)
        check_size(height, width, height * width * 12)
        size = path.stat().st_size
        # a pixel and its repeats: the shortest scanline there is
        if size - start < height * min(8, 4 * width):
            raise _truncated_file_error(path, f"{size} bytes for {width}×{height} pixels")
        pixels = np.empty((height, width, 3), np.float32)
        longest = LONGEST * width + 4  # bytes of a scanline
        for first in range(0, height, ROWS):
            bytes_ = np.empty((min(ROWS, height - first), width, 4), np.uint8)
            for row, each in enumerate(bytes_, first):
                if len(data) - start < longest:
                    data, start = data[start:] + file.read(PIECE + longest), 0
                start = _scanline(data, start, each, path, row)
            scale = np.ldexp(np.float32(1.0), bytes_[..., 3].astype(np.int32) - 136)
            scale[bytes_[..., 3] == 0] = 0.0
            # values beyond float32 are infinite, and refused later, by count
            with np.errstate(over="ignore"):
                pixels[first : first + ROWS] = (
                    bytes_[..., :3] * scale[..., None] / np.float32(exposure)
                )
    return pixels


def _header(data, path):
    """Return the offset of the pixels, height, width, and the product of EXPOSURE lines.

    The pixels were multiplied by that product.
    """
    end = data.find(b"\n\n", 0, MAX_HEADER)
    line_end = data.find(b"\n", end + 2, end + 2 + 100)
    if end < 0 or line_end < 0:
        raise _truncated_file_error(path, "no end of the header")
    lines = data[:end].decode("latin-1").splitlines()
    wrong = [
        line
        for line in lines
        if line.startswith("FORMAT=") and line.strip() != "FORMAT=32-bit_rle_rgbe"
    ]
    if wrong:
        raise InputError(path, "FORMAT=32-bit_rle_rgbe", wrong[0].strip(), REMEDY)
    size = re.fullmatch(rb"-Y (\d{1,9}) \+X (\d{1,9})\s*", data[end + 2 : line_end])
    if not size or not int(size[1]) or not int(size[2]):
        result = data[end + 2 : line_end].decode("latin-1").strip()
        raise InputError(path, "the size as '-Y height +X width'", repr(result), REMEDY)
    exposure = 1.0
    for line in lines:
        if line.startswith("EXPOSURE="):
            exposure = _positive(exposure * _positive(line.partition("=")[2], path), path)
    return line_end + 1, int(size[1]), int(size[2]), exposure


def _positive(text, path):
    """Return a positive number by which float32 can be divided. Raises InputError otherwise."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1e-30 < value < 1e30:
        raise InputError(
            path, "EXPOSURE= with a positive number", repr(str(text).strip())[:80], REMEDY
        )
    return value


def _truncated_file_error(path, found):
    return InputError(
        path,
        "a whole Radiance picture",
        f"the file ends early ({found})",
        "download or export it again",
    )


def _scanline(data, start, row, path, number):
    """Fill row (width, 4) from the bytes at `start`; return the offset of the next scanline."""
    width = row.shape[0]
    head = data[start : start + 4]
    new = 8 <= width < 32768 and head[:2] == b"\x02\x02" and len(head) == 4 and head[2] < 128
    if new and head[2] * 256 + head[3] != width:
        raise InputError(
            path,
            f"scanline {number} of {width} pixels",
            f"one of {head[2] * 256 + head[3]}",
            REMEDY,
        )
    try:
        return _new_style(data, start + 4, row) if new else _old_style(data, start, row)
    except IndexError:
        raise _truncated_file_error(path, f"within scanline {number} of {width} pixels") from None
    except OverflowError:
        raise InputError(
            path, f"scanline {number} of {width} pixels", "a run that is longer", REMEDY
        ) from None


def _new_style(data, start, row):
    width = row.shape[0]
    for component in range(4):
        line = bytearray()
        while len(line) < width:
            count = data[start]
            if count > 128:
                line += data[start + 1 : start + 2] * (count - 128)
                start += 2
            else:
                if count == 0:
                    raise OverflowError
                line += data[start + 1 : start + 1 + count]
                start += 1 + count
            if start > len(data):
                raise IndexError
        if len(line) > width:
            raise OverflowError
        row[:, component] = np.frombuffer(line, dtype=np.uint8)
    return start


def _old_style(data, start, row):
    width = row.shape[0]
    flat = data[start : start + 4 * width]
    if len(flat) == 4 * width and b"\x01\x01\x01" not in flat:
        row[:] = np.frombuffer(flat, dtype=np.uint8).reshape(width, 4)
        return start + 4 * width
    column, shift = 0, 0
    while column < width:
        pixel = data[start : start + 4]
        if len(pixel) < 4:
            raise IndexError
        start += 4
        if pixel[:3] == b"\x01\x01\x01":
            count = pixel[3] << shift
            if column == 0 or column + count > width:
                raise OverflowError
            row[column : column + count] = row[column - 1]
            column, shift = column + count, shift + 8
            if shift > 24:
                raise OverflowError
        else:
            row[column] = np.frombuffer(pixel, dtype=np.uint8)
            column, shift = column + 1, 0
    return start
