"""Properties that an agreement depends on: edges, grazing angle, and the width of the highlight.

n (H, W, 3) camera frame, segments (H, W), depth (H, W); numpy arrays
"""

import numpy as np

from shaders import dsbrdf

# a sharper bend between neighbouring pixels is an edge: within a pixel, normals no longer turn
# evenly
CREASE = np.cos(np.radians(10.0))
STEEPEST = np.tan(np.radians(86.0))  # a depth step beyond this slope is another surface behind
GRAZING_DEG = (0, 30, 50, 65, 75, 82, 90)  # angle between normal and view: limits of the breakdown
# half-width of the highlight, in half angle: mirror-like, sharp, glossy, matte
WIDTHS_DEG = (0.0, 1.0, 4.0, 15.0, 90.0)
WIDTH_NAMES = ("mirror-like, below 1°", "sharp, 1–4°", "glossy, 4–15°", "matte, above 15°")


def inner(n: np.ndarray, segments: np.ndarray, depth: np.ndarray, pixel: float) -> np.ndarray:
    """Return the pixels (H, W) bool away from silhouettes, segment borders and creases.

    The eight neighbours of such a pixel are on the same smooth piece of surface.

    pixel  width of a pixel in units of depth
    """
    smooth = segments > 0
    rows, columns = segments.shape
    padded_n, padded_s, padded_d = (
        np.pad(a, ((1, 1), (1, 1), *[(0, 0)] * (a.ndim - 2))) for a in (n, segments, depth)
    )
    for i in (0, 1, 2):
        for j in (0, 1, 2):
            window = np.s_[i : i + rows, j : j + columns]
            same = padded_s[window] == segments
            bend = (padded_n[window] * n).sum(-1) > CREASE
            smooth &= (
                same
                & bend
                & (
                    np.abs(padded_d[window] - depth)
                    < STEEPEST * pixel * np.hypot(i - 1, j - 1) + 1e-9
                )
            )
    return smooth


def sub_pixel_normals(n: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return unit normals (K, H, W, 3) at places inside pixels, by the slope between neighbours.

    They are right where `inner` holds.

    n        (H, W, 3)
    offsets  (K, 2) in pixels: rightwards, downwards
    """
    padded = np.pad(n, ((1, 1), (1, 1), (0, 0)))
    rightwards = 0.5 * (padded[1:-1, 2:] - padded[1:-1, :-2])
    downwards = 0.5 * (padded[2:, 1:-1] - padded[:-2, 1:-1])
    moved = (
        n
        + offsets[:, 0, None, None, None] * rightwards
        + offsets[:, 1, None, None, None] * downwards
    )
    return moved / np.maximum(np.linalg.norm(moved, axis=-1, keepdims=True), 1e-12)


def highlight_half_width(m: np.ndarray, theta_d_deg: float = 20.0) -> float:
    """Return the half angle θ_h in degrees at which the BRDF falls to half its peak.

    The BRDF is the mean over channels; the angle is 90 if it never falls so low.

    m  (108,) control values
    """
    theta_h = np.concatenate([[0.0], np.geomspace(1e-4, np.pi / 2, 400)])
    f = dsbrdf.evaluate(
        np.asarray(m, np.float64), np.cos(theta_h), np.full(theta_h.shape, np.radians(theta_d_deg))
    ).mean(-1)
    below = np.nonzero(f < 0.5 * f[0])[0]
    return float(np.degrees(theta_h[below[0]])) if len(below) else 90.0


def width_name(width_deg: float) -> str:
    """Return the class of a highlight's half-width in words."""
    return WIDTH_NAMES[
        int(
            np.clip(
                np.searchsorted(WIDTHS_DEG, width_deg, side="right") - 1, 0, len(WIDTH_NAMES) - 1
            )
        )
    ]
