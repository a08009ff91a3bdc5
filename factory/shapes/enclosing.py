"""The smallest sphere around points, exactly, by pivoting on the farthest point.

points: (N, 3).  A sphere is (centre (3,), radius).  At most four points determine it: the support.
Source: Gärtner, "Fast and robust smallest enclosing balls", ESA 1999 (the pivot rule).
"""

from itertools import combinations

import numpy as np

SLACK = 1e-10  # relative; below it rounding may swap one support for another without end


def smallest_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre (3,) and radius of the smallest sphere that holds all points (N, 3)."""
    support = points[[0]]
    centre, radius = points[0], 0.0
    for _ in range(1000):  # each pivot grows the radius; real meshes need about ten
        distance = np.linalg.norm(points - centre, axis=1)
        farthest = int(distance.argmax())
        if distance[farthest] <= radius * (1 + SLACK) + 1e-300:
            break
        grown = np.vstack([support, points[farthest]])
        found_centre, found_radius, found_support = _smallest_of_few(grown)
        # rounding has stopped the growth: four nearly cospherical points
        if found_radius <= radius:
            break
        centre, radius, support = found_centre, found_radius, found_support
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _smallest_of_few(points):
    """Return centre, radius and support of the smallest sphere around at most five points.

    Every support is tried.
    """
    best = None
    reach = np.ptp(points, axis=0).max()
    for count in range(2, min(4, len(points)) + 1):
        for chosen in combinations(range(len(points)), count):
            support = points[list(chosen)]
            centre = _through(support)
            radius = np.linalg.norm(support - centre, axis=1).max()
            if np.linalg.norm(points - centre, axis=1).max() <= radius + 1e-10 * reach and (
                best is None or radius < best[1]
            ):
                best = centre, radius, support
    return best


def _through(support):
    """Return the point (3,) equally far from two to four points, in their affine hull."""
    edges = support[1:] - support[0]
    weights = np.linalg.lstsq(2 * edges @ edges.T, (edges**2).sum(1), rcond=None)[0]
    return support[0] + weights @ edges
