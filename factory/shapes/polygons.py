"""Polygons cut into triangles: as a fan where that is right, otherwise by cutting off ears.

Polygons stand one after another: corners (C,) indices of vertices, lengths (P,) corners of each. A
polygon of n corners becomes n - 2 triangles whose outer edges are its own edges, whatever its
shape, so that no hole can result.

fan   triangles around the first corner (factory.shapes.fans)
ears  corners that are cut off one after another (factory.shapes.ears)
none  corners in a line, or doubled, keep their place among the triangles (some of which have no
      area); polygons that cross themselves have no right answer, and are counted

ears.MOST_TESTS and MOST_CORNERS bound the time of all polygons of a mesh to about a minute
(tests/factory/test_polygons.py).
"""

import numpy as np

from factory.shapes import ears
from factory.shapes.fans import fans, where_fans_fail
from factory.shapes.ragged import ranges

# of one polygon whose fan is wrong: its corners may have to be cut off one by one
MOST_CORNERS = 50_000


def triangulate(
    vertices: np.ndarray, corners: np.ndarray, lengths: np.ndarray, depth: float = 0.0
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return triangles (F, 3), the polygon (F,) of each, and how many polygons cross themselves.

    vertices  (V, 3), any frame and unit
    corners   (C,) indices into vertices, polygon after polygon
    lengths   (P,) corners of each polygon, 3 or more
    depth     a notch less deep than this, in units of the vertices, counts as rounding: the fan
              covers it
    Raises    ears.TooLarge before time is spent
    """
    faces, owner = fans(corners, lengths)
    wrong, crossing = where_fans_fail(vertices, faces, owner, lengths, depth)
    if len(wrong):
        if (largest := int(lengths[wrong].max())) > MOST_CORNERS:
            raise ears.TooLarge(largest)
        starts = np.cumsum(lengths) - lengths
        cut, more = ears.cut(
            vertices, corners[ranges(starts[wrong], lengths[wrong])], lengths[wrong]
        )
        first = np.cumsum(lengths - 2) - (lengths - 2)
        faces[ranges(first[wrong], lengths[wrong] - 2)] = cut
        crossing += more
    return faces, owner, crossing
