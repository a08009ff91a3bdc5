"""How far two BRDFs stand apart: relative L1 of f · cos over the light's hemisphere, a view angle
at a time.
"""

import numpy as np

from factory.materials import label_model


def metric(measured, samples, floor=0.02):
    """Weights (V, P, 3) of squared differences: cos_i dω / (M + floor·albedo/π) / albedo, views
    equal.

    Linear in f, so that least squares stay linear in a mixture's weights; dark parts count by their
    relative error.
    """
    albedo = (samples.measure[..., None] * measured).sum(1, keepdims=True)  # (V, 1, 3)
    weight = (
        samples.measure[..., None]
        / (measured + floor * albedo / np.pi + 1e-5)
        / np.maximum(albedo, 1e-5)
    )
    return weight / len(samples.theta_o)


def reweighted(measured, nodes, samples, near=0.05, floor=0.005):
    """Weights (V, P, 3) under which least squares approach least L1 (iteratively reweighted): cos_i
    dω / |N − M|, held off 0.

    measured, nodes  (V, P, 3) values M and N of the last round; near and floor: parts of M and of
    albedo/π added to |N − M|
    """
    albedo = (samples.measure[..., None] * measured).sum(1, keepdims=True)
    off = np.abs(nodes - measured) + near * measured + floor * albedo / np.pi + 1e-5
    return samples.measure[..., None] / off / np.maximum(albedo, 1e-5) / len(samples.theta_o)


def relative_l1(f, reference, samples):
    """(V,): Σ |f − reference| cos dω / Σ reference cos dω, channels summed; f, reference (V, P,
    3).
    """
    weight = samples.measure[..., None]
    return (weight * np.abs(f - reference)).sum((1, 2)) / (weight * reference).sum((1, 2))


def label_values(label, samples):
    """(V, P, 3) of a label (3, 3, 2, 6), logarithms."""
    return label_model.values(label, *samples.spline())
