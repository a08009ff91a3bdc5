"""What a user may mean by a material: a name of the catalogue, a material.json, another picture; or
that it stays as it is.

label  (S, 108) natural logarithms
"""

import json
import re
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from learn.data.photographs import MOST_REGIONS
from learn.networks.coding import LARGEST_KAPPA, SMALLEST_LABEL
from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.materials import LARGEST_LABEL, find
from shaders.dsbrdf import SHAPE, SIZE

KEEP = "keep"
LARGEST_JSON = 1 << 20
Label = Annotated[list[float], msgspec.Meta(min_length=SIZE, max_length=SIZE)]
REMEDY = "write one: python -m learn predict PHOTO --out DIR"


def label_of(text, predict, known=None):
    """(S, 108) float32 of what `text` names; S is 1 but for a file with several regions. None for
    "keep".

    predict  path → label (1, 108): takes a picture's material
    known    {name: label (108,)}: a dataset's own materials, before those of the catalogue
    Raises   InputError: a name that is not known (with the closest ones), a file that holds no
    material
    """
    if text == KEEP:
        return None
    if known and text in known:
        return known[text][None]
    path = Path(text)
    if path.suffix.lower() == ".json":
        return _from_json(path)
    if is_file(text) or (len(path.suffix) > 1 and path.suffix[1:].isalpha()):
        return predict(path)
    return find(text).label.reshape(1, SIZE).astype(np.float32)


class MaterialFile(msgspec.Struct, frozen=True):
    """What is read of a material.json. label: of one region; labels: of several, one each."""

    label: Label | None = None
    labels: Annotated[list[Label], msgspec.Meta(min_length=1, max_length=MOST_REGIONS)] | None = (
        None
    )


def _from_json(path):
    """The labels of a material.json, as `learn predict` writes it."""
    require_file(path, "a material.json", REMEDY, LARGEST_JSON)
    try:
        # every number as a float: 10^400 is then infinity, which is out of range, and no error of
        # its own
        values = json.loads(path.read_text(encoding="utf-8"), parse_int=float)
        report = msgspec.convert(values, MaterialFile)
    except (
        msgspec.ValidationError,
        json.JSONDecodeError,
        UnicodeDecodeError,
        RecursionError,
    ) as error:
        rule = f'JSON with "label": {SIZE} numbers'
        raise InputError(path, rule, f"{type(error).__name__}: {error}", REMEDY) from None
    if report.label is None and report.labels is None:
        raise InputError(path, f'JSON with "label": {SIZE} numbers', "none", REMEDY)
    labels = np.asarray(report.labels or [report.label], np.float64)
    within = (labels >= SMALLEST_LABEL) & (labels <= LARGEST_LABEL)  # NaN is not
    if not within.all():
        rule = f"natural logarithms from {SMALLEST_LABEL:g} to {LARGEST_LABEL:g}"
        raise InputError(
            path, rule, f"{labels[~within][0]:g}", "is this m itself? a label holds its logarithms"
        )
    if (kappa := labels.reshape(-1, *SHAPE)[..., 0, :].max()) > LARGEST_KAPPA:
        remedy = "its reflectance is no number any more; check the file"
        raise InputError(path, f"logarithms of κ up to {LARGEST_KAPPA}", f"{kappa:g}", remedy)
    return labels.astype(np.float32)


def is_file(text):
    """Whether there is a file of that name; a text too long for one is none."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False


def parts_of(text):
    """What is wanted of each region: "A+B" parted, but not the name of a file, which may hold a
    plus.
    """
    return [text] if is_file(text) else text.split("+")


def caption_of(text):
    """What a wanted material is called on a sheet: names as they are, of files their own name."""
    return "+".join(Path(part).name for part in parts_of(text))


def file_name(text):
    """What a wanted material's file is called."""
    return (
        re.sub(
            r"[^A-Za-z0-9+_-]+", "-", "+".join(Path(part).stem for part in parts_of(text))
        ).strip("-")
        or "material"
    )
