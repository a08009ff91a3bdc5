"""A shape's triangles in a tree of boxes, and what rays meet of them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

# boxes, first, count and triangles, as factory.render.ray_kernels takes them
Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class Met(NamedTuple):
    """What rays met: the numbers of faces (R,), −1 where none, and of the others

    distance  (R,) along the ray
    place     (R, 2) shares of the face's second and third corner
    """

    face: np.ndarray
    distance: np.ndarray
    place: np.ndarray


class RayTree:
    """Rays against one shape.

    vertices  (V, 3) float32 in the object's frame
    faces     (F, 3)
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self._corners = vertices[faces].astype(np.float32)
        self.radius = float(np.abs(vertices).max())

    @cached_property
    def _order_and_arrays(self) -> tuple[np.ndarray, Arrays]:
        from factory.render import tree_kernels  # and numba, which takes half a second

        corners, count = self._corners, len(self._corners)
        order = np.arange(count)
        boxes = np.zeros((2 * count, 6), np.float32)
        first, held = np.zeros((2, 2 * count), np.int32)
        nodes = tree_kernels.build_tree(corners.min(1), corners.max(1), order, boxes, first, held)
        edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        triangles = np.concatenate([corners[:, 0], *edges], axis=1)[order]
        return order, (boxes[:nodes].copy(), first[:nodes].copy(), held[:nodes].copy(), triangles)

    @property
    def arrays(self) -> Arrays:
        """The tree and its triangles, for kernels."""
        return self._order_and_arrays[1]

    def are_blocked(self, origins: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Return whether rays (R,) from origins (R, 3) in unit directions (R, 3) meet the shape."""
        from factory.render import ray_kernels

        out = np.zeros(len(origins), bool)
        origins, towards = (np.ascontiguousarray(x, np.float32) for x in (origins, towards))
        ray_kernels.are_blocked(origins, towards, *self.arrays, out)
        return out

    def look(self, origins: np.ndarray, towards: np.ndarray) -> Met:
        """Return what rays from origins (R, 3) in one unit direction (3,) meet first."""
        from factory.render import ray_kernels

        met, places = np.empty(len(origins), np.int32), np.zeros((len(origins), 3), np.float32)
        origins, towards = (np.ascontiguousarray(x, np.float32) for x in (origins, towards))
        ray_kernels.look(origins, towards, *self.arrays, met, places)
        order = self._order_and_arrays[0]
        return Met(np.where(met < 0, -1, order[met]), places[:, 0], places[:, 1:])
