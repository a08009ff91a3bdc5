"""The label as a model to fit: DSBRDF values, derivatives, initialisations, bounds and priors.

label  (3, 3, 2, 6): channel, lobe, (log κ, log γ), spline control values over θ_d
"""

import numpy as np

from shaders.dsbrdf import MAX_EXPONENT
from shaders.samples import Measured
from shaders.spline import greville

LOG_KAPPA, LOG_GAMMA = (-12.0, 2.2), (-4.0, 12.5)
LOW = np.stack([np.full(6, LOG_KAPPA[0]), np.full(6, LOG_GAMMA[0])])  # (2, 6)
HIGH = np.stack([np.full(6, LOG_KAPPA[1]), np.full(6, LOG_GAMMA[1])])

_D2 = np.diff(np.eye(6), 2, axis=0)
ROUGHNESS = _D2.T @ _D2  # (6, 6): squared second differences of one curve's control values


def clip_to_bounds(label: np.ndarray) -> np.ndarray:
    """Return the label with every number inside its bounds."""
    return np.clip(label, LOW, HIGH)


def values(label: np.ndarray, basis: np.ndarray, log_cos_h: np.ndarray) -> np.ndarray:
    """Return f (…, C) of a label (C, 3, 2, 6) at basis (…, 6) and log cos_h (…)."""
    curves = np.exp(label) @ np.moveaxis(basis, -1, 0).reshape(6, -1)  # (C, 3, 2, points)
    exponent = curves[:, :, 0] * np.exp(np.maximum(curves[:, :, 1] * log_cos_h.ravel(), -700.0))
    f = np.expm1(np.minimum(exponent, MAX_EXPONENT)).sum(1)
    return np.moveaxis(f.reshape(-1, *log_cos_h.shape), 0, -1)


def slopes(
    label: np.ndarray, basis: np.ndarray, log_cos_h: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return f (C, points) and its derivatives (C, points, 36) by the label's numbers.

    label (C, 3, 2, 6), basis (points, 6), log_cos_h (points,)
    """
    control = np.exp(label)
    curves = control @ basis.T
    power = np.exp(np.maximum(curves[:, :, 1] * log_cos_h, -700.0))
    exponent = np.minimum(curves[:, :, 0] * power, MAX_EXPONENT)
    growth = np.exp(exponent)
    by_kappa, by_gamma = growth * power, growth * exponent * log_cos_h  # (C, 3, points)
    by_curve = np.moveaxis(np.stack([by_kappa, by_gamma], axis=2), -1, 1)  # (C, points, 3, 2)
    slope = by_curve[..., None] * control[:, None] * basis[:, None, None, :]
    return np.expm1(exponent).sum(1), slope.reshape(len(label), len(log_cos_h), 36)


def initial_labels(source: Measured) -> np.ndarray:
    """Return three initial labels (3, 3, 3, 2, 6) estimated from the data.

    They differ in the share of the peak that each sharp lobe has.

    source  callable (cos_h, cos_d) → f (…, 3)
    """
    theta_d = np.array([0, *greville()[1:5], np.pi / 2 - 0.12])
    theta_h = np.pi / 2 * np.linspace(0, 1, 200) ** 2.5
    f = source(np.cos(theta_h)[:, None], np.cos(theta_d)[None, :])  # (200, 6, 3)
    flank = (theta_h > 0.7) & (theta_h < 1.2)
    base = np.median(f[flank], axis=0) + 1e-5
    peak = np.maximum(f[0] - base, 1e-4)
    excess = f - base

    def half_width(share):
        return np.maximum(theta_h[np.argmax(excess < share * peak, axis=0)], 2e-3)

    labels = []
    for narrow, wide in (
        ((1.0, 0.5), (0.08, 0.05)),
        ((0.7, 0.5), (0.4, 0.2)),
        ((1.0, 0.2), (0.02, 0.02)),
    ):
        lobes = [(np.log(np.log1p(base)), np.full_like(base, np.log(0.2)))]
        for part, share in (wide, narrow):
            kappa = np.log1p(part * peak)
            gamma = np.log(kappa / np.log1p(0.5 * part * peak)) / (half_width(share) ** 2 / 2)
            lobes.append((np.log(kappa), np.log(gamma)))
        # (lobe, 2, 6, channel) → (channel, lobe, 2, 6)
        labels.append(np.moveaxis(np.array(lobes), -1, 0))
    return clip_to_bounds(np.array(labels))


def in_canonical_order(label: np.ndarray) -> np.ndarray:
    """Return the label with its lobes by ascending mean log γ, all three channels together."""
    return label[:, np.argsort(label[:, :, 1].mean((0, 2)), kind="stable")]
