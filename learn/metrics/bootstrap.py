"""95 % intervals of means over pictures whose shapes and materials were drawn, both, from many
more: a two-way bootstrap.

Pictures of one shape, or of one material, err together. So whole shapes and whole materials are
drawn with replacement, and a picture weighs as often as its shape times as often as its material
came up. Intervals over single pictures would be several times too narrow.

P pictures; groups: arrays (P,) of integers 0 … G − 1, one array a way of grouping
"""

import numpy as np

DRAWS = 2000
LEVELS = (2.5, 97.5)


def groups_of(*names):
    """Groups from the names of each picture's shape, material, …: sequences of length P."""
    return [np.unique(np.asarray(each, dtype=str), return_inverse=True)[1] for each in names]


def drawn(rng, groups):
    """Weights (P,) of the pictures in one draw; all may be 0 where pictures are few."""
    weight = np.ones(len(groups[0]))
    for group in groups:
        count = int(group.max()) + 1
        weight = weight * np.bincount(rng.integers(count, size=count), minlength=count)[group]
    return weight


def draws(groups, count=DRAWS, seed=0):
    """Weights (D, P), D ≤ count: draws that kept no picture are left out."""
    rng = np.random.default_rng(seed)
    weights = np.stack([drawn(rng, groups) for _ in range(count)])
    return weights[weights.sum(1) > 0]


def interval(values, weights):
    """[mean, low, high] of values (P,) by weights (D, P) of `draws`."""
    values = np.asarray(values, np.float64)
    means = weights @ values / weights.sum(1)
    return [float(values.mean()), *(float(x) for x in np.percentile(means, LEVELS))]


def relative(a, b, weights):
    """[mean b / mean a, low, high] of values (P,) by weights (D, P) of `draws`; a > 0."""
    a, b = (np.asarray(values, np.float64) for values in (a, b))
    result = (weights @ b) / (weights @ a)
    return [float(b.mean() / a.mean()), *(float(x) for x in np.percentile(result, LEVELS))]


def ratio(a, b, groups, count=DRAWS, seed=0):
    """[mean b / mean a, low, high] of values (P,), or (R, P) of R runs, which are then drawn
    too.
    """
    rng = np.random.default_rng(seed)
    A, B = np.atleast_2d(a), np.atleast_2d(b)
    results = []
    for _ in range(count):
        weight = drawn(rng, groups)
        run = rng.integers(len(A), size=len(A))
        below = (A[run].mean(0) * weight).sum()
        if below > 0:
            results.append((B[run].mean(0) * weight).sum() / below)
    return [float(B.mean() / A.mean()), *(float(x) for x in np.percentile(results, LEVELS))]
