"""The closures as a model to fit: columns at samples, derivatives, and a first choice among them.

alpha, tilt  (V, K): one width and one tilt per view stop and closure
columns      (V, P, K): closure k at the samples of view v; a mixture is columns · weights (V, K, 3)
"""

from collections.abc import Sequence

import numpy as np

from factory.materials import nnls
from shaders import closures
from shaders.samples import Samples

# what Cycles renders without clamping; Ashikhmin–Shirley ends where its exponent reaches 0
LOG_ALPHA = {
    "diffuse": (0.0, 0.0),
    "ggx": tuple(np.log([0.0025, 1.0])),
    "beckmann": tuple(np.log([0.0025, 1.0])),
    "ashikhmin_shirley": tuple(np.log([0.0035, 0.99])),
    "sheen": tuple(np.log([0.15, 1.0])),
}
# the least is times cos_o: never far away from the viewer at grazing
TILT_MOST, TILT_LEAST = 0.6, -0.3
STEP_ALPHA, STEP_TILT = 0.01, 0.004


def dictionary() -> list[tuple[str, float]]:
    """Return the closures to choose from: (kind, alpha), diffuse first."""
    atoms = [("diffuse", 1.0)]
    atoms += [(kind, a) for kind in ("ggx", "beckmann") for a in np.geomspace(0.003, 1.0, 18)]
    atoms += [("ashikhmin_shirley", a) for a in np.geomspace(0.004, 0.985, 18)]
    return atoms + [("sheen", a) for a in (0.25, 0.5, 0.9)]


def columns(
    kinds: Sequence[str], log_alpha: np.ndarray, tilt: np.ndarray, samples: Samples
) -> np.ndarray:
    """Return the closures (V, P, K) at the samples; log_alpha, tilt (V, K)."""
    parts = [
        (
            closures.evaluate(
                kind, np.exp(log_alpha[:, k, None]), tilt[:, k, None], *samples.cosines
            )
            if np.any(tilt[:, k])
            else closures.CLOSURES[kind](np.exp(log_alpha[:, k, None]), *samples.cosines)
        )
        for k, kind in enumerate(kinds)
    ]
    return np.stack(parts, -1)


def slopes(
    kinds: Sequence[str], log_alpha: np.ndarray, tilt: np.ndarray, samples: Samples, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return finite differences of the columns by log α and by tilt, two arrays (V, P, K).

    Diffuse has no α, and sheen is not tilted.

    at  (V, P, K) the columns
    """
    by_alpha, by_tilt = np.zeros_like(at), np.zeros_like(at)
    for k, kind in enumerate(kinds):
        a, t = log_alpha[:, k, None], tilt[:, k, None]
        if kind != "diffuse":
            step = np.where(a + STEP_ALPHA < LOG_ALPHA[kind][1], STEP_ALPHA, -STEP_ALPHA)
            by_alpha[..., k] = (
                closures.evaluate(kind, np.exp(a + step), t, *samples.cosines) - at[..., k]
            ) / step
        if kind != "sheen":
            step = np.where(t < 0.3, STEP_TILT, -STEP_TILT)
            by_tilt[..., k] = (
                closures.evaluate(kind, np.exp(a), t + step, *samples.cosines) - at[..., k]
            ) / step
    return by_alpha, by_tilt


def bounds(
    kinds: Sequence[str], view_cos: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return lowest and highest log α (K,), and lowest and highest tilt (V, K)."""
    low, high = np.array([LOG_ALPHA[kind] for kind in kinds]).T
    movable = np.array([kind != "sheen" for kind in kinds], float)
    return (
        low,
        high,
        TILT_LEAST * view_cos[:, None] * movable,
        TILT_MOST * np.ones_like(view_cos)[:, None] * movable,
    )


def choose(
    target: np.ndarray, weight: np.ndarray, samples: Samples, count: int
) -> list[list[tuple[str, float]]]:
    """Return a greedy choice from the dictionary for each size 1 … count.

    Each choice is a list of (kind, alpha); each round adds a closure and tries one local swap.

    target (V, P, 3), weight (V, P, 3) of the squared differences
    """
    atoms = dictionary()
    V = len(samples.theta_o)
    A = np.stack([closures.CLOSURES[kind](a, *samples.cosines) for kind, a in atoms], -1)
    G, b = [], []
    for c in range(3):
        weighted = A * weight[..., c, None]
        G.append(np.swapaxes(weighted, 1, 2) @ A)
        b.append(np.einsum("vpk,vp->vk", weighted, target[..., c]))
    G, b = np.concatenate(G), np.concatenate(b)  # (3V, atoms, atoms), (3V, atoms)

    def costs(subsets):
        idx = np.array(subsets)  # (S, k)
        g = G[:, idx[:, :, None], idx[:, None, :]].reshape(-1, idx.shape[1], idx.shape[1])
        y = b[:, idx].reshape(-1, idx.shape[1])
        x, _ = nnls.solve(g, y)
        gain = np.einsum("ni,ni->n", x, 2 * y) - np.einsum("ni,nij,nj->n", x, g, x)
        return -gain.reshape(3 * V, len(subsets)).sum(0)

    chosen: list[int] = []
    sizes: list[list[tuple[str, float]]] = []
    for _ in range(count):
        trials = [[*chosen, j] for j in range(len(atoms)) if j not in chosen]
        cost = costs(trials)
        chosen, least = trials[int(np.argmin(cost))], cost.min()
        swaps = [
            chosen[:i] + chosen[i + 1 :] + [chosen[i] + d]
            for i in range(len(chosen))
            for d in (-1, 1)
            if 0 <= chosen[i] + d < len(atoms)
            and chosen[i] + d not in chosen
            and atoms[chosen[i] + d][0] == atoms[chosen[i]][0]
        ]
        if swaps and (cost := costs(swaps)).min() < 0.999 * least:
            chosen = swaps[int(np.argmin(cost))]
        sizes.append([atoms[j] for j in sorted(chosen)])
    return sizes
