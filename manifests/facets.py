"""What geometry files of points hold besides: all that Cycles' shading of a point depends on.

The layer shades the interpolated normals of a geometry file. Cycles also asks for the triangle's
own normal, and for the interpolated one where it faces away from the viewer. It cannot sample a
point, either: its narrowest pixel filter is a bell of 0.0025 pixels, so that next to an edge a
pixel is a mean of several surfaces. On meshes that people made, small bevels that are seen edge-on
show a dozen normals of three facets within it.

Files that hold one of the channels hold all of them; files of square pixels and of perspective hold
none. Those of earlier versions hold none or others, which are not read. Channels are float32 but
for the segment, and 0 in the background. Where a name has a K, there is one channel for each K from
1 to OTHERS.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

# surfaces besides the point's: with 3, two of three bad pixels were off by 17 and 33 display values
# from the mean of all 32 points; with 7, none by more than 2 (docs/log.md, 2026-11-25)
OTHERS = 7
NORMALS = ("facet.X", "facet.Y", "facet.Z")
COSINE = "facet.cosine"
SHARE = "other.K.share"
OTHER_NORMALS = ("other.K.X", "other.K.Y", "other.K.Z")
OTHER_FACETS = ("other.K.facet.X", "other.K.facet.Y", "other.K.facet.Z")
OTHER_SEGMENT = "other.K.segment"
OF_OTHERS = (SHARE, *OTHER_NORMALS, *OTHER_FACETS, OTHER_SEGMENT)
VECTORS = {
    "triangle's own unit normal": NORMALS,
    "interpolated unit normal of another surface, which may face away": OTHER_NORMALS,
    "triangle's unit normal of that surface": OTHER_FACETS,
}
NUMBERS = {
    COSINE: "n·v of the interpolated normal, before it was made to face the viewer",
    SHARE: "part of Cycles' pixel that shows this surface and not the one at its centre",
    OTHER_SEGMENT: "segment id of that surface; 0 where it is the background",
}


class Facets(NamedTuple):
    """The channels as arrays; vectors are in the camera frame.

    normals         (height, width, 3) float32, unit normals of the triangles; they face the viewer
    cosine          (height, width) float32, n·v of the interpolated normals
    shares          (OTHERS, height, width) float32, of the pixel that show each other surface
    other_normals   (OTHERS, height, width, 3) float32, interpolated; 0 where shares are 0
    other_facets    (OTHERS, height, width, 3) float32
    other_segments  (OTHERS, height, width) uint8, 0 also where the surface is the background
    """

    normals: np.ndarray
    cosine: np.ndarray
    shares: np.ndarray
    other_normals: np.ndarray
    other_facets: np.ndarray
    other_segments: np.ndarray

    @property
    def share(self) -> np.ndarray:
        """(height, width) float32: which part of a pixel shows other surfaces, all together."""
        return self.shares.sum(0)

    def interpolated_normals(self, normals: np.ndarray) -> np.ndarray:
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


def number_channels(name: str) -> list[str]:
    """Return the channels that a name stands for: one for each K where it has a K."""
    if ".K." not in name:
        return [name]
    return [name.replace(".K.", f".{k}.") for k in range(1, OTHERS + 1)]


def without_earlier(channels: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return a file's channels without those of points as earlier versions wrote them.

    Those describe one other surface at most, and its channels have no number. Such a file serves as
    one that holds none of these channels.
    """
    if any(each in channels for name in OF_OTHERS for each in number_channels(name)):
        return dict(channels)
    earlier = {*NORMALS, COSINE, *(name.replace(".K.", ".") for name in OF_OTHERS)}
    return {name: values for name, values in channels.items() if name not in earlier}


def layers(facets: Facets) -> dict[str, np.ndarray]:
    """Return {channel: (height, width)} of Facets: float32, and uint8 of segments."""
    result = {COSINE: facets.cosine} | dict(
        zip(NORMALS, np.moveaxis(facets.normals, -1, 0), strict=True)
    )
    vectors = ((OTHER_NORMALS, facets.other_normals), (OTHER_FACETS, facets.other_facets))
    each = [(SHARE, facets.shares), (OTHER_SEGMENT, facets.other_segments)] + [
        (name, values[..., axis]) for names, values in vectors for axis, name in enumerate(names)
    ]
    for name, values in each:
        result |= dict(zip(number_channels(name), values, strict=True))
    return result


def of_channels(channels: Mapping[str, np.ndarray]) -> Facets:
    """Return the Facets of a file's channels, which must all be there."""

    def stacked(name: str) -> np.ndarray:
        return np.stack([channels[each].astype(np.float32) for each in number_channels(name)])

    return Facets(
        np.stack([channels[name].astype(np.float32) for name in NORMALS], axis=-1),
        channels[COSINE].astype(np.float32),
        stacked(SHARE),
        np.stack([stacked(name) for name in OTHER_NORMALS], axis=-1),
        np.stack([stacked(name) for name in OTHER_FACETS], axis=-1),
        stacked(OTHER_SEGMENT).astype(np.uint8),
    )
