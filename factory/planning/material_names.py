"""The materials that a job names, found in catalogues: "brass", "merl", "merl/test",
"merl/paper-train", "mine/felt".

A set is a catalogue's file: "merl" and "rgl" are built in, a user's own goes by its stem.
"""

from pathlib import Path

from manifests import splits
from manifests.errors import InputError
from manifests.material_words import suggestion
from manifests.materials import BUILT_IN, read_catalogue, require_own_hash

SETS = {"materials": "merl", "materials-rgl": "rgl"}
PARTS = ("train", "test", "paper-train")


def chosen_entries(names, catalogues=()):
    """The catalogues' entries that the names mean, each once, in the order of the names.

    names       of materials, of sets, or SET/PART, SET/NAME
    catalogues  files besides the built-in ones
    Raises      InputError: a name or set that no catalogue has, with the closest ones; a material
    whose hash is not its own
    """
    files = {
        SETS.get(Path(path).stem, Path(path).stem): Path(path) for path in (*BUILT_IN, *catalogues)
    }
    sets = {
        name: read_catalogue(path).materials
        for name, path in files.items()
        if path.exists() or path not in BUILT_IN
    }
    known = {entry.name: entry for result in sets.values() for entry in result}
    chosen = {}
    for name in names:
        set_, _, part = name.partition("/")
        result = _part(sets[set_], part) if set_ in sets else [known[name]] if name in known else []
        if not result:
            every = [*known, *sets, *(f"{s}/{p}" for s in sets for p in PARTS)]
            raise InputError(
                f"material '{name}'",
                "a name or a set in the catalogue",
                "none of that name",
                suggestion(name, every),
            )
        chosen |= {entry.name: entry for entry in result}
    # ids hash it: another label under the same hash would pass for the same pictures
    for entry in chosen.values():
        require_own_hash(entry, "catalogue")
    return list(chosen.values())


def _part(entries, part):
    """All of a set, its training or test part, the paper's 60, or one material."""
    if part == "paper-train":
        names = splits.paper_training([entry.name for entry in entries if entry.split == "train"])
        return [entry for entry in entries if entry.name in names]
    if part in PARTS:
        return [entry for entry in entries if entry.split == part]
    return [entry for entry in entries if part in ("", entry.name)]
