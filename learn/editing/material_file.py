"""material.json: the labels of an object's regions, as `predict`, `edit` and the app write them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import torch

from learn.data.framing import Framed
from learn.data.photographs import MOST_REGIONS
from learn.networks.coding import LARGEST_KAPPA, SMALLEST_LABEL, Ranges
from manifests import files
from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.materials import LARGEST_LABEL, load_catalogue
from shaders.dsbrdf import SHAPE, SIZE

NEAREST = 3  # materials of the catalogue that the file names
LARGEST_JSON = 1 << 20
REMEDY = "write one: python -m learn predict PHOTO --out DIR"
Label = Annotated[list[float], msgspec.Meta(min_length=SIZE, max_length=SIZE)]


class MaterialFile(msgspec.Struct, frozen=True):
    """What is read of a material.json.

    label   of one region
    labels  of several, one each
    read    for each label, whether it was read from a picture; None: all were
    """

    label: Label | None = None
    labels: Annotated[list[Label], msgspec.Meta(min_length=1, max_length=MOST_REGIONS)] | None = (
        None
    )
    read: Annotated[list[bool], msgspec.Meta(min_length=1, max_length=MOST_REGIONS)] | None = None


def read(path: Path) -> np.ndarray:
    """Return the labels (S, 108) float32 of a material.json. Raises InputError."""
    return read_with_origin(path)[0]


def read_with_origin(path: Path) -> tuple[np.ndarray, list[bool]]:
    """Return the labels (S, 108) of a material.json, and for each whether it is from a picture.

    Raises InputError
    """
    require_file(path, "a material.json", REMEDY, LARGEST_JSON)
    rule = f'JSON with "label": {SIZE} numbers'
    try:
        # an integer such as 10^400 becomes infinity, which is refused as out of range; as an int it
        # would raise an error of its own
        values = json.loads(path.read_text(encoding="utf-8"), parse_int=float)
        report = msgspec.convert(values, MaterialFile)
    except (
        msgspec.ValidationError,
        json.JSONDecodeError,
        UnicodeDecodeError,
        RecursionError,
    ) as error:
        raise InputError(path, rule, f"{type(error).__name__}: {error}", REMEDY) from None
    stored = report.labels or ([] if report.label is None else [report.label])
    if not stored:
        raise InputError(path, rule, "none", REMEDY)
    labels = require_label(np.asarray(stored, np.float64), path)
    from_picture = report.read or [True] * len(labels)
    if len(from_picture) != len(labels):
        rule = f'"read" with {len(labels)} values, one for each label'
        raise InputError(path, rule, f"{len(from_picture)}", REMEDY)
    return labels, from_picture


def require_label(labels: np.ndarray, where: object) -> np.ndarray:
    """Return labels (…, 108) as float32, if they are in range. Raises InputError."""
    within = (labels >= SMALLEST_LABEL) & (labels <= LARGEST_LABEL)  # NaN is not
    if not within.all():
        rule = f"natural logarithms from {SMALLEST_LABEL:g} to {LARGEST_LABEL:g}"
        raise InputError(
            where, rule, f"{labels[~within][0]:g}", "is this m itself? a label holds its logarithms"
        )
    if (kappa := labels.reshape(-1, *SHAPE)[..., 0, :].max()) > LARGEST_KAPPA:
        remedy = "its reflectance is no number any more; check the file"
        raise InputError(where, f"logarithms of κ up to {LARGEST_KAPPA}", f"{kappa:g}", remedy)
    return labels.astype(np.float32)


def write(
    path: Path,
    labels: np.ndarray,
    framed: Framed,
    metadata: dict,
    weights: Path,
    were_read: Sequence[bool] | None = None,
) -> None:
    """Write a material.json: labels, the nearest materials, and how the picture was framed.

    labels     (S, 108) of an object's regions
    metadata   of the weights that predicted them
    were_read  for each label, whether it was read from a picture; None: all were
    """
    near = [nearest(label, metadata["ranges"]) for label in labels]
    each = [[round(float(x), 6) for x in label] for label in labels]
    several = len(labels) > 1
    report = (
        {"labels": each, "nearest": near} if several else {"label": each[0], "nearest": near[0]}
    )
    if were_read is not None and not all(were_read):
        report |= {"read": list(were_read)}
    report |= {
        "box": framed.box,
        "exposure": framed.exposure,
        "weights": Path(weights).name,
        "run": metadata["run"].get("name"),
    }
    files.write_json(path, report)


def nearest(label: np.ndarray, ranges: Ranges) -> list[str]:
    """Return names of the catalogue's materials whose codes are nearest to a label's (108,).

    A material has two labels, the nearer of which counts: as it was measured, which pictures of
    data sets show, and calibrated, which photographs show.
    """
    catalogue = load_catalogue()
    names = sorted(catalogue)
    labels = [(catalogue[name].label, catalogue[name].calibrated_label) for name in names]
    codes = ranges.code(torch.from_numpy(np.stack(labels).reshape(len(names), 2, -1)).float())
    distances = ((codes - ranges.code(torch.from_numpy(label))) ** 2).mean(-1)
    return [names[i] for i in distances.amin(1).argsort()[:NEAREST]]
