"""Tells from a file's first bytes whether it is HEIC, and what it is if it is no readable picture.

A file is recognised by its first bytes. Its ending counts only for raw files of cameras, most of
which begin as TIFF files do.
"""

from collections.abc import Callable
from pathlib import Path

HEAD = 512  # bytes
RAW_ENDINGS = (".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".raf", ".rw2")
UNKNOWN = ("another format, or a damaged file", "save it as PNG, JPEG or EXR")
TO_JPEG = "save it as JPEG with the program that shows it"
HEIC_REMEDY = (  # where the package that reads it is not installed
    f"{TO_JPEG}; an iPhone takes JPEG itself after Settings, Camera, Formats, Most Compatible"
)


def _begins(*signs: bytes, at: int = 0) -> Callable[[bytes], bool]:
    return lambda head: head[at:].startswith(signs)


# (whether a file that begins so is one, what it is, what to do about it)
KINDS: tuple[tuple[Callable[[bytes], bool], str, str], ...] = (
    (lambda head: not head, "an empty file", "copy or send it again: nothing of it arrived"),
    (
        lambda head: b"avif" in brands_of(head),
        "AVIF, which the installed Pillow cannot read",
        TO_JPEG,
    ),
    (_begins(b"ftyp", at=4), "a video", "save one of its pictures as PNG or JPEG"),
    (_begins(b"%PDF"), "a PDF", "save the picture in it as PNG or JPEG, or take a screenshot"),
    (_begins(b"%!PS"), "a drawing (PostScript)", "export it as PNG"),
    (_begins(b"8BPS"), "a Photoshop document", "export it as PNG or JPEG"),
    (_begins(b"PK\3\4"), "an archive", "unpack it, and choose a picture in it"),
    (_begins(b"\xff\x0a", b"\0\0\0\x0cJXL "), "JPEG XL", TO_JPEG),
    (_begins(b"P2\n", b"P3\n", b"P5\n", b"P6\n"), "a PPM or PGM", "save it as PNG"),
    (lambda head: b"<svg" in head, "a drawing (SVG)", "export it as PNG"),
    (lambda head: _is_text(head), "a text", "choose a picture, such as a PNG or JPEG"),
)


def brands_of(head: bytes) -> set[bytes]:
    """Return the brands, four letters each, that the first box of an MP4, HEIC or AVIF names."""
    if head[4:8] != b"ftyp":
        return set()
    end = min(len(head), int.from_bytes(head[:4], "big"))
    return {head[8:12], *(head[at : at + 4] for at in range(16, end, 4))}


def is_heic(head: bytes) -> bool:
    """Return whether a file with these first bytes is HEIC; AVIF shares some of its brands."""
    brands = brands_of(head)
    of_kind = {brand for brand in brands if brand[:3] in (b"hei", b"hev")}
    return bool(of_kind | brands & {b"mif1", b"msf1"}) and not brands & {b"avif", b"avis"}


def _is_text(head: bytes) -> bool:
    """Return whether bytes are UTF-8 text, of which the last letter may be cut off."""
    return b"\0" not in head and "\ufffd" not in head.decode("utf-8", "replace")[:-1]


def kind_of(path: str | Path) -> tuple[str, str]:
    """Return what a file is that is no readable picture, and the remedy, both for an InputError."""
    if Path(path).suffix.lower() in RAW_ENDINGS:
        return "a camera's raw file", TO_JPEG
    with open(path, "rb") as file:
        head = file.read(HEAD)
    return next(((kind, remedy) for is_so, kind, remedy in KINDS if is_so(head)), UNKNOWN)
