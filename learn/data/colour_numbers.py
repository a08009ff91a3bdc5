"""Reads the numbers by which PNG and AVIF name their colours, which Pillow does not read.

They are those of ITU-T H.273: of the primary colours, and of the curve. A PNG has them in a chunk
`cICP` (PNG, third edition, 11.3.2.6), an AVIF in a box `colr` of the kind `nclx` (ISO/IEC
14496-12, 12.1.5). Of a HEIC, pillow-heif reads them.
"""

import struct
from typing import BinaryIO

PNG = b"\x89PNG\r\n\x1a\n"
MOST_PARTS = 1000  # chunks or boxes that are looked at before the picture
MOST_HEADER = 1 << 20  # bytes of an AVIF's box of properties that are read
UNKNOWN = 2  # H.273's number of colours that are not specified


def read_numbers(file: BinaryIO) -> dict[str, int] | None:
    """Return {"color_primaries", "transfer_characteristics"} of a PNG or AVIF, else None.

    The names are pillow-heif's. A damaged file has none.
    """
    try:
        head = file.read(12)
        file.seek(0)
        if head.startswith(PNG):
            numbers = _of_png(file)
        elif head[4:8] == b"ftyp":
            numbers = _of_boxes(file)
        else:
            return None
    except (OSError, struct.error):
        return None
    if numbers is None or UNKNOWN in numbers:
        return None
    return {"color_primaries": numbers[0], "transfer_characteristics": numbers[1]}


def _of_png(file):
    """The numbers of the chunk cICP, which comes before the picture; None without it."""
    file.seek(len(PNG))
    for _ in range(MOST_PARTS):
        size, kind = struct.unpack(">I4s", file.read(8))
        if kind == b"cICP" and size == 4:
            return tuple(struct.unpack("BB", file.read(2)))
        if kind in (b"IDAT", b"IEND"):
            return None
        file.seek(size + 4, 1)
    return None


def _of_boxes(file):
    """The numbers of the first colr of an AVIF's box meta that has some; None without one."""
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
