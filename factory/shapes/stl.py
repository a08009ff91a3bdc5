"""STL: triangles one by one, binary or text; normals, colours and names are ignored.

Source: 3D Systems, "StereoLithography Interface Specification", 1989. A binary file is recognised
by its length, which follows from its count; "solid" may begin both kinds.
"""

import struct
from array import array
from pathlib import Path
from typing import BinaryIO

import numpy as np

from factory.shapes.raw import AGAIN, Raw, glimpse, number, require_count, text_lines
from manifests.errors import InputError

HEAD, TRIANGLE = 84, 50  # bytes
CORNERS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """Return the Raw of an STL file: three vertices for each triangle. See factory.shapes.raw."""
    head = file.read(HEAD)
    announced = struct.unpack("<I", head[80:])[0] if len(head) == HEAD else 0
    if len(head) == HEAD and size == HEAD + TRIANGLE * announced:
        require_count(announced, maximum, where, size)
        triangles = np.frombuffer(file.read(TRIANGLE * announced), CORNERS)
        return _raw(triangles["corners"].astype(float))
    if not head.lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(b"solid"):
        expected = (
            f"{HEAD + TRIANGLE * announced:,} bytes for the {announced:,} triangles its header"
            " announces"
        )
        raise InputError(where, expected, f"{size:,}", "download or export it again")
    require_count(1, maximum, where, size)
    return _raw(_from_text(file, where, maximum))


def _raw(corners):
    return Raw(corners.reshape(-1, 3), np.arange(len(corners) * 3).reshape(-1, 3))


def _from_text(file, where, maximum):
    """Return corners (F, 3, 3) of the triangles of a text file; each solid must have its end."""
    corners, solids, words = array("d"), 0, []
    line = 0
    inside: int | None = None  # corners of the loop that is open
    try:
        for line, text in enumerate(text_lines(file, where, "an STL file's text"), 1):  # noqa: B007 (named in the error)
            words = text.lower().split()
            if not words:
                continue
            if words[0] in (b"solid", b"endsolid"):  # a name follows, of any words
                solids += 1 if words[0] == b"solid" else -1
                if inside is not None or solids not in (0, 1):
                    raise ValueError
                continue
            place = 0
            while place < len(words):
                word = words[place]
                if word == b"loop":
                    inside = 0
                elif word == b"vertex":
                    corners.extend(
                        (
                            number(words[place + 1]),
                            number(words[place + 2]),
                            number(words[place + 3]),
                        )
                    )
                    if inside is None:
                        raise ValueError
                    inside += 1
                    place += 3
                elif word == b"endloop":
                    if inside != 3:
                        raise ValueError
                    inside = None
                    if len(corners) > 9 * maximum:
                        require_count(len(corners) // 9, maximum, where)
                place += 1
    except InputError:
        raise
    except (ValueError, IndexError):
        words_found = glimpse(b" ".join(words))
        raise InputError(
            f"{where}: line {line}",
            "a triangle between 'outer loop' and 'endloop'",
            f"'{words_found}'",
            AGAIN,
        ) from None
    if solids or inside is not None:
        raise InputError(where, "'endsolid' at the end", "none", "download or export it again")
    require_count(len(corners) // 9, maximum, where)
    return np.array(corners, float).reshape(-1, 3, 3)
