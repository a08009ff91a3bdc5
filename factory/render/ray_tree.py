"""A shape's triangles in a tree of boxes, and what rays meet of them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

# boxes, first, count and triangles, as factory.render.ray_kernels takes them
Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


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
    def order(self) -> np.ndarray:
        """The faces' numbers (F,) in the order of the tree's triangles."""
        return self._order_and_arrays[0]

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
