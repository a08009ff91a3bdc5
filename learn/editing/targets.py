"""Target materials as a user names them.

A text is a name of the catalogue, an everyday name such as copper, an expression such as
principled(roughness=.35), a material.json, another picture, or "keep". Labels are (S, 108) natural
logarithms.

A name of the catalogue stands for the surface, whose reflectance is the measured one times the
calibration of its source (manifests.materials): in measured(brass), brass is as it was measured.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from learn.editing import material_expression, material_file
from manifests.described_materials import DESCRIBED
from manifests.errors import InputError
from manifests.material_words import suggestion
from manifests.materials import Material, load_catalogue
from shaders.dsbrdf import SIZE
from shaders.principled_fit import LabelFit

KEEP = "keep"
MEASURED = re.compile(r"measured\(\s*([^()]+?)\s*\)")
LONGEST_STEM = 60  # characters of an expression that a file's name shows


def resolve_labels(
    text: str,
    of_picture: Callable[[Path], np.ndarray],
    known: Mapping[str, np.ndarray] | None = None,
) -> np.ndarray | None:
    """Return the labels (S, 108) float32 of the material that `text` names; None for "keep".

    S is 1 except for a file with several regions.

    of_picture  path → label (1, 108): reads the material of a picture
    known       {name: label (108,)}: a dataset's own materials, which come before the catalogue's
    Raises      InputError: an unknown name (with the closest ones), a file that holds no material
    """
    if text == KEEP:
        return None
    if known and text in known:
        return known[text][None]
    if is_described(text):
        return _fit(text).label.reshape(1, SIZE).astype(np.float32)
    path = Path(text)
    if path.suffix.lower() == ".json":
        return material_file.read(path)
    if is_file(text) or (len(path.suffix) > 1 and path.suffix[1:].isalpha()):
        return of_picture(path)
    return label_of(text)[None]


def label_of(name: str) -> np.ndarray:
    """Return the label (108,) float32 of a described material or one of the catalogue.

    name    of a material, or measured(NAME)
    Raises  InputError for an unknown name
    """
    if name in DESCRIBED:
        return _fit(name).label.reshape(SIZE).astype(np.float32)
    measured = measured_name(name)
    if measured in DESCRIBED:
        remedy = f"{measured} is described: name it alone"
        raise InputError(f"material {name!r}", "a measured material", "none", remedy)
    named = find_material(measured or name)
    label = named.label if measured else named.calibrated_label
    return label.reshape(SIZE).astype(np.float32)


def measured_name(text: str) -> str | None:
    """Return NAME of a text that is measured(NAME); None for any other text."""
    match = MEASURED.fullmatch(text)
    return match and match[1]


def find_material(name: str) -> Material:
    """Return the material of the catalogue. Raises InputError, with close names of all kinds."""
    catalogue = load_catalogue()
    if name not in catalogue:
        remedy = suggestion(name, [*DESCRIBED, *catalogue])
        raise InputError(f"material {name!r}", "a material's name", "none of that name", remedy)
    return catalogue[name]


def is_from_picture(text: str, region: int = 0) -> bool:
    """Return whether a text names a material that was read from a picture.

    It is a picture's file, or a material.json that does not say otherwise of this region.
    """
    if text == KEEP or is_described(text):
        return False
    if Path(text).suffix.lower() == ".json":
        _, from_picture = material_file.read_with_origin(Path(text))
        return from_picture[region if len(from_picture) > 1 else 0]
    return is_file(text)


def is_described(text: str) -> bool:
    """Return whether a text describes a material, or names a described one, and is no file."""
    if measured_name(text) or is_file(text):
        return False
    return text in DESCRIBED or material_expression.is_expression(text)


def _fit(text: str) -> LabelFit:
    """Return the label fitted to a text for which `is_described` is true, with its error."""
    return material_expression.fit_expression(DESCRIBED[text].text if text in DESCRIBED else text)


def fit_errors(texts: Iterable[str]) -> dict[str, float]:
    """Return {text: relative L1 of its label} of all described materials that the texts name."""
    parts = (part for text in texts for part in split_by_region(text))
    return {part: round(_fit(part).error, 4) for part in parts if is_described(part)}


def is_file(text: str) -> bool:
    """Return whether there is a file of that name; a text may be too long for one."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False


def split_by_region(text: str) -> list[str]:
    """Return the texts of each region: "A+B" is split, but not in a file's name or parentheses."""
    return [text] if is_file(text) else re.split(r"\+(?![^()]*\))", text)


def pair_with_regions(
    text: str, labels: Sequence[np.ndarray | None]
) -> list[tuple[str, np.ndarray | None]]:
    """Return (text, label) of each region of a target material as the user named it."""
    named = split_by_region(text)
    texts = named if len(named) == len(labels) else [text] * len(labels)
    return list(zip(texts, labels, strict=True))


def labels_from_pictures(text: str, labels: Sequence[np.ndarray | None]) -> list[np.ndarray]:
    """Return the labels (108,) of a target material that were read from pictures."""
    return [
        label
        for region, (part, label) in enumerate(pair_with_regions(text, labels))
        if label is not None and is_from_picture(part, region)
    ]


def caption_of(text: str) -> str:
    """Return a target material's caption on a contact sheet; files go by their name alone."""
    return "+".join(Path(part).name for part in split_by_region(text))


def file_name(text: str) -> str:
    """Return the part of a file's name that stands for a target material."""
    stems = "+".join(
        part[:LONGEST_STEM] if is_described(part) else Path(part).stem
        for part in split_by_region(text)
    )
    return re.sub(r"[^A-Za-z0-9+_-]+", "-", stems).strip("-") or "material"
