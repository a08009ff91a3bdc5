"""Checks of rendered pixels, which find the errors that Cycles does not report.

Each function returns a list of lines that say what was expected and what was found; the list of a
good shot is empty.
"""

import numpy as np

from manifests.picture_files import SeenGeometry

UNIT_TOLERANCE = 1e-3  # of |n|: ten times float16's rounding of a unit vector's parts


def picture_faults(
    radiance: np.ndarray, coverage_expected: float | None = None, alpha: np.ndarray | None = None
) -> list[str]:
    """Return a list of what is wrong with a picture, empty if it is good.

    It must be finite, not negative, not Cycles' magenta for a missing texture, and cover the part
    of the frame that the geometry covers.

    radiance           (height, width, 3)
    coverage_expected  share of the frame inside the geometry's mask, or None
    alpha              (height, width), or None
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
        # a pixel at the silhouette is in the mask or not, but in the picture it counts in part: the
        # error is half a pixel along a boundary of at most 8 frame widths
        if abs(coverage - coverage_expected) > 4.0 / min(alpha.shape):
            results.append(
                f"expected coverage {coverage_expected:.4f}, as in the geometry, found"
                f" {coverage:.4f}"
            )
    return results


def magenta(radiance: np.ndarray) -> bool:
    """Return whether a picture has red and blue light, but no green light anywhere.

    That is Cycles' (1, 0, 1) for a missing texture, times the material's colour.
    """
    red, green, blue = (bool(radiance[..., k].any()) for k in range(3))
    return red and blue and not green


def geometry_faults(shot: SeenGeometry, segments: int) -> list[str]:
    """Return a list of what is wrong with geometry, empty if it is good.

    The object must be in the frame, normals must have unit length, and segments must be 1 to
    `segments` inside the mask and 0 outside.

    segments  number of segments of the shape
    """
    if not shot.mask.any():
        return ["expected the object in the frame, found an empty mask"]
    results = []
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
        results.append("expected segment 0 outside the mask and nowhere else, found others")
    return results
