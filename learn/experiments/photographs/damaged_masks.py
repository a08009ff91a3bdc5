"""Inaccurate masks, like those of people and programs, made from an object's exact coverage."""

from collections.abc import Callable, Mapping

import numpy as np
from PIL import Image
from skimage import draw, measure

from learn.editing.mask_edges import signed_distance

CORNERS = 1.5  # pixels by which a polygon's sides may deviate from the edge
REDUCED = 4  # a mask is made in a picture that is so many times smaller


def _moved(pixels: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda coverage: signed_distance(coverage >= 0.5) > -pixels


def _shifted(rows: int, columns: int) -> Callable[[np.ndarray], np.ndarray]:
    def shifted(coverage: np.ndarray) -> np.ndarray:
        around = np.pad(coverage >= 0.5, 2)
        return np.roll(around, (rows, columns), (0, 1))[2:-2, 2:-2]

    return shifted


def polygonal(coverage: np.ndarray) -> np.ndarray:
    """Return a mask (H, W) bool whose outlines and holes are polygons of few corners."""
    inside = coverage >= 0.5
    result = np.zeros_like(inside)
    for outline in measure.find_contours(np.pad(inside, 1).astype(float), 0.5):
        corners = measure.approximate_polygon(outline, CORNERS) - 1
        result ^= draw.polygon2mask(inside.shape, corners)
    return result


def enlarged(coverage: np.ndarray) -> np.ndarray:
    """Return a mask (H, W) bool, made REDUCED times smaller and enlarged without interpolation."""
    height, width = coverage.shape
    small = Image.fromarray(coverage.astype(np.float32)).resize(
        (max(width // REDUCED, 1), max(height // REDUCED, 1)), Image.Resampling.BOX
    )
    return np.asarray(small.resize((width, height), Image.Resampling.NEAREST)) >= 0.5


EXACT, HARD = "exact coverage", "black and white"
# from coverage (H, W) in [0, 1] to a mask of such values, or bool
DAMAGES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    EXACT: lambda coverage: coverage,
    HARD: lambda coverage: coverage >= 0.5,
    "1 pixel too narrow": _moved(-1),
    "2 pixels too narrow": _moved(-2),
    "3 pixels too narrow": _moved(-3),
    "1 pixel too wide": _moved(1),
    "2 pixels too wide": _moved(2),
    "3 pixels too wide": _moved(3),
    "shifted by 1 pixel each": _shifted(1, 1),
    "shifted by 2 pixels": _shifted(0, 2),
    "a polygon": polygonal,
    f"of a picture {REDUCED} times smaller": enlarged,
}
