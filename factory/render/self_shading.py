"""Whether an object may shade itself or reflect light onto itself, as seen from one side.

An object cannot if all of it lies below the plane of every facet that is visible: no ray that
leaves such a facet meets the object again. Direct light without shadows is then all light there is.

what      no shadow rays and no bounces: the paths of the tier `direct` are traced for `shadow` and
          `full` (factory.render.estimators.choice), and the record's `accuracy` says so in `traced`
bias      what TOLERANCE and WIDER let pass: Cycles' pictures of `full` and `direct` differ by a
          display L2 of .012 at most on 91 recognised shots, and on most of them not at all
checked   against rays: of 1,150 shots none is recognised whose facets see the object
          (factory.render.validation.self_shading_check)
cost      once per view, a product of visible facets and vertices: a few ms where the first facets
          decide, 0.7 s on a sphere of 41,000 vertices at 256². Per mesh a few ms, at most 0.1 s
fails     by missing what it could save: 91 of 122 shots without self-shading are recognised, nearly
          all of them spheres, cubes and discs. In perspective a facet seen edge-on may face either
          way (`are_known`), so that the shot is traced as usual

vertices  (V, 3) of the mesh, in the frame of the facets
facets    (P, 3) unit normals of the facets that are visible, which face outwards
points    (P, 3) one point on each of them
"""

import numpy as np

# a vertex may lie above a facet's plane by this share of the unit sphere's radius; float32's
# rounding of depths is a sixth of it
TOLERANCE = 1e-4
# for at most the share FEW of the facets it may be WIDER, because the quadrilaterals of a bevel are
# seldom planar
WIDER, FEW = 2e-3, 0.02
# of a mesh's facets: if fewer have the whole mesh below them, no side is taken to show only such
# facets
LEAST_SHARE = 0.1
# margin for facets seen in perspective, whose z is known up to its sign; float32's error of a z
# near 0 is a third of it
UNSURE = 2e-3
# facets that are looked at first: in most shapes that may shade themselves, one of these says so
TRIED = 256


def may_shade_itself(vertices: np.ndarray, facets: np.ndarray, points: np.ndarray) -> bool:
    """Return False if nothing that is visible can be shaded by the object or lit by its light."""
    order = np.random.default_rng(0).permutation(len(facets))
    uneven = 0
    for some in np.split(order, range(TRIED, len(order), TRIED)):
        above = _above(vertices, facets[some], points[some])
        uneven += int((above > TOLERANCE).sum())
        if (above > WIDER).any() or uneven > FEW * len(facets):
            return True
    return False


def are_known(facets: np.ndarray, views: np.ndarray) -> bool:
    """Return whether facets with n_z ≥ 0 are the ones that are visible.

    The rendered passes give n_x and n_y of a facet that faces the viewer. If the facet with −n_z
    would face the viewer as well, it is not known which of the two is visible. A convex object
    around its centre, seen from farther away than twice its radius, has no such facet.

    facets  (P, 3) with n_z ≥ 0
    views   (P, 3) unit vectors to the viewer
    """
    beside = np.einsum("pi,pi->p", facets[:, :2], views[:, :2])
    return bool((beside < facets[:, 2] * views[:, 2] - UNSURE).all())


def has_convex_side(vertices: np.ndarray, corners: np.ndarray) -> bool:
    """Return False if too few facets have the whole mesh below them for a side without shading.

    corners  (F, 3, 3) positions of each triangle's corners, counter-clockwise from outside
    """
    some = corners[:: max(1, len(corners) // TRIED)].astype(np.float64)
    across = np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0])
    length = np.linalg.norm(across, axis=1)
    facets, points = across[length > 0] / length[length > 0, None], some[length > 0, 0]
    return bool((_above(vertices, facets, points) <= TOLERANCE).mean() >= LEAST_SHARE)


def _above(vertices: np.ndarray, facets: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return how far the mesh extends beyond the plane of each facet (P,)."""
    farthest = (facets.astype(np.float32) @ vertices.T.astype(np.float32)).max(1)
    return farthest - np.einsum("pi,pi->p", facets, points)
