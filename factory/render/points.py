"""Pixels that are points: which of them lie so close to an edge that Cycles may meet its other side.

Cycles' narrowest pixel filter is a bell 0.01 pixels wide. Its rays lie within CORNER of a pixel's
centre, except one in some hundred, so where rays through the corners of that square meet the
surface that the centre shows, all do.
"""

from collections.abc import Sequence

import numpy as np

CORNER = 0.0075  # pixels, three standard deviations of the filter
CORNERS = ((-CORNER, -CORNER), (-CORNER, CORNER), (CORNER, -CORNER), (CORNER, CORNER))
# between normals of one surface, and between facets that the closed form of direct light does not
# tell apart
SAME_NORMAL = float(np.cos(np.radians(3.0)))
SAME_FACET = float(np.cos(np.radians(10.0)))


def beside(centre: Sequence[np.ndarray], corners: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Return which share of the corners shows another surface than the centre, (height, width).

    Each is mask (height, width), normals and facets (height, width, 3) and segments (height, width)
    as rays through one point of each pixel find them. The share is 0 outside the centre's mask.
    """
    mask, normals, facets, segments = centre
    differing = np.zeros(mask.shape, np.float32)
    for _, other_normals, other_facets, other_segments in corners:
        same = (segments == other_segments) & (
            np.einsum("hwi,hwi->hw", normals, other_normals) > SAME_NORMAL
        )
        same &= np.einsum("hwi,hwi->hw", facets, other_facets) > SAME_FACET
        differing += ~same
    return differing / len(corners) * mask
