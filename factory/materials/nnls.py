"""Many small non-negative least-squares problems at once, on their normal equations.

It minimises x·G x − 2 b·x over x ≥ 0 for each of N problems: G (N, K, K), b (N, K).
Block principal pivoting (Kim and Park 2011): all of a problem's wrong signs change sides together;
a problem that does not improve for three rounds changes only its last wrong one, which is known to
terminate.
"""

import numpy as np

RIDGE = 1e-9  # relative, on the diagonal: closures can be nearly the same at some views


def normal_equations(
    columns: np.ndarray, weight: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return G (V, 3, K, K) and b (V, 3, K) of a mixture's weights per view and channel.

    columns  (V, P, K) closures at samples
    weight   (V, 3, P) of squared differences
    target   (V, 3, P) what the weighted sum of the columns should be
    """
    weighted = np.swapaxes(columns[:, None] * weight[..., None], 2, 3)  # (V, 3, K, P)
    return weighted @ columns[:, None], (weighted @ target[..., None])[..., 0]


def solve(G: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the minimisers, and which of their numbers are above 0.

    G (N, K, K) positive semi-definite, b (N, K)
    Returns  x (N, K) ≥ 0, active (N, K) bool
    """
    n, k = b.shape
    scale = 1 / np.sqrt(np.einsum("nkk->nk", G) + 1e-300)
    G = G * scale[:, :, None] * scale[:, None, :] + RIDGE * np.eye(k)
    b = b * scale
    active = np.ones((n, k), bool)
    fewest, patience = np.full(n, k + 1), np.full(n, 3)
    x, todo = np.zeros((n, k)), np.arange(n)
    for _ in range(20 * k):
        x[todo], slope = _on_side(G[todo], b[todo], active[todo])
        wrong = np.where(active[todo], x[todo] < -1e-14, slope < -1e-12)
        count = wrong.sum(1)
        open_ = count > 0
        todo, wrong, count = todo[open_], wrong[open_], count[open_]
        if not len(todo):
            break
        better = count < fewest[todo]
        fewest[todo] = np.minimum(fewest[todo], count)
        patience[todo] = np.where(better, 3, patience[todo] - 1)
        single = patience[todo] < 0
        last = k - 1 - np.argmax(wrong[:, ::-1], axis=1)
        flip = np.where(single[:, None], np.arange(k) == last[:, None], wrong)
        active[todo] ^= flip
    return np.clip(x, 0, None) * scale, active & (x > 0)


def _on_side(G, b, active):
    """Return the solution (N, K) with the inactive held at 0, and the objective's slope there."""
    both = active[:, :, None] & active[:, None, :]
    x = np.linalg.solve(np.where(both, G, np.eye(b.shape[1])), np.where(active, b, 0.0)[..., None])[
        ..., 0
    ]
    return x, np.einsum("nij,nj->ni", G, x) - b
