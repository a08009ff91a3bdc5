"""Direct light without shadows at points of a picture, by the closed forms of its materials."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from factory.render.estimators.halves import DirectPicture
from factory.render.geometry import Surface
from manifests.schema import Camera
from shaders import frames
from shaders.mixture import Mixture

if TYPE_CHECKING:
    from shaders.direct_light import DirectLight

# normals across a pixel at which direct light is computed, with how many samples of a narrow lobe
# each; mirror-like materials need more, for in a pixel normals turn by more than their lobes
SUBPIXELS = {"glossy": (4, 12), "mirror-like": (8, 4)}
# cells across a pixel; in each of them light that wide lobes lose at facets is computed once
CELLS = 2
MIRROR_LIKE = 0.03  # α below which a lobe is
MOST_POINTS = 1 << 22  # of a picture, some 150 MB
MOST_DIRECT = 64  # maps of direct light in memory


class DirectLights:
    """Closed forms of mixtures under lights, of which those that were used last are kept."""

    def __init__(self) -> None:
        # by mixture, light and camera, least recently used first
        self._known: OrderedDict[tuple, DirectLight] = OrderedDict()

    def clear(self) -> None:
        """Forget all of them."""
        self._known.clear()

    def of(self, mixture: Mixture, seen: np.ndarray, lens: Camera) -> DirectLight:
        """Return the direct light of a mixture; seen: the light map as the camera sees it."""
        key = (mixture.key, seen.tobytes(), lens.elevation_deg, lens.roll_deg)
        if key not in self._known:
            from shaders.direct_light import DirectLight  # and numba, which takes half a second

            rotation = frames.camera_from_light(
                np.radians(lens.elevation_deg), np.radians(lens.roll_deg)
            )
            self._known[key] = DirectLight(mixture, seen, rotation)
        self._known.move_to_end(key)
        if len(self._known) > MOST_DIRECT:
            self._known.popitem(last=False)
        return self._known[key]


def points_of(direct: Sequence[DirectLight], lens: Camera) -> tuple[int, int] | None:
    """Return the points across a pixel, and the samples of narrow lobes at each of them.

    None where fewer than two points across a square pixel fit into MOST_POINTS.
    """
    mirror_like = min(each.narrowest for each in direct) < MIRROR_LIKE
    across, samples = SUBPIXELS["mirror-like" if mirror_like else "glossy"]
    per_pixel = across * across * samples
    pixels = lens.size[0] * lens.size[1]
    across = 1 if lens.pixel == "centre" else min(across, math.isqrt(MOST_POINTS // pixels))
    if pixels > MOST_POINTS or (across < 2 and lens.pixel != "centre"):
        return None
    return across, -(-per_pixel // across**2)


def picture_of(
    direct: Sequence[DirectLight], fine: Surface, size: tuple[int, int], across: int, samples: int
) -> DirectPicture:
    """Return the picture (height, width) whose pixels are means over points of a grid.

    direct   of the segments' materials, in the order of their ids
    fine     the surface at the points, `across` of them along each side of a pixel
    samples  of narrow lobes at each point
    """
    height, width = size
    values = np.zeros_like(fine.normals)
    rows, columns = (place // max(across // CELLS, 1) for place in np.nonzero(fine.mask))
    cells = rows * fine.mask.shape[1] + columns
    for number, each in enumerate(direct, 1):
        here = fine.segments == number
        of = fine.normals[here], samples, fine.facets[here]
        values[here] = each.at(*of, cells=cells[here])
    radiance = np.zeros((*fine.mask.shape, 3), np.float32)
    radiance[fine.mask] = values
    blocks = (height, across, width, across)
    return DirectPicture(
        radiance.reshape(*blocks, 3).mean((1, 3), dtype=np.float32),
        fine.mask.reshape(blocks).mean((1, 3), dtype=np.float32),
    )
