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


def _one_draw(rng: np.random.Generator, groups: Groups) -> np.ndarray:
    """Weights (P,) of the pictures in one draw; all may be 0 where pictures are few."""
    weight = np.ones(len(groups[0]))
    for group in groups:
        count = int(group.max()) + 1
        weight = weight * np.bincount(rng.integers(count, size=count), minlength=count)[group]
    return weight


def draws(groups: Groups, count: int = DRAWS) -> np.ndarray:
    """Return weights (D, P) of D ≤ count draws; draws without any picture are left out."""
    rng = np.random.default_rng(0)
    weights = np.stack([_one_draw(rng, groups) for _ in range(count)])
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
    rng = np.random.default_rng(0)
    A, B = np.atleast_2d(a), np.atleast_2d(b)
    results = []
    for _ in range(count):
        weight = _one_draw(rng, groups)
        run = rng.integers(len(A), size=len(A))
        below = (A[run].mean(0) * weight).sum()
        if below > 0:
            results.append((B[run].mean(0) * weight).sum() / below)
    return [float(B.mean() / A.mean()), *(float(x) for x in np.percentile(results, LEVELS))]
