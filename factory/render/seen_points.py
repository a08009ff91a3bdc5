"""What points of a picture see of a shape, by rays of our own.

Blender renders all pixels of a grid of points. Here only those are looked at that need the points,
which are few where pixels at edges are given many. Normals are those that Cycles shows: the
corners' are interpolated, and turned round with a face whose inner side is seen.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from factory.render import camera
from factory.render.geometry import Surface
from factory.render.ray_tree import RayTree
from factory.shapes.mesh import Mesh
from manifests.schema import Camera


class _Seen(NamedTuple):
    """What points see, as Surface has it."""

    normals: np.ndarray
    facets: np.ndarray
    depth: np.ndarray
    segments: np.ndarray
    lift: np.ndarray


def _empty(count: int) -> _Seen:
    """Return room for what so many points see."""
    normals, facets = np.empty((2, count, 3), np.float32)
    depth, lift = np.empty((2, count), np.float32)
    return _Seen(normals, facets, depth, np.empty(count, np.uint8), lift)


class SeenPoints:
    """The surface of one shape, seen by a distant viewer."""

    def __init__(self, mesh: Mesh, tree: RayTree):
        self._mesh, self._tree = mesh, tree

    @cached_property
    def _faces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Corners' and faces' normals, how far corners rise and segments, in the tree's order."""
        mesh, order = self._mesh, self._tree.order
        corners, normals = mesh.vertices[mesh.faces[order]], mesh.corner_normals[order]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        # (F, 3, 3): how far corner j lies above the plane through corner k that its normal has
        rising = np.einsum("fkjc,fkc->fkj", corners[:, None, :] - corners[:, :, None], normals)
        normals, facets, rising = (
            np.ascontiguousarray(each, np.float32) for each in (normals, across, rising)
        )
        return normals, facets, rising, mesh.segment[order].astype(np.uint8)

    def look(
        self,
        lens: Camera,
        azimuth: float,
        across: int,
        shift: tuple[float, float],
        where: np.ndarray | None = None,
    ) -> Surface:
        """Return what a grid of points sees, `across` of them along each side of a pixel.

        lens     a distant viewer's
        azimuth  of the view, radians
        shift    of the grid, in steps between its points: rightwards, upwards
        where    (height, width) bool, the pixels that are looked at; None: all
        """
        from factory.render import ray_kernels  # and numba, which takes half a second

        height, width = lens.size
        mask = np.zeros((height * across, width * across), bool)
        if where is None:
            where = self._pixels_near(lens, azimuth)
        step = 2 * lens.half_extent / (max(lens.size) * across)
        corner = np.array(
            [
                (0.5 - width * across / 2 + shift[0]) * step,
                (height * across / 2 - 0.5 + shift[1]) * step,
                2.0 * self._tree.radius,
            ],
            np.float32,
        )
        rotation = np.ascontiguousarray(camera.camera_from_object(azimuth, lens), np.float32)
        parts = [_empty(0)]
        for row in np.flatnonzero(where.any(1)):
            columns = np.flatnonzero(where[row])
            written = _empty(len(columns) * across**2)
            seen = ray_kernels.look(
                columns,
                int(row),
                across,
                corner,
                np.float32(step),
                rotation,
                *self._tree.arrays,
                *self._faces,
                mask,
                *written,
            )
            parts.append(_Seen(*(each[:seen].copy() for each in written)))
        return Surface(mask, *(np.concatenate(each) for each in zip(*parts, strict=True)))

    def _pixels_near(self, lens: Camera, azimuth: float) -> np.ndarray:
        """Return the pixels (height, width) bool of the rectangle around the shape."""
        height, width = lens.size
        seen = camera.vertices_from_camera(self._mesh.vertices, azimuth, lens)
        pixels = max(lens.size) / (2 * lens.half_extent)  # per unit
        result = np.zeros(lens.size, bool)
        left, bottom = seen[:, :2].min(0) * pixels
        right, top = seen[:, :2].max(0) * pixels
        rows = slice(max(int(height / 2 - top) - 1, 0), max(int(height / 2 - bottom) + 2, 0))
        columns = slice(max(int(width / 2 + left) - 1, 0), max(int(width / 2 + right) + 2, 0))
        result[rows, columns] = True
        return result
