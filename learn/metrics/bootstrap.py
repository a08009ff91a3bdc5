"""95 % intervals of means over pictures, by a bootstrap over shapes, materials and lights.

Pictures of one shape, of one material or under one light err together, and each is a sample of many
more. So whole shapes, whole materials and whole lights are drawn with replacement, and a picture's
weight is the product of the numbers of times that its shape, material and light came up. Intervals
over single pictures would be several times too narrow. A kind of which all pictures share one
cannot be drawn differently: the interval then holds for this one.

P pictures; D draws; groups: arrays (P,) of integers 0 … G − 1, one array for each kind of grouping
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

DRAWS = 2000
LEVELS = (2.5, 97.5)

Groups = Sequence[np.ndarray]


def groups_of(*names: Sequence[str]) -> list[np.ndarray]:
    """Return groups from the names of each picture's shape, material, …: sequences of length P."""
    return [np.unique(np.asarray(each, dtype=str), return_inverse=True)[1] for each in names]


def _drawn(groups: Groups, runs: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (D, P) of the pictures, all 0 in some draws where pictures are few, and runs (D, R).

    All numbers are drawn at once, in the order draw, kind, member.
    """
    sizes = [*(int(group.max()) + 1 for group in groups), runs]
    numbers = np.random.default_rng(0).integers(np.tile(np.repeat(sizes, sizes), (count, 1)))
    weights, start = np.ones((count, len(groups[0]))), 0
    for group, size in zip(groups, sizes, strict=False):  # the runs are last
        at = numbers[:, start : start + size] + size * np.arange(count)[:, None]
        times = np.bincount(at.reshape(-1), minlength=count * size).reshape(count, size)
        weights *= times[:, group]
        start += size
    return weights, numbers[:, start:]


def draws(groups: Groups, count: int = DRAWS) -> np.ndarray:
    """Return weights (D, P) of D ≤ count draws; draws without any picture are left out."""
    weights, _ = _drawn(groups, 0, count)
    return weights[weights.sum(1) > 0]


def draws_of_rows(
    rows: Sequence[Mapping[str, Any]], kinds: Iterable[str], count: int = DRAWS
) -> np.ndarray:
    """Return `draws` of rows with a picture each; kinds: keys of its shape, its material, …"""
    return draws(groups_of(*([row[kind] for row in rows] for kind in kinds)), count)


def interval(values: np.ndarray, weights: np.ndarray) -> list[float]:
    """Return [mean, low, high] of values (P,) by weights (D, P) of `draws`."""
    values = np.asarray(values, np.float64)
    means = weights @ values / weights.sum(1)
    return [float(values.mean()), *(float(x) for x in np.percentile(means, LEVELS))]


def relative(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> list[float]:
    """Return [mean b / mean a, low, high] of values (P,) by weights (D, P) of `draws`; a > 0."""
    a, b = (np.asarray(values, np.float64) for values in (a, b))
    result = (weights @ b) / (weights @ a)
    return [float(b.mean() / a.mean()), *(float(x) for x in np.percentile(result, LEVELS))]


def ratio(a: np.ndarray, b: np.ndarray, groups: Groups, count: int = DRAWS) -> list[float]:
    """Return [mean b / mean a, low, high] of values (P,), or (R, P) of R runs.

    Runs, where there are several, are drawn with replacement too.
    """
    A, B = np.atleast_2d(a), np.atleast_2d(b)
    weights, runs = _drawn(groups, len(A), count)
    below = ((A[0] if len(A) == 1 else A[runs].mean(1)) * weights).sum(1)
    above = ((B[0] if len(B) == 1 else B[runs].mean(1)) * weights).sum(1)
    results = above[below > 0] / below[below > 0]
    return [float(B.mean() / A.mean()), *(float(x) for x in np.percentile(results, LEVELS))]
