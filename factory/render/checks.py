"""What is wrong with a shot, found by looking at its pixels: Cycles fails silently.

Each function returns a list of lines, each saying what was expected and what was found; an empty
list is a good shot.
"""

import numpy as np

UNIT_TOLERANCE = 1e-3  # of |n|: ten times float16's rounding of a unit vector's parts


def picture(radiance, coverage_expected=None, alpha=None):
    """Finite, not negative, not Cycles' magenta for a missing texture, not all black, covering what
    the geometry covers.

    radiance           (height, width, 3); alpha (height, width) or None
    coverage_expected  share of the frame that the geometry's mask covers, or None
    """
    results = []
    if not np.isfinite(radiance).all():
        results.append(
            f"expected finite radiance, found {np.count_nonzero(~np.isfinite(radiance))} other"
            " values"
        )
    elif radiance.min() < 0:
        results.append(f"expected radiance ≥ 0, found {radiance.min():g}")
    elif magenta(radiance):
        results.append("expected the light's colours, found magenta: Cycles has no light map")
    if alpha is not None and coverage_expected is not None:
        coverage = float(alpha.mean())
        # a silhouette pixel is in the mask or not, in the picture it is a share: half a pixel along
        # a boundary of ≤ 8 frame widths
        if abs(coverage - coverage_expected) > 4.0 / min(alpha.shape):
            results.append(
                f"expected coverage {coverage_expected:.4f}, as in the geometry, found"
                f" {coverage:.4f}"
            )
    return results


def magenta(radiance):
    """True if red and blue shine and green nowhere: Cycles' (1, 0, 1) for a missing texture, times
    the material's colour.
    """
    return (
        not radiance[..., 1].any() and bool(radiance[..., 0].any()) and bool(radiance[..., 2].any())
    )


def geometry(shot, segments):
    """Unit normals that face the viewer, segments 1 … segments, something in the frame.

    shot      Geometry
    segments  how many the shape has
    """
    results = []
    if not shot.mask.any():
        return ["expected the object in the frame, found an empty mask"]
    if not np.isfinite(shot.normals).all() or not np.isfinite(shot.depth).all():
        results.append("expected finite normals and depth, found others")
    normals = shot.normals[shot.mask]
    squares = np.einsum("pi,pi->p", normals, normals)
    if np.abs(squares - 1).max() > 2 * UNIT_TOLERANCE:
        results.append(
            "expected unit normals, found lengths"
            f" {squares.min() ** 0.5:.4f}–{squares.max() ** 0.5:.4f}"
        )
    if shot.segments.max() > segments:
        results.append(f"expected segments 1 to {segments}, found {shot.segments.max()}")
    if not np.array_equal(shot.segments > 0, shot.mask):
        results.append("expected segment 0 outside the mask, and there alone, found others")
    return results
