"""Random pairs of directions above a surface, and the cosines that closures take."""

import numpy as np


def directions(rng, count=200):
    """Normal (0, 0, 1), light and view above it, and the four cosines."""
    w = rng.normal(size=(2, count, 3))
    w[..., 2] = np.abs(w[..., 2]) + 0.2
    w_i, w_o = w / np.linalg.norm(w, axis=-1, keepdims=True)
    return np.array([0.0, 0.0, 1.0]), w_i, w_o


def cosines(n, w_i, w_o):
    h = w_i + w_o
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    return (
        w_i @ n if n.ndim == 1 else (w_i * n).sum(-1),
        (w_o * n).sum(-1),
        (h * n).sum(-1),
        (h * w_o).sum(-1),
    )
