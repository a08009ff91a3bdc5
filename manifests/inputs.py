"""Checks of input files before they are opened, so that no command hangs or fills memory."""

import hashlib
import os
import re
import stat
from collections.abc import Callable
from pathlib import Path

from manifests.errors import InputError
from manifests.wording import number_of

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def require_file(
    path: str | os.PathLike,
    expected: str,
    remedy: str | Callable[[], str] = "check the path",
    maximum_bytes: int | None = None,
) -> Path:
    """Return the path, if an ordinary file of bounded size lies there.

    expected       what should lie there, with its article: "a mesh file"
    remedy         what to do if there is no such file, or a function that says it: to look for
                   similar names among thousands of files takes a while
    maximum_bytes  size above which the file is refused unread; None: any size
    Raises         InputError: missing, a folder, a pipe, a device, a socket, a name that no file
                   can have, links in a circle, no permission, too large
    """
    try:
        status = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(path, expected, "no such file", _text(remedy)) from None
    except ValueError:  # a NUL inside
        raise InputError(
            repr(str(path)), expected, "a name that no file can have", _text(remedy)
        ) from None
    except OSError as error:  # a circle of links, no permission, a name too long
        cause = str(error.strerror or error).lower()
        raise InputError(path, expected, cause, _text(remedy)) from None
    if (result := kind_of(status.st_mode)) is not None:
        hint = "name a file in it" if result == "a folder" else "save it as a file first"
        raise InputError(path, expected, result, hint)
    if maximum_bytes is not None and status.st_size > maximum_bytes:
        bound, size = _size(maximum_bytes), _size(status.st_size)
        raise InputError(
            path, f"{expected} of at most {bound}", size, "check that this is the right file"
        )
    return Path(path)


def split_path(
    place: str, marks: str = "#?", folder: str | os.PathLike | None = None
) -> tuple[str, str]:
    """Return the path of a place such as "PATH#MEMBER?key=value", and the rest, which may be "".

    A mark may be part of the path. So the path is the longest beginning of the place that exists
    and is followed by a mark or by nothing. If none exists, it ends before the first mark.

    marks   characters that may follow a path
    folder  where a relative path starts; None: the working folder
    """
    ends = [len(place), *(match.start() for match in re.finditer(f"[{re.escape(marks)}]", place))]
    ends = [end for end in sorted(ends, reverse=True) if end]
    there = (end for end in ends if os.path.exists(os.path.join(folder or "", place[:end])))
    end = next(there, ends[-1] if ends else 0)
    return place[:end], place[end:]


def require_hash(path: str | os.PathLike, data: bytes | None, expected: str | None) -> None:
    """Raise InputError if a file's sha256 is not the one that a manifest holds.

    data      the file's bytes, and `expected` the hash; None of either: nothing is checked
    """
    if expected is None or data is None:
        return
    if (result := hashlib.sha256(data).hexdigest()) != expected:
        raise InputError(
            path,
            f"hash {expected[:12]}",
            f"{result[:12]}: the file was altered",
            "render or copy it again",
        )


def _text(remedy: str | Callable[[], str]) -> str:
    """Return a remedy as text."""
    return remedy if isinstance(remedy, str) else remedy()


def kind_of(mode: int) -> str | None:
    """Return what a mode of `os.stat` means, with its article; None for an ordinary file."""
    if stat.S_ISREG(mode):
        return None
    return next((name for test, name in _KINDS if test(mode)), "something else")


def _size(count: int) -> str:
    """Return a number of bytes in a readable unit."""
    if count < 1024:
        return number_of(count, "byte")
    amount, unit = count / 1024, "KiB"
    for larger in ("MiB", "GiB"):
        if amount >= 1024:
            amount, unit = amount / 1024, larger
    return f"{amount:.1f} {unit}"
