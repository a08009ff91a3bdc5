"""The rule of learn.data.framing.frame_object, fitted and measured on pictures of known light.

A rendered picture's light has unit mean luminance. Exposed as a camera would expose it, with its
object's 99th percentile at the file's white, it becomes what a user has: values in [0, 1] of
unknown scale. The factor X leads back to radiance; it is estimated from the mean luminance alone:

    log X = log T − D log Y

T: TYPICAL and D: DEPENDENCE of learn.data.photographs; Y: mean luminance of the object in the file,
linear; P pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from learn.data import framing
from learn.data.records import Records
from learn.metrics import bootstrap
from manifests.errors import InputError
from shaders import tone
from shaders.tone import LUMINANCE

FAR = 2.5  # a factor by which a guess misses and an edit is plainly too dark or too bright


def seen(radiance: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Return (Y, X) of a rendered picture.

    Y is the mean luminance of its object in a file, X the factor back to its radiance.

    radiance (H, W, 3), mask (H, W) bool, not empty
    """
    exposure = tone.auto_exposure(radiance, mask)
    return float((np.clip(radiance * exposure, 0, 1)[mask] @ LUMINANCE).mean()), 1 / exposure


def fitted(Y: np.ndarray, X: np.ndarray, groups: list) -> dict[str, list[float]]:
    """Return {"typical": [value, low, high], "dependence": …} of the least-squares line.

    The 95 % interval is over whole groups (learn.metrics.bootstrap.groups_of).
    """
    x, y = np.log(Y), np.log(X)
    ones = np.ones((1, len(x)))
    weights = bootstrap.draws(groups)
    weights = weights[(weights > 0).sum(1) > 1]  # one picture defines no line
    lines = np.concatenate([_lines(x, y, ones), _lines(x, y, weights)])
    low, high = np.percentile(lines[1:], bootstrap.LEVELS, axis=0)
    typical, dependence = ([float(lines[0, k]), float(low[k]), float(high[k])] for k in (0, 1))
    return {
        "typical": [float(np.exp(value)) for value in typical],
        "dependence": [-dependence[0], -dependence[2], -dependence[1]],
    }


def _lines(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return (D, 2) intercepts and slopes of lines through x, y (P,) under weights (D, P)."""
    total = weights.sum(1)
    mean_x, mean_y = weights @ x / total, weights @ y / total
    slope = (weights @ (x * y) / total - mean_x * mean_y) / (weights @ (x * x) / total - mean_x**2)
    return np.stack([mean_y - slope * mean_x, slope], 1)


def missed(Y: np.ndarray, X: np.ndarray, typical: float, dependence: float) -> dict[str, float]:
    """Return how far a rule misses: root mean square of log X as a factor, and share beyond FAR."""
    off = np.log(typical * Y**-dependence / X)
    return {
        "rms_factor": float(np.exp(np.sqrt((off**2).mean()))),
        f"share_beyond_{FAR}": float((np.abs(off) > np.log(FAR)).mean()),
    }


def measured(records: Records) -> tuple[np.ndarray, np.ndarray, list]:
    """Return (Y (P,), X (P,), groups by shape, material and light) of a data set."""
    from manifests.progress import tqdm

    pairs = []
    for record in tqdm(records.records, "exposures", unit="picture", leave=False):
        _, _, segments = records.geometry(record)
        pairs.append(seen(records.image(record), segments > 0))
    rs = records.records
    names = [r.shape for r in rs], ["+".join(r.materials) for r in rs], [r.light for r in rs]
    Y, X = np.array(pairs).T
    return Y, X, bootstrap.groups_of(*names)


def fit_and_check(records: Records, others: Sequence[Records]) -> dict[str, Any]:
    """Return the line fitted on `records`, and how far each rule misses on all data sets.

    The rules are the fitted line, the one in use, and one factor for all.
    """
    names = [each.folder.name for each in (records, *others)]
    if len(set(names)) < len(names):
        raise InputError(
            "--check",
            "folders of other names than --data, and each once",
            ", ".join(names),
            "rename one: rows are named after them",
        )
    Y, X, groups = measured(records)
    if len(Y) < 2:
        raise InputError(records.folder, "two pictures or more", "one", "render more")
    line = fitted(Y, X, groups)
    rules = {
        "fitted": (line["typical"][0], line["dependence"][0]),
        "in use": (framing.TYPICAL, framing.DEPENDENCE),
        "one factor for all": (float(np.exp(np.log(X).mean())), 0.0),
    }
    result: dict[str, Any] = {"line": line, "pictures": len(X), "rules": rules, "missed": {}}
    for folder, (y, x, _) in (
        (records.folder, (Y, X, groups)),
        *((other.folder, measured(other)) for other in others),
    ):
        result["missed"][folder.name] = {
            rule: missed(y, x, *values) for rule, values in rules.items()
        }
    return result
