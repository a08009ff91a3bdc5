"""The materials that a job's names mean: "brass", "merl", "merl/test", "mine/felt".

A set is a catalogue's file: "merl" and "rgl" are built in, and the set of a user's own file is
named by the file's stem. "merl/paper-train" means as many training materials as the paper had.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from manifests import splits
from manifests.errors import InputError
from manifests.material_words import suggestion
from manifests.materials import BUILT_IN, Entry, read_catalogue, require_own_hash

SETS = {"materials": "merl", "materials-rgl": "rgl"}
PARTS = ("train", "test", "paper-train")


def choose_entries(names: Iterable[str], catalogues: Sequence[str | Path] = ()) -> list[Entry]:
    """Return the catalogue entries that the names mean, each once, in the order of the names.

    names       of materials or sets, or SET/PART, or SET/NAME
    catalogues  files besides the built-in ones
    Raises      InputError: a name that no catalogue has, with the closest ones, or that two
                catalogues have for different materials; a material whose hash is not that of its
                label and mixture
    """
    files = _files(catalogues)
    sets = {
        name: read_catalogue(path).materials
        for name, path in files.items()
        if path.exists() or path not in BUILT_IN
    }
    known = {entry.name: entry for result in sets.values() for entry in result}
    chosen: dict[str, Entry] = {}
    for name in names:
        set_, _, part = name.partition("/")
        if name not in sets:
            _require_one(name, sets)
        result = _part(sets[set_], part) if set_ in sets else [known[name]] if name in known else []
        if not result:
            if "(" in name:
                raise InputError(
                    f"material '{name}'",
                    "a name or a set in the catalogue, since Cycles needs nodes that were fitted",
                    "a description, which only brdfactory edit takes",
                    "python -m factory materials add fits a measured material: docs/own-assets.md",
                )
            every = [*known, *sets, *(f"{s}/{p}" for s in sets for p in PARTS)]
            raise InputError(
                f"material '{name}'",
                "a name or a set in the catalogue",
                "none of that name",
                suggestion(name, every),
            )
        for entry in result:
            if chosen.setdefault(entry.name, entry).hash != entry.hash:
                raise InputError(
                    f"material '{entry.name}'",
                    "one material of a name",
                    f"another in {set_}",
                    "rename one of them in its catalogue",
                )
    # ids are computed from the hash: another label with the same hash would get the same ids
    for entry in chosen.values():
        require_own_hash(entry, "catalogue")
    return list(chosen.values())


def _require_one(name: str, sets: Mapping[str, Sequence[Entry]]) -> None:
    """Raise InputError for a name that catalogues have for different materials."""
    having = {set_: e.hash for set_, entries in sets.items() for e in entries if e.name == name}
    if len(set(having.values())) > 1:
        each = [f"{set_}/{name}" for set_ in having]
        raise InputError(
            f"material '{name}'",
            "a name that one catalogue has",
            f"different materials in {' and '.join(having)}",
            f"name one: {' or '.join(each)}",
        )


def _files(catalogues: Sequence[str | Path]) -> dict[str, Path]:
    """Return {set: file} of the built-in catalogues and a user's.

    Raises  InputError: two files, which would make one set
    """
    files = {SETS.get(path.stem, path.stem): path for path in BUILT_IN}
    for path in map(Path, catalogues):
        known = files.setdefault(path.stem, path)
        if known.resolve() != path.resolve():
            raise InputError(
                f"--catalogue {path}",
                "a set of materials of its own name, which is that of the file",
                f"'{path.stem}' of {known}, too",
                "rename one of the files",
            )
    return files


def _part(entries: Sequence[Entry], part: str) -> list[Entry]:
    """Return all of a set, its training or test part, the paper's 60, or one material."""
    if part == "paper-train":
        names = splits.paper_training([entry.name for entry in entries if entry.split == "train"])
        return [entry for entry in entries if entry.name in names]
    if part in PARTS:
        return [entry for entry in entries if entry.split == part]
    return [entry for entry in entries if part in ("", entry.name)]
