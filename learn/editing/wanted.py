"""What a user may mean by a material: a name of the catalogue, a material.json, another picture; or that it stays as it is.

label  (S, 108) natural logarithms
"""

import json
import re
from pathlib import Path

import numpy as np

from manifests.materials import LARGEST_LABEL, find
from manifests.problems import Problem
from shaders.dsbrdf import SHAPE, SIZE

KEEP = "keep"
LARGEST_KAPPA = 4.4  # its logarithm: exp of κ itself has to be a number; the catalogue's reach 2.2
SMALLEST_LABEL = -80.0  # its exp is a float32 above 0
LARGEST_JSON = 1 << 20
REMEDY = "write one: python -m learn predict PHOTO --out DIR"


def label_of(text, predict, known=None):
    """(S, 108) float32 of what `text` names; S is 1 but for a file with several regions. None for "keep".

    predict  path → label (1, 108): takes a picture's material
    known    {name: label (108,)}: a dataset's own materials, before those of the catalogue
    Raises   Problem: a name that is not known (with the closest ones), a file that holds no material
    """
    if text == KEEP:
        return None
    if known and text in known:
        return known[text][None]
    path = Path(text)
    if path.suffix.lower() == ".json":
        return _from_json(path)
    if path.is_file() or (len(path.suffix) > 1 and path.suffix[1:].isalpha()):
        return predict(path)
    return find(text).label.reshape(1, SIZE).astype(np.float32)


def _from_json(path):
    """The labels of a material.json, as `learn predict` writes it."""
    try:
        if path.stat().st_size > LARGEST_JSON:
            raise Problem(
                path, f"at most {LARGEST_JSON >> 10} KiB", f"{path.stat().st_size >> 10} KiB", "check that this is the right file"
            )
        told = json.loads(path.read_text(encoding="utf-8"))
        labels = np.asarray(told.get("labels") or [told["label"]], np.float32)
    except FileNotFoundError:
        raise Problem(path, "a material.json", "no such file", REMEDY) from None
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise Problem(path, f'JSON with "label": {SIZE} numbers', f"{type(error).__name__}: {error}", REMEDY) from None
    except ValueError as error:
        if isinstance(error, Problem):
            raise
        raise Problem(path, f'JSON with "label": {SIZE} numbers', str(error), REMEDY) from None
    if labels.ndim != 2 or labels.shape[1] != SIZE:
        raise Problem(path, f"{SIZE} numbers in each label", f"{labels.shape[-1] if labels.ndim else 1}", REMEDY)
    within = (labels >= SMALLEST_LABEL) & (labels <= LARGEST_LABEL)  # NaN is not
    if not within.all():
        rule = f"natural logarithms from {SMALLEST_LABEL:g} to {LARGEST_LABEL:g}"
        raise Problem(path, rule, f"{labels[~within][0]:g}", "is this m itself? a label holds its logarithms")
    if (kappa := labels.reshape(-1, *SHAPE)[..., 0, :].max()) > LARGEST_KAPPA:
        raise Problem(path, f"logarithms of κ up to {LARGEST_KAPPA}", f"{kappa:g}", "its reflectance is no number any more; check the file")
    return labels


def is_file(text):
    """Whether there is a file of that name; a text too long for one is none."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False


def parts_of(text):
    """What is wanted of each region: "A+B" parted, but not the name of a file, which may hold a plus."""
    return [text] if is_file(text) else text.split("+")


def caption_of(text):
    """What a wanted material is called on a sheet: names as they are, of files their own name."""
    return "+".join(Path(part).name for part in parts_of(text))


def file_name(text):
    """What a wanted material's file is called."""
    return re.sub(r"[^A-Za-z0-9+_-]+", "-", "+".join(Path(part).stem for part in parts_of(text))).strip("-") or "material"
