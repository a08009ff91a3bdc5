"""The fit of a label to a measured material alone, channel by channel, before the joint fit."""

import numpy as np

from shaders import label_model
from shaders.samples import Samples

# towards the start, and against second differences; relative to the target's weighted square
PRIOR, SMOOTH = 1e-5, 1e-5


def fit(
    target: np.ndarray,
    weight: np.ndarray,
    samples: Samples,
    initial: np.ndarray,
    tries: int = 12,
    iterations: int = 60,
) -> np.ndarray:
    """Return the label (3, 3, 2, 6) of least weighted squared difference.

    Every initialisation is descended for `tries` iterations, the best one for `iterations` more.

    target, weight  (V, P, 3);  initial (S, 3, 3, 2, 6)
    """
    basis, log_cos_h = samples.spline()
    points = basis.reshape(-1, 6), log_cos_h.ravel()
    label = np.empty(initial.shape[1:])
    for c in range(3):
        channel = target[..., c].ravel(), weight[..., c].ravel()
        first = [_descend(start[c], *channel, *points, tries) for start in initial]
        best = min(first, key=lambda result: result[1])[0]
        label[c] = _descend(best, *channel, *points, iterations)[0]
    return label


def _descend(start, target, weight, basis, log_cos_h, iterations):
    """Return one channel (3, 2, 6) after Levenberg–Marquardt, and its cost."""
    root = np.sqrt(weight / max((weight * target**2).sum(), 1e-12))
    regular = np.kron(np.eye(6), SMOOTH * label_model.ROUGHNESS + PRIOR * np.eye(6))

    def penalty_slope(p):
        return (
            PRIOR * (p - start).ravel() + SMOOTH * (p.reshape(6, 6) @ label_model.ROUGHNESS).ravel()
        )

    def cost(p, f):
        curves = p.reshape(6, 6)
        rough = SMOOTH * np.einsum("ci,ij,cj->", curves, label_model.ROUGHNESS, curves)
        return ((root * (f - target)) ** 2).sum() + PRIOR * ((p - start) ** 2).sum() + rough

    p = label_model.clip_to_bounds(start)
    f, slope = label_model.slopes(p[None], basis, log_cos_h)
    least, damping, idle = cost(p, f[0]), 1e-2, 0
    for _ in range(iterations):
        J = slope[0] * root[:, None]
        H, g = J.T @ J + regular, J.T @ (root * (f[0] - target)) + penalty_slope(p)
        for _ in range(9):
            step = np.linalg.solve(H + np.diag(damping * np.diag(H) + 1e-10), -g)
            q = label_model.clip_to_bounds(p + np.clip(step, -2, 2).reshape(p.shape))
            f_q = label_model.values(q[None], basis, log_cos_h)[..., 0]
            if (c := cost(q, f_q)) < least:
                break
            damping *= 4
        else:
            break
        idle = idle + 1 if least - c < 1e-4 * least else 0
        p, least, damping = q, c, max(damping / 5, 1e-7)
        if idle > 3:
            break
        f, slope = label_model.slopes(p[None], basis, log_cos_h)
    return p, least
