"""What geometry files of points hold besides: all that Cycles' shading of a point depends on.

The layer shades the interpolated normals of a geometry file. Cycles also asks for the triangle's
own normal, and for the interpolated one where it faces away from the viewer. It cannot sample a
point, either: its narrowest pixel filter is a bell of 0.0025 pixels, so that next to an edge a
pixel is a mean of two surfaces.

Files that hold one of the channels hold all of them; files of square pixels, of perspective and of
earlier versions hold none. Channels are float32 but for the segment, and 0 in the background.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

NORMALS = ("facet.X", "facet.Y", "facet.Z")
COSINE = "facet.cosine"
SHARE = "other.share"
OTHER_NORMALS = ("other.X", "other.Y", "other.Z")
OTHER_FACETS = ("other.facet.X", "other.facet.Y", "other.facet.Z")
OTHER_SEGMENT = "other.segment"
VECTORS = {
    "triangle's own unit normal": NORMALS,
    "interpolated unit normal of the other surface, which may face away": OTHER_NORMALS,
    "triangle's unit normal of the other surface": OTHER_FACETS,
}
NUMBERS = {
    COSINE: "n·v of the interpolated normal, before it was made to face the viewer",
    SHARE: "part of Cycles' pixel that shows another surface than the point in its middle",
    OTHER_SEGMENT: "segment id of the other surface; 0 where it is the background",
}


class Facets(NamedTuple):
    """The channels as arrays; vectors are in the camera frame.

    normals         (height, width, 3) float32, unit normals of the triangles; they face the viewer
    cosine          (height, width) float32, n·v of the interpolated normals
    share           (height, width) float32, of the pixel that shows another surface
    other_normals   (height, width, 3) float32, interpolated; 0 where share is 0
    other_facets    (height, width, 3) float32
    other_segments  (height, width) uint8, 0 also where the other surface is the background
    """

    normals: np.ndarray
    cosine: np.ndarray
    share: np.ndarray
    other_normals: np.ndarray
    other_facets: np.ndarray
    other_segments: np.ndarray

    def interpolated(self, normals: np.ndarray) -> np.ndarray:
        """Return the interpolated normals (height, width, 3) float32 as they were.

        normals  (height, width, 3) of the file, which were made to face the viewer
        """
        across = normals[..., :2] / np.maximum(
            np.linalg.norm(normals[..., :2], axis=-1, keepdims=True), np.float32(1e-12)
        )
        sine = np.sqrt(np.maximum(1 - self.cosine**2, 0))[..., None]
        leaning = np.concatenate([across * sine, self.cosine[..., None]], axis=-1)
        away = (self.cosine < normals[..., 2])[..., None]
        return np.where(away, leaning, normals).astype(np.float32)


def layers(facets: Facets) -> dict[str, np.ndarray]:
    """Return {channel: (height, width) float32} of Facets, without the segment."""
    vectors = (facets.normals, facets.other_normals, facets.other_facets)
    result = {COSINE: facets.cosine, SHARE: facets.share}
    for names, values in zip(VECTORS.values(), vectors, strict=True):
        result |= dict(zip(names, np.moveaxis(values, -1, 0), strict=True))
    return result


def of_channels(channels: Mapping[str, np.ndarray]) -> Facets:
    """Return the Facets of a file's channels, which must all be there."""
    normals, other_normals, other_facets = (
        np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
        for names in VECTORS.values()
    )
    return Facets(
        normals,
        channels[COSINE].astype(np.float32),
        channels[SHARE].astype(np.float32),
        other_normals,
        other_facets,
        channels[OTHER_SEGMENT].astype(np.uint8),
    )
