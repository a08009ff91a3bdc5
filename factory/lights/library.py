"""A user's folder of light maps with a list beside them.

lights.json holds licence and source for each name. Maps may be put into the folder by hand too;
their licence is then unknown.
"""

import hashlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from factory.lights import built_in, files
from factory.lights.light import check_map, from_pixels
from manifests.errors import InputError
from manifests.files import npz_bytes, transaction, write_bytes, write_text
from manifests.reading import read
from shaders import envmap

LIST = "lights.json"


def entry(folder: str | Path, name: str) -> dict[str, str]:
    """Return {file, hash, licence, source} of a name in the folder's list, or {} without it."""
    return read_list(folder).get(name, {})


def read_list(folder: str | Path) -> dict[str, dict[str, str]]:
    """Return the folder's list, or {} where there is none. Raises InputError if it is damaged."""
    path = Path(folder) / LIST
    if not os.path.lexists(path):
        return {}
    try:
        return read(path, dict[str, dict[str, str]])
    except InputError as problem:
        remedy = "mend it, or delete it and add the maps again"
        raise InputError(problem.where, problem.expected, problem.found, remedy) from None


def add(path: str | Path, folder: str | Path, licence: str) -> str:
    """Check a map, copy it into the folder and list it; return its name.

    The name is the file's, in lower case with dashes, or the older name of the same map. Raises
    InputError if another map of the folder, or a built-in light, already has the name.
    """
    path, folder = Path(path), Path(folder)
    pixels, digest = files.read(path)
    check_map(pixels, path)
    listed = read_list(folder)
    for name, known in listed.items():
        if known.get("hash") == digest:
            return name
    data = path.read_bytes()
    target = _free(path, path.stem, path.suffix.lower(), folder, listed, data)
    return _place(target, data, licence, path.name, listed)


def add_maps(
    path: str | Path, folder: str | Path, licence: str, known: dict[str, np.ndarray]
) -> Iterator[tuple[str, str, bool]]:
    """Add each map of an .npz as a file of its own.

    Yields (its name in the .npz, the name added or that of the light it repeats, True if added).

    known  {name: L64} of existing lights, to which added ones are added: a second copy of one could
           fall into another split than the first
    """
    folder = Path(folder)
    for inner, pixels in files.maps_in(path):
        L64 = from_pixels(pixels, inner, "", licence, f"{path}: {inner}").L64
        listed, data = read_list(folder), npz_bytes({"L": pixels})
        # a run was killed before it had listed it
        unlisted = _name(inner) not in listed and _holds(folder / f"{_name(inner)}.npz", data)
        if not unlisted and (
            duplicate := next(
                (name for name, L in known.items() if envmap.is_same_source(L64, L)), None
            )
        ):
            yield inner, duplicate, False
            continue
        target = _free(f"{path}: {inner}", inner, ".npz", folder, listed, data)
        name = _place(target, data, licence, f"{Path(path).name}: {inner}", listed)
        known[name] = L64
        yield inner, name, True


def add_made(name: str, pixels: np.ndarray, folder: str | Path, licence: str, source: str) -> None:
    """Write a map (H, 2H, 3) that this program made, as `name`.npz, and list it.

    Raises InputError if the name is taken.
    """
    folder = Path(folder)
    listed, data = read_list(folder), npz_bytes({"L": pixels})
    _place(_free(name, name, ".npz", folder, listed, data), data, licence, source, listed)


def _name(stem):
    """Return the name of a map in a library by the stem of its file."""
    return re.sub(r"[^a-z0-9]+", "-", stem.lower()).strip("-") or "light"


def _free(where, stem, suffix, folder, listed, data):
    """Return the path for the file of a new map. Raises InputError if its name is taken."""
    name = _name(stem)
    if name in listed:
        raise InputError(
            where,
            "a name that is still free",
            f"another map called {name!r} in {folder}",
            "rename the file",
        )
    own = built_in.load(name)
    if own is not None and own.hash != hashlib.sha256(data).hexdigest():
        raise InputError(
            where,
            "a name that is still free",
            f"the built-in light {name!r}",
            "rename the file, or the array of an .npz file",
        )
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / (name + suffix)
    if target.exists() and not _holds(target, data):
        raise InputError(
            target,
            "a name that is still free",
            "an unlisted file of that name",
            "rename one of the two",
        )
    return target


def _holds(path, data):
    """Return whether a file holds these bytes."""
    return path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data


def _place(target, data, licence, source, listed):
    """Write a map's file and its line of the list, both or neither; return the map's name."""
    folder, name = target.parent, target.stem
    digest = hashlib.sha256(data).hexdigest()
    with transaction():
        write_bytes(target, data)
        listed[name] = {"file": target.name, "hash": digest, "licence": licence, "source": source}
        write_text(folder / LIST, json.dumps(listed, indent=1, sort_keys=True) + "\n")
    return name
