"""Errors in what a user gave, as one line: where, what was expected, what was found, the remedy."""

import difflib
import errno
import os
import re
from collections.abc import Iterable
from pathlib import Path

# packages of the extras that commands need, and the extras that bring them
EXTRAS = {
    "bpy": "factory",
    "trimesh": "factory",
    "psutil": "factory",
    "scipy": "factory",
    "torch": "learn",
    "numba": "factory",
    "safetensors": "learn",
    "skimage": "learn",
    "flip_evaluator": "learn",
    "matplotlib": "learn",
    "gradio": "app",
    "ray": "ray",
    "fsspec": "stores",
    "obstore": "stores",
    "paramiko": "sftp",
}


# errors of the system about a path: what is expected there, what is found (None: the system's own
# words), and the remedy
SYSTEM = {
    errno.EEXIST: ("a folder, or a name for a new one", "a file", "give another name"),
    errno.ENOTDIR: ("a folder on the way to it", "a file", "check the path"),
    errno.EISDIR: ("a file", "a folder", "name a file in it"),
    errno.ENOENT: ("a file or folder of this name", "none", "check the path"),
    errno.EACCES: ("a place that may be used", None, "change its permissions, or name another"),
    errno.EPERM: ("a place that may be used", None, "change its permissions, or name another"),
    errno.EROFS: ("a place that can be written", None, "name another"),
}


class InputError(ValueError):
    """An error in what a user gave: a file, an argument, a value in a data set.

    Its text is one line, "WHERE: expected EXPECTED, found FOUND (REMEDY)", which the command line
    prints; there, `--debug` shows the trace.

    where     the file, record or argument
    expected  what should be there
    found     what is there
    remedy    what to do about it
    """

    def __init__(self, where: object, expected: str, found: str, remedy: str):
        where = _place_as_text(where)
        self.where, self.expected, self.found, self.remedy = where, expected, found, remedy
        super().__init__(printable(f"{where}: expected {expected}, found {found} ({remedy})"))

    def __reduce__(self) -> tuple:  # crosses process borders whole
        return InputError, (self.where, self.expected, self.found, self.remedy)


def _place_as_text(where: object) -> str:
    """Return where an error is as text; a URL that was held as a path has lost a slash."""
    text = str(where)
    if not isinstance(where, Path):
        return text
    text = re.sub(r"^file:/(?=[^/])", "file:///", text)
    return re.sub(r"^(\w[\w+.-]+):/(?=[^/])", r"\1://", text)


def of_system(error: OSError) -> InputError | None:
    """Return an error of the system about a path as an InputError; None for others."""
    if error.filename is None or error.errno not in SYSTEM:
        return None
    expected, result, remedy = SYSTEM[error.errno]
    where = error.filename
    if isinstance(where, bytes):
        where = os.fsdecode(where)
    elif isinstance(where, int):
        where = f"file descriptor {where}"
    return InputError(where, expected, result or str(error.strerror), remedy)


def missing_package(error: ModuleNotFoundError) -> InputError | None:
    """Return the error of a package that an extra brings, or None if no extra does."""
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    extra = EXTRAS[package]
    return InputError(
        package,
        f"a package of the extra {extra}",
        "that it is not installed",
        f"pip install 'brdfactory[{extra}]', or '.[{extra}]' in a checkout",
    )


def printable(text: str) -> str:
    """Return the text as one line that any terminal can show.

    Control characters and unpaired surrogates become escapes.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def closest(name: object, names: Iterable[object], count: int = 3) -> str:
    """Return the known names closest to an unknown one, as text: "did you mean chair, hair?".

    If none is close, the text lists the first few known names.
    """
    near = difflib.get_close_matches(str(name), [str(n) for n in names], n=count, cutoff=0.5)
    if near:
        return f"did you mean {', '.join(near)}?"
    listed = sorted(map(str, names))
    return f"known: {', '.join(listed[:8])}{' …' if len(listed) > 8 else ''}"
