"""Distances of two BRDFs: relative L1 of f · cos over the light's hemisphere, per view angle."""

import numpy as np

from shaders import label_model
from shaders.samples import Samples


def metric(measured: np.ndarray, samples: Samples, floor: float = 0.02) -> np.ndarray:
    """Return weights (V, P, 3) of squared differences, all views equal.

    They are cos_i dω / (M + floor·albedo/π) / albedo, so that dark parts count by their relative
    error. They do not depend on f, so that least squares stay linear in a mixture's weights.
    """
    albedo = (samples.measure[..., None] * measured).sum(1, keepdims=True)  # (V, 1, 3)
    weight = (
        samples.measure[..., None]
        / (measured + floor * albedo / np.pi + 1e-5)
        / np.maximum(albedo, 1e-5)
    )
    return weight / len(samples.theta_o)


def reweight(
    measured: np.ndarray,
    nodes: np.ndarray,
    samples: Samples,
    near: float = 0.05,
    floor: float = 0.005,
) -> np.ndarray:
    """Return weights (V, P, 3) under which least squares approach least L1.

    They are cos_i dω / |N − M|, kept away from division by 0 (iteratively reweighted least
    squares).

    measured, nodes  (V, P, 3) values M and N of the last round
    near, floor      shares of M and of albedo/π added to |N − M|
    """
    albedo = (samples.measure[..., None] * measured).sum(1, keepdims=True)
    off = np.abs(nodes - measured) + near * measured + floor * albedo / np.pi + 1e-5
    return samples.measure[..., None] / off / np.maximum(albedo, 1e-5) / len(samples.theta_o)


def relative_l1(f: np.ndarray, reference: np.ndarray, samples: Samples) -> np.ndarray:
    """Return (V,) Σ |f − reference| cos dω / Σ reference cos dω, channels summed.

    f, reference  (V, P, 3)
    """
    weight = samples.measure[..., None]
    return (weight * np.abs(f - reference)).sum((1, 2)) / (weight * reference).sum((1, 2))


def label_values(label: np.ndarray, samples: Samples) -> np.ndarray:
    """Return the BRDF values (V, P, 3) of a label (3, 3, 2, 6), logarithms."""
    return label_model.values(label, *samples.spline())
