"""Work that is saved to continue later: a zip archive of the photograph, mask and edits.

    work.json               Saved
    photograph.EXT          as it was sent; the program's example is named in work.json instead
    mask.png, regions.png   where the mask is not the photograph's transparency
    edit.json, light.exr    the edit, as learn.app.edit_file writes it
    kept-K/…                the same of each edit that was kept to be compared, K from 1 on

An archive comes from outside: it is read into memory member by member, each bounded before it is
decompressed, and only members of these names are accepted, so that no path leaves the folder.
"""

import re
import struct
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from learn.app import edit_file
from learn.app.choices import Edit
from learn.primitives import PRIMITIVES
from manifests import files, reading
from manifests.errors import InputError

MOST_BYTES = 80 << 20  # of an archive: the largest photograph, its masks and 13 light maps
MOST_UNPACKED = 128 << 20  # bytes of all members
MOST_KEPT = 12
LARGEST_MANIFEST = 1 << 16  # bytes of a work.json
LONGEST_DIRECTORY = 1 << 13  # bytes of an archive's table of members, about 80 each
LONGEST_END = 22 + (1 << 16)  # bytes: the record at an archive's end, and its comment
END_RECORD, ZIP64_LOCATOR = b"PK\x05\x06", b"PK\x06\x07"
MEMBER = re.compile(
    r"work\.json|photograph\.[a-z0-9]{2,5}|mask\.png|regions\.png"
    r"|(kept-([1-9]|1[0-2])/)?(edit\.json|light\.exr)"
)
EXAMPLE = "example:"
REMEDY = "choose a file that “Download” made, NAME-work.zip"


class Saved(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What work.json holds.

    photograph  the file's name as the user knows it, or example:NAME
    refined     whether the photograph was refined
    kept        number of kept edits
    fit_mask    whether the mask's edge is fitted to the photograph, as it always was in files that
                do not say so
    shape       of the object, one of PRIMITIVES; None: predicted
    """

    photograph: Annotated[str, msgspec.Meta(min_length=1, max_length=255)]
    refined: bool
    kept: Annotated[int, msgspec.Meta(ge=0, le=MOST_KEPT)] = 0
    fit_mask: bool = True
    shape: str | None = None


@dataclass(frozen=True)
class Work:
    """Saved work. photograph, mask, regions: files, None where there is none."""

    name: str
    refined: bool
    fit_mask: bool
    shape: str | None
    edit: Edit
    kept: tuple[Edit, ...]
    photograph: Path | None
    mask: Path | None
    regions: Path | None


def write(
    path: Path, folder: Path, saved: Saved, parts: Iterable[Path], edit: Edit, kept: Sequence[Edit]
) -> None:
    """Write an archive.

    folder  for files on the way; it may hold files whose names MEMBER has, which are saved too
    parts   files elsewhere whose names MEMBER has: photograph, mask and regions
    """
    edit_file.write(folder / "edit.json", edit)
    files.write_json(folder / "work.json", msgspec.to_builtins(saved))
    for number, each in enumerate(kept, 1):
        (folder / f"kept-{number}").mkdir()
        edit_file.write(folder / f"kept-{number}" / "edit.json", each)
    made = sorted(each for each in folder.rglob("*") if each.is_file())

    def save(file) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for part in parts:
                archive.write(part, part.name)
            for each in made:
                archive.write(each, each.relative_to(folder).as_posix())

    files.write_with(path, save)


def read(path: Path, folder: Path) -> Work:
    """Return the Work of an archive, whose files are unpacked into an empty folder.

    Raises  InputError: no such archive, a damaged or too large one, other members
    """
    names = _unpack(path, folder)
    for name in ("work.json", "edit.json"):
        if name not in names:
            raise InputError(path, f"saved work, with {name}", "none in it", REMEDY)
    saved = reading.read(folder / "work.json", Saved, LARGEST_MANIFEST)
    if saved.shape is not None and saved.shape not in PRIMITIVES:
        where, rule = f"{folder / 'work.json'}: shape", f"one of {', '.join(PRIMITIVES)}"
        raise InputError(where, rule, f"{saved.shape[:80]!r}", REMEDY)
    # a name, never a path: files for download are named after it
    is_example = saved.photograph.startswith(EXAMPLE)
    name = saved.photograph if is_example else Path(saved.photograph).name
    photographs = [folder / each for each in names if each.startswith("photograph.")]
    if len(photographs) != (0 if is_example else 1) or not name:
        rule = "one photograph"
        raise InputError(path, rule, f"{len(photographs)}", REMEDY)
    edits = [
        edit_file.read(folder / f"kept-{number}" / "edit.json")
        for number in range(1, saved.kept + 1)
    ]
    mask, regions = (
        folder / each if each in names else None for each in ("mask.png", "regions.png")
    )
    return Work(
        name,
        saved.refined,
        saved.fit_mask,
        saved.shape,
        edit_file.read(folder / "edit.json"),
        tuple(edits),
        photographs[0] if photographs else None,
        mask,
        regions,
    )


def _require_short_directory(path: Path) -> None:
    """Refuse an archive whose table of members is long, before zipfile holds the table in memory.

    The table's length is in the record at the archive's end (APPNOTE.TXT, 4.3.16). Archives of the
    64-bit format, which state it elsewhere, are refused: saved work is never as large.
    """
    with path.open("rb") as opened:
        size = opened.seek(0, 2)
        opened.seek(max(0, size - LONGEST_END))
        end = opened.read()
    for place in (match.start() for match in re.finditer(END_RECORD, end)):
        (length,) = struct.unpack_from("<I", end.ljust(place + 22, b"\0"), place + 12)
        if length > LONGEST_DIRECTORY or ZIP64_LOCATOR in end[:place]:
            raise InputError(path, "saved work, of few files", "a long table of files", REMEDY)


def _unpack(path: Path, folder: Path) -> set[str]:
    """Write an archive's members into a folder; return their names. Raises InputError."""
    if path.stat().st_size > MOST_BYTES:
        raise InputError(path, f"at most {MOST_BYTES >> 20} MiB", "more", REMEDY)
    _require_short_directory(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            for member in members:
                known = member.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
                if not MEMBER.fullmatch(member.filename) or member.flag_bits & 1 or not known:
                    other = f"{member.filename[:80]!r} in it"
                    raise InputError(path, "saved work", other, REMEDY)
            total = sum(member.file_size for member in members)
            if total > MOST_UNPACKED or len({m.filename for m in members}) < len(members):
                rule = f"at most {MOST_UNPACKED >> 20} MiB, each file once"
                raise InputError(path, rule, f"{total} bytes", REMEDY)
            for member in members:
                with archive.open(member) as opened:
                    data = opened.read(member.file_size + 1)
                if len(data) != member.file_size:
                    raise zipfile.BadZipFile("another size than it says")
                target = folder / member.filename
                target.parent.mkdir(exist_ok=True)
                files.write_bytes(target, data)
    except (
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,
        EOFError,
        OSError,
        UnicodeDecodeError,  # a name that says it is UTF-8
    ) as error:
        raise InputError(path, "saved work, a zip archive", f"{error}", REMEDY) from None
    return {member.filename for member in members}
