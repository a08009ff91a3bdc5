"""Object File Format: a line of counts, a line per vertex, a line per polygon.

Colours and normals are ignored. Source: Geomview's manual, "OFF Files". COFF and NOFF have colours
or normals behind a vertex's coordinates.
"""

from pathlib import Path
from typing import BinaryIO

from factory.shapes.raw import (
    AGAIN,
    Polygons,
    Raw,
    from_polygons,
    glimpse,
    require_count,
    text_lines,
    whole_number,
)
from manifests.errors import InputError
from manifests.wording import number_of

KINDS = (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF", b"STCOFF", b"STNOFF", b"STCNOFF")


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """Return the Raw of an OFF file. See factory.shapes.raw."""
    rows = _rows(file, where)
    vertex_count, face_count = _counts(rows, where)
    if vertex_count + face_count > size:  # each takes at least a byte
        raise InputError(
            where,
            f"{face_count:,} faces as its header says",
            number_of(size, "byte", form=","),
            "download or export it again",
        )
    require_count(max(face_count, vertex_count // 4) if face_count else 0, maximum, where, size)
    polygons = Polygons()
    line, words = 0, []
    try:
        for _ in range(vertex_count):
            line, words = next(rows)
            polygons.add_vertex(words)
        for _ in range(face_count):
            line, words = next(rows)
            count = whole_number(words[0])
            if not 0 <= count < len(words):
                raise ValueError
            polygons.add_polygon([whole_number(word) for word in words[1 : 1 + count]])
            polygons.require_count(maximum, where)
    except InputError:
        raise
    except StopIteration:
        result = f"the end after {polygons.vertices:,} and {polygons.polygons:,}"
        raise InputError(
            where,
            f"{vertex_count:,} vertices and {face_count:,} faces",
            result,
            "download or export it again",
        ) from None
    except (ValueError, IndexError, OverflowError):
        raise InputError(
            f"{where}: line {line}", "a vertex or face", f"'{glimpse(b' '.join(words))}'", AGAIN
        ) from None
    return from_polygons(*polygons.arrays(), where)


def _rows(file, where):
    """Yield (line number, words) of each line that has words."""
    for line, text in enumerate(text_lines(file, where, "an OFF file's text"), 1):
        if words := text.partition(b"#")[0].split():
            yield line, words


def _counts(rows, where):
    """Return the counts of vertices and faces in the file's head, which has one line or two."""
    _, words = next(rows, (0, []))
    head = list(words)
    if words and words[0] in KINDS and len(words) == 1:
        head += next(rows, (0, []))[1]
    if (
        len(head) < 3
        or head[0] not in KINDS
        or not (head[1].isdigit() and head[2].isdigit() and len(head[1] + head[2]) < 30)
    ):
        raise InputError(
            where,
            "'OFF' and the counts of vertices and faces",
            f"'{glimpse(b' '.join(head))}'",
            AGAIN,
        )
    return int(head[1]), int(head[2])
