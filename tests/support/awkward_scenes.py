"""Normals, views, materials and lights made to break a sum of lobes."""

import numpy as np

from shaders.dsbrdf import half_angles
from tests.support.engine_scenes import unit

GROUPS = 500  # materials and lights, at least 2,000 pixels each


SIZE = (4, 8)


def awkward_materials(rng):
    """κ in {0} ∪ [1e-6, 30], γ in [1e-3, 1e5]; half of the materials jump between the extremes from
    one control value to the next.
    """
    m = np.empty((GROUPS, 3, 3, 2, 6))
    m[..., 0, :] = 10.0 ** rng.uniform(-6, np.log10(30), m[..., 0, :].shape)
    m[..., 1, :] = 10.0 ** rng.uniform(-3, 5, m[..., 1, :].shape)
    m[::4] = m[::4, :, :, :, :1]  # constant over θ_d
    m[::5, ..., 0, :] = 0.0
    m[1::2, ..., 0, ::2] = 30.0
    m[1::2, ..., 1, ::2] = rng.choice([1e-3, 1e5], m[1::2, ..., 1, ::2].shape)
    return m.astype(np.float32)


def awkward_lights(rng):
    """Black, one lit texel, up to 1e6, and denormal numbers."""
    light = 10.0 ** rng.uniform(-6, 6, (GROUPS, *SIZE, 3))
    light[::3] *= rng.random((len(light[::3]), *SIZE, 1)) < 0.1
    light[::7] = 0.0
    light[1::7, 2, 3] = 1e6
    light[2::7] = 1e-40
    return light.astype(np.float32)


def awkward_views(rng, w, count):
    """Near a light, opposite to one, or straight: distances from 0 to 0.1."""
    v = w[rng.integers(len(w), size=count)] * rng.choice([-1.0, 1.0], (count, 1))
    v[::3] = (0.0, 0.0, 1.0)
    return unit(
        v
        + rng.normal(size=v.shape)
        * 10.0 ** rng.uniform(-9, -1, (count, 1))
        * (rng.random((count, 1)) < 0.9)
    )


def awkward_normals(rng, w, v):
    """At the silhouette, at the horizon of a light, at the peak of a lobe, at the poles; pixels
    below the horizon are turned over.
    """
    count = len(v)
    light = w[rng.integers(len(w), size=count)]
    n = rng.normal(size=(count, 3))
    kind = rng.integers(5, size=count)[:, None]
    tiny = 10.0 ** rng.uniform(-8, -1, (count, 1))
    n = np.where(kind == 0, np.cross(n, v) + tiny * v, n)
    n = np.where(kind == 1, np.cross(n, light) + tiny * light, n)
    n = np.where(kind == 2, half_angles(light, v)[0] + tiny * n + 1e-9, n)
    n = np.where(kind == 3, np.array([0.0, 1.0, 0.0]) + tiny * v, n)
    n = unit(n)
    return np.where((n * v).sum(1, keepdims=True) < 0, -n, n)
