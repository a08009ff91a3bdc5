"""What one ray through each pixel meets: normals, facets, depth and segments of the shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from factory.render import camera, checks, materials, points, window
from manifests.facets import Facets
from manifests.schema import Camera

# least n·v of a normal: near a coarse mesh's silhouette smooth normals may face away
FACING = 1e-3


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is visible at each pixel's centre, without antialiasing.

    normals   (height, width, 3) float32, camera frame, unit, n·v ≥ 1e-3; 0 outside the mask
    mask      (height, width) bool
    depth     (height, width) float32, distance behind the plane through the object's centre, along
              the optical axis; 0 outside the mask
    segments  (height, width) uint8: 1, 2, …; 0 outside the mask
    facets    of points seen by a distant viewer; None for other cameras
    """

    normals: np.ndarray
    mask: np.ndarray
    depth: np.ndarray
    segments: np.ndarray
    facets: Facets | None = None


class Surface(NamedTuple):
    """What the rays through pixels' centres meet: a mask (height, width), and of its pixels

    normals   (P, 3) float32, camera frame, as they are interpolated: they may lean away
    facets    (P, 3) normals of the facets, with n_z ≥ 0: they face a distant viewer
    depth     (P,) as in Geometry; segments (P,) uint8
    lift      (P,) float32, how far the smooth surface that normals imply lies above the facet; 0
              where it is not known
    """

    mask: np.ndarray
    normals: np.ndarray
    facets: np.ndarray
    depth: np.ndarray
    segments: np.ndarray
    lift: np.ndarray

    def paste(self) -> points.Seen:
        """Return the surface in the frame of its mask."""

        def paste(values: np.ndarray) -> np.ndarray:
            frame = np.zeros((*self.mask.shape, *values.shape[1:]), values.dtype)
            frame[self.mask] = values
            return frame

        return points.Seen(self.mask, paste(self.normals), paste(self.facets), paste(self.segments))


def surface_of(
    passes: dict[str, np.ndarray], mask: np.ndarray, visible: window.Window, lens: Camera
) -> Surface:
    """Return the Surface of the render passes of a scene in which segments emit their ids.

    passes   inside the window `visible`: Normal in the world's frame, Depth, and Combined with the
             segment's id and the facet's x and y, shifted
    mask     (height, width) of the whole frame
    Raises   RuntimeError if normals are not unit: the pixel filter mixes pixels
    """
    top, bottom, left, right = visible
    inside = mask[top:bottom, left:right]
    world, emitted = passes["Normal"][inside], passes["Combined"][inside]
    squares = np.einsum("pi,pi->p", world, world)
    if squares.size and np.abs(squares - 1).max() > 2 * checks.UNIT_TOLERANCE:
        raise RuntimeError(
            "geometry: expected unit normals, found n·n"
            f" {squares.min():.3f}–{squares.max():.3f} (the filter mixes pixels)"
        )
    facets = np.zeros_like(world)
    facets[:, :2] = emitted[:, 1:3] - np.float32(materials.FACET_SHIFT)
    across = np.einsum("pi,pi->p", facets, facets)
    facets[:, 2] = np.sqrt(np.maximum(1 - across, 0))
    return Surface(
        mask,
        normals=world @ camera.camera_from_fixed_world(lens).T.astype(np.float32),
        facets=facets,
        depth=passes["Depth"][inside][:, 0] - np.float32(camera.distance(lens)),
        segments=np.rint(emitted[:, 0]).astype(np.uint8),
        lift=np.zeros(len(world), np.float32),
    )


def facets_of(at: Surface, around: Sequence[Surface]) -> Facets:
    """Return the Facets of points; around: the surfaces at the places of points.offsets()."""
    centre = at.paste()
    shares, others = points.others(centre, [each.paste() for each in around])
    return Facets(
        centre.facets,
        centre.normals[..., 2],
        shares,
        np.stack([other.normals for other in others]),
        np.stack([other.facets for other in others]),
        np.stack([other.segments for other in others]),
    )


def turn_to_viewer(normals: np.ndarray, view: np.ndarray | None) -> np.ndarray:
    """Return normals (P, 3) with n·v ≥ FACING: others are moved to the nearest such unit vector.

    view  (P, 3) from surface to camera, camera frame; None: (0, 0, 1)
    """
    cosine = normals[:, 2] if view is None else np.einsum("pi,pi->p", normals, view)
    (away,) = np.nonzero(cosine < FACING)
    v = np.array([0.0, 0.0, 1.0], np.float32) if view is None else view[away]
    flat = normals[away] - cosine[away, None] * v  # the part across the view
    flat /= np.maximum(np.linalg.norm(flat, axis=-1, keepdims=True), np.float32(1e-12))
    normals[away] = np.float32(np.sqrt(1 - FACING**2)) * flat + np.float32(FACING) * v
    return normals
