"""Where the files of a data set lie in its folder, and the hashes of their bytes."""

import hashlib
import os
import re
from pathlib import Path, PurePosixPath

from manifests.errors import InputError
from manifests.inputs import require_file

NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9._-]+")  # of files: characters that become "-"


def image_path(id_: str) -> str:
    """Return where a record's picture lies in the folder: below the id's first two digits."""
    return f"images/{id_[:2]}/{id_}.exr"


def geometry_path(id_: str) -> str:
    """Return where a shape's normals, depth and segments from one view lie."""
    return f"geometry/{id_[:2]}/{id_}.exr"


def light_path(name: str, hash_: str) -> str:
    """Return where a light's stored 64×128 map lies."""
    return f"lights/{NOT_IN_NAMES.sub('-', name).strip('-.')[:60] or 'light'}-{hash_[:12]}.npz"


def file_hash(path: str | os.PathLike) -> str:
    """Return the sha256 (hex) of a file's bytes.

    Raises  FileNotFoundError; InputError for a folder, a pipe or a device
    """
    if os.path.exists(path):
        require_file(path, "a file")  # opening a pipe would wait for its writer
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def inside(folder: str | os.PathLike, relative: str) -> Path:
    """Return the path of a file that a manifest names.

    Raises  InputError if it is absolute, has "..", or leads out of the folder through a link
    """
    pure = PurePosixPath(relative)
    target = Path(folder) / pure
    escapes = (
        pure.is_absolute()
        or ".." in pure.parts
        or "\\" in relative
        or "\0" in relative
        or not pure.parts
    )
    if escapes or not _leads_inside(target, folder):
        raise InputError(
            f"{folder}: '{relative}'",
            "a path inside the data set's folder",
            "one that leaves it",
            "do not trust this manifest",
        )
    return target


def _leads_inside(target: Path, folder: str | os.PathLike) -> bool:
    """Return whether a path, with links followed, ends inside a folder.

    Links in a circle and names that no file can have do not.
    """
    try:
        return target.resolve().is_relative_to(Path(folder).resolve())
    except (OSError, RuntimeError, ValueError):
        return False


def readable_hash(path: str | os.PathLike) -> str | None:
    """Return the sha256 (hex) of a file's bytes; None if there is nothing that can be read."""
    try:
        return file_hash(path)
    except (OSError, InputError):
        return None
