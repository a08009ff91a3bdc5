"""Normals and depth as caches of geometry store them: packed into 16-bit numbers."""

import numpy as np

from manifests.arrays import PACKED_RADIUS, PACKED_UNIT


def pack_normals(normals: np.ndarray) -> np.ndarray:
    """Return x and y of normals (…, 3) as (…, 2) int16 in units of 1/32767, as caches store them.

    The normals must face the viewer.
    """
    return np.rint(normals[..., :2] * PACKED_UNIT).astype(np.int16)


def unpack_normals(packed: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return unit normals (…, 3) float32 of packed ones (…, 2); 0 outside the mask (…) bool."""
    xy = packed.astype(np.float32) / PACKED_UNIT
    z = np.sqrt(np.clip(1.0 - (xy * xy).sum(-1, keepdims=True), 0.0, 1.0))
    return np.concatenate([xy, z], -1) * mask[..., None]


def pack_depth(depth: np.ndarray) -> np.ndarray:
    """Return depth (…) in radii as int16 in units of 1/16384, as caches store it; at most 2."""
    return np.rint(np.clip(depth * PACKED_RADIUS, -PACKED_UNIT, PACKED_UNIT)).astype(np.int16)


def unpack_depth(packed: np.ndarray) -> np.ndarray:
    """Return depth (…) float32 in radii of packed depth."""
    return packed.astype(np.float32) / PACKED_RADIUS
