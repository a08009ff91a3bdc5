"""What points of a picture see of a shape, by rays of our own.

Blender renders all pixels of a grid of points. Here only those are looked at that need the points,
which are few where pixels at edges are given many. Normals are those that Cycles shows: the
corners' are interpolated, and turned round with a face whose inner side is seen.
"""

from __future__ import annotations

import numpy as np

from factory.render import camera
from factory.render.geometry import Surface
from factory.render.ray_tree import RayTree
from factory.shapes.mesh import Mesh
from manifests.schema import Camera

AT_ONCE = 1 << 20  # rays in memory, of 60 bytes each


class SeenPoints:
    """The surface of one shape, seen by a distant viewer."""

    def __init__(self, mesh: Mesh, tree: RayTree):
        self._tree, self._segment = tree, mesh.segment
        self._normals = mesh.corner_normals.astype(np.float32)
        corners = mesh.vertices[mesh.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        self._facets = across.astype(np.float32)
        # (F, 3, 3): how far corner j lies above the plane through corner k that its normal has
        rising = np.einsum(
            "fkjc,fkc->fkj", corners[:, None, :] - corners[:, :, None], mesh.corner_normals
        )
        self._rising = rising.astype(np.float32)

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
        height, width = lens.size
        mask = np.zeros((height * across, width * across), bool)
        rotation = camera.camera_from_object(azimuth, lens)
        if where is None:
            where = np.ones(lens.size, bool)
        pixels = np.flatnonzero(where)
        inside = np.indices((across, across)).reshape(2, -1)
        some = max(1, AT_ONCE // across**2)
        parts = [
            self._part(lens, rotation, across, shift, pixels[k : k + some], inside, mask)
            for k in range(0, max(len(pixels), 1), some)
        ]
        # in the order of the grid's rows, as masks have it
        values = [np.concatenate(each) for each in zip(*parts, strict=True)]
        order = np.argsort(values[0], kind="stable")
        return Surface(mask, *(each[order] for each in values[1:]))

    def _part(
        self,
        lens: Camera,
        rotation: np.ndarray,
        across: int,
        shift: tuple[float, float],
        pixels: np.ndarray,
        inside: np.ndarray,
        mask: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """Return numbers of points in the grid, and what they see; the mask is set there.

        pixels  (N,) numbers of pixels in the frame; inside (2, K) points' rows and columns in them
        """
        height, width = lens.size
        rows, columns = (
            (first[:, None] * across + within).ravel()
            for first, within in zip(np.divmod(pixels, width), inside, strict=True)
        )
        step = 2 * lens.half_extent / (max(lens.size) * across)
        x = (columns + 0.5 - width * across / 2 + shift[0]) * step
        y = (height * across / 2 - rows - 0.5 + shift[1]) * step
        away = 2.0 * self._tree.radius
        origins = np.stack([x, y, np.full(len(x), away)], axis=1) @ rotation
        met = self._tree.look(origins, -rotation[2])
        seen = met.face >= 0
        face, place = met.face[seen], met.place[seen]
        mask[rows[seen], columns[seen]] = True
        weights = np.stack([1 - place.sum(1), place[:, 0], place[:, 1]], axis=1)
        normals = np.einsum("pk,pkc->pc", weights, self._normals[face])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.maximum(lengths, 1e-12)
        turn = rotation.T.astype(np.float32)
        facets = self._facets[face] @ turn
        side = np.where(facets[:, 2:] < 0, np.float32(-1), np.float32(1))
        return (
            rows[seen] * (width * across) + columns[seen],
            np.ascontiguousarray(normals @ turn * side, np.float32),
            np.ascontiguousarray(facets * side, np.float32),
            (met.distance[seen] - np.float32(away)).astype(np.float32),
            self._segment[face].astype(np.uint8),
            _lift(self._rising[face] * side[:, :, None], weights) * lengths[:, 0],
        )


def _lift(rising: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return how far smooth surfaces lie above their facets (P,), along the interpolated normal.

    It is half of the height of a parabola through the corners, and at least that of the lowest of
    three planes: those that the corners' normals have, raised until no corner is above them. By
    this Cycles lifts the origins of shadow rays, so that coarse meshes do not shade themselves at
    their edges (shadow_terminator_geometry_offset).

    rising   (P, 3, 3) how far corner j lies above the plane of corner k
    weights  (P, 3) of the corners at the points
    """
    pairs = np.einsum("pk,pj,pkj->p", weights, weights, rising)
    planes = np.maximum(rising.max(2), 0) - np.einsum("pkj,pj->pk", rising, weights)
    return np.maximum(np.maximum(planes, 0).min(1), -pairs / 2).astype(np.float32)
