"""MERL .binary files for tests, small but whole."""

import struct

import numpy as np

from factory.materials import merl_binary

SIDES = 12, 9, 6


def write_binary(path, f, sides=SIDES, hole=None):
    """A MERL file of the bivariate f(theta_h, theta_d) → (3,), values at cell centres; hole: an
    index that is not measured.
    """
    n_h, n_d, n_phi = sides
    theta_h = np.pi / 2 * ((np.arange(n_h) + 0.5) / n_h) ** 2
    theta_d = np.pi / 2 * (np.arange(n_d) + 0.5) / n_d
    # (n_h, n_d, 3)
    values = np.array([[f(h, d) for d in theta_d] for h in theta_h]) / merl_binary.SCALE
    cube = np.repeat(np.moveaxis(values, -1, 0)[..., None], n_phi, -1)
    if hole is not None:
        cube[(slice(None), *hole)] = -1
    path.write_bytes(struct.pack("<3i", *sides) + cube.astype("<f8").tobytes())
    return theta_h, theta_d


def smooth(h, d):
    return np.array([1.0 + h, 0.5 + d, 0.2 + h * d])
