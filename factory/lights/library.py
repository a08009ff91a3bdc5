"""A user's folder of light maps with a list beside them: lights.json holds licence and source for each name.

Maps may be put into the folder by hand too; then their licence is simply unknown.
"""

import json
import os
import re
import shutil
from pathlib import Path

from factory.lights import files
from factory.lights.light import checked
from manifests.problems import Problem

LIST = "lights.json"


def entry(folder, name):
    """What the folder's list says of a name: {file, hash, licence, source}, or {} if it says nothing."""
    return read_list(folder).get(name, {})


def read_list(folder):
    """The folder's list, {} where there is none. Raises Problem if it is damaged."""
    path = Path(folder) / LIST
    if not path.exists():
        return {}
    try:
        listed = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise Problem(path, "JSON", str(error), "mend it, or delete it and add the maps again") from None
    if not isinstance(listed, dict) or not all(isinstance(value, dict) for value in listed.values()):
        raise Problem(path, "an object with an entry for each name", type(listed).__name__, "delete it and add the maps again")
    return listed


def add(path, folder, licence, source=None):
    """Checks a map, copies it into the folder and lists it; returns its name, or the older name of the same map.

    The name is the file's, in lower case with dashes. Raises Problem if another map already has it
    """
    path, folder = Path(path), Path(folder)
    pixels, digest = files.read(path)
    checked(pixels, path)
    listed = read_list(folder)
    for name, known in listed.items():
        if known.get("hash") == digest:
            return name
    name = re.sub(r"[^a-z0-9]+", "-", path.stem.lower()).strip("-") or "light"
    if name in listed:
        raise Problem(path, "a name that is still free", f"another map called {name!r} in {folder}", "rename the file")
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / (name + path.suffix.lower())
    if target.exists():
        raise Problem(target, "a name that is still free", "an unlisted file of that name", "rename one of the two")
    unfinished = target.with_name(target.name + ".part")
    shutil.copyfile(path, unfinished)
    os.replace(unfinished, target)
    listed[name] = {"file": target.name, "hash": digest, "licence": licence, "source": source or path.name}
    unfinished = folder / (LIST + ".part")
    unfinished.write_text(json.dumps(listed, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    os.replace(unfinished, folder / LIST)
    return name
