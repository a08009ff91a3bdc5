"""Reads the CICP code points by which PNG and AVIF name their colours, which Pillow does not read.

Coding-independent code points (ITU-T H.273) are numbers, one of them for the primary colours and
one for the transfer characteristics, the curve. A PNG has them in a chunk `cICP` (PNG, third
edition, 11.3.2.6), an AVIF in a box `colr` of the kind `nclx` (ISO/IEC 14496-12, 12.1.5). Of a
HEIC, pillow-heif reads them.
"""

import struct
from typing import BinaryIO

PNG = b"\x89PNG\r\n\x1a\n"
MOST_PARTS = 1000  # chunks or boxes that are looked at before the picture
MOST_HEADER = 1 << 20  # bytes of an AVIF's box of properties that are read
UNSPECIFIED = 2  # H.273's code point of colours that are not specified


def read_cicp(file: BinaryIO) -> dict[str, int] | None:
    """Return {"color_primaries", "transfer_characteristics"} of a PNG or AVIF, else None.

    The names are pillow-heif's. A damaged file has none.
    """
    try:
        head = file.read(12)
        file.seek(0)
        if head.startswith(PNG):
            numbers = _read_png_chunk(file)
        elif head[4:8] == b"ftyp":
            numbers = _read_avif_box(file)
        else:
            return None
    except (OSError, struct.error):
        return None
    if numbers is None or UNSPECIFIED in numbers:
        return None
    return {"color_primaries": numbers[0], "transfer_characteristics": numbers[1]}


def _read_png_chunk(file):
    """Return the code points of the chunk cICP, which comes before the picture; None without it."""
    file.seek(len(PNG))
    for _ in range(MOST_PARTS):
        size, kind = struct.unpack(">I4s", file.read(8))
        if kind == b"cICP" and size == 4:
            return tuple(struct.unpack("BB", file.read(2)))
        if kind in (b"IDAT", b"IEND"):
            return None
        file.seek(size + 4, 1)
    return None


def _read_avif_box(file):
    """Return the code points of the first colr that has some in an AVIF's box meta, else None."""
    for _ in range(MOST_PARTS):
        size, kind = struct.unpack(">I4s", file.read(8))
        if kind == b"meta":
            box = file.read(min(max(size - 8, 0), MOST_HEADER))
            place = box.find(b"colrnclx")
            return None if place < 0 else struct.unpack_from(">HH", box, place + 8)
        if size < 8:  # to the file's end, or of more than four gigabytes
            return None
        file.seek(size - 8, 1)
    return None
