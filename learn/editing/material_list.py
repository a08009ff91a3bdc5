"""The materials that a page offers for an edit: their names, families and search words."""

from typing import TYPE_CHECKING

import numpy as np

from learn.editing import targets
from manifests.described_materials import DESCRIBED
from manifests.material_words import ALIKE
from manifests.materials import load_catalogue

if TYPE_CHECKING:
    from learn.editing.edit import EditResult

# everyday words by which people look for a family
FAMILY_WORDS = {
    "fabric": "cloth textile soft",
    "metal": "metallic shiny steel",
    "metallic paint": "car lacquer glitter",
    "paint": "painted lacquer",
    "plastic": "synthetic toy",
    "phenolic": "plastic bakelite billiard glossy",
    "rubber": "soft elastic",
    "leather": "hide cowhide soft",
    "wood": "wooden timber furniture varnish",
    "stone and ceramic": "ceramic mineral rock porcelain",
    "paper": "card matte",
    "colour-changing paint": "color iridescent pearl car",
    "vinyl wrap": "foil car film",
}


def list_materials(result: "EditResult") -> list[dict]:
    """Return name, family, search words and label of each material.

    The materials read from the photograph are first, then those that the user named and that have
    no name of their own, or that a data set has in place of the catalogue's, then the described
    ones, then the catalogue's.
    """
    own = result.decomposition.label
    names = (
        ["own material"] if len(own) == 1 else [f"own material {s + 1}" for s in range(len(own))]
    )
    here = dict(zip(names, own, strict=True))
    catalogue = load_catalogue()
    for edit in result.edits:
        for text, label in targets.pair_with_regions(edit.text, edit.labels):
            if label is None:
                continue
            name = _page_name(text, label)
            if name not in catalogue and name not in DESCRIBED:
                here[name] = label
    materials = [
        {"name": name, "family": "this photograph", "words": "own original", "label": label}
        for name, label in here.items()
    ]
    labels = {name: targets.label_of(name) for name in DESCRIBED}
    labels |= {name: each.calibrated_label.reshape(-1) for name, each in catalogue.items()}
    for name, label in labels.items():
        family = DESCRIBED[name].family if name in DESCRIBED else catalogue[name].family
        alike = " ".join(word for word, names_ in ALIKE.items() if name in names_)
        words = f"{FAMILY_WORDS.get(family, '')} {alike}".strip()
        materials.append({"name": name, "family": family, "words": words, "label": label})
    return materials


def _page_name(text: str, label: np.ndarray) -> str:
    """Return how the page calls a material that the user named by a text.

    A data set's own materials are as measured; their names would stand for calibrated ones here.
    """
    named = text in DESCRIBED or text in load_catalogue()
    if named and not np.array_equal(label, targets.label_of(text)):
        return f"{text} of the data set"
    return targets.caption_of(text)


def chosen_materials(result: "EditResult", materials: list[dict]) -> list[int]:
    """Return the index of each region's material in the first edit; −1: it stays as it is."""
    index = {material["name"]: number for number, material in enumerate(materials)}
    first = result.edits[0]
    return [
        -1 if label is None else index.get(_page_name(text, label), index.get(text, 0))
        for text, label in targets.pair_with_regions(first.text, first.labels)
    ]
