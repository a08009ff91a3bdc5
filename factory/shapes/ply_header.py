"""The header of a PLY file: elements, their properties, and the byte order."""

import re
from codecs import BOM_UTF8
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from factory.shapes.raw import AGAIN, glimpse
from manifests.errors import InputError

TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
}
TYPES |= {
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
}
TYPES |= {"float16": "f2", "float32": "f4", "float64": "f8"}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": None}
MAX_HEADER = 1 << 16  # bytes; real ones have some hundred


@dataclass
class Property:
    """A property of an element.

    type   of each value; count: of a list's length, None for a single value. Both are numpy's names
           without byte order.
    """

    name: str
    type: str
    count: str | None = None


@dataclass
class Element:
    """One kind of rows in the header: vertices, faces, edges."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def place(self, name: str) -> int:
        """Return the index of a property. Raises KeyError."""
        for place, each in enumerate(self.properties):
            if each.name == name:
                return place
        raise KeyError(name)


def read_header(file: BinaryIO, where: str | Path) -> tuple[list[Element], str | None, int]:
    """Return elements, byte order (None: text) and the offset of the data."""
    head = file.read(MAX_HEADER)
    start = len(BOM_UTF8) if head.startswith(BOM_UTF8) else 0
    first = re.search(rb"\r?\n|\r", head)
    newline = b"\r" if first and first[0] == b"\r" else b"\n"
    lines = head[start:].split(newline)
    end = next((k for k, line in enumerate(lines[:-1]) if line.strip() == b"end_header"), None)
    if end is None or lines[0].strip() != b"ply":
        raise InputError(
            where,
            "a PLY header with faces",
            f"'{glimpse(head)}'",
            "check the file's ending, or that it holds more than points",
        )
    elements: list[Element] = []
    order: str | None = "none"
    for place, line in enumerate(lines[1:end], 2):
        words = line.decode("latin-1").split()
        try:
            match words:
                case ["format", name, _]:
                    order = ORDERS[name]
                case ["element", name, count] if (
                    count.isascii() and count.isdigit() and len(count) < 19
                ):
                    elements.append(Element(name, int(count)))
                case ["property", "list", count, type_, name] if TYPES[count][0] in "iu":
                    elements[-1].properties.append(Property(name, TYPES[type_], TYPES[count]))
                case ["property", type_, name]:
                    elements[-1].properties.append(Property(name, TYPES[type_]))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise KeyError
        except (KeyError, IndexError):
            raise InputError(
                f"{where}: line {place}", "a line of a PLY header", f"'{glimpse(line)}'", AGAIN
            ) from None
    if order == "none":
        raise InputError(where, "a PLY header with its format", "none", AGAIN)
    return elements, order, start + sum(len(line) + 1 for line in lines[: end + 1])
