"""Residual shading: what a photograph shows beyond the rendering of its decomposition.

    residual = log(photograph / its re-rendering) − its mean over the region

One light far away, a smooth shape and one material do not explain contact shadows, light that
bounces between parts, folds and texture. An edit shows them too if it is multiplied by
exp(D · residual). D would be 1 if normals, light and material were right. They are estimates, so a
part of the residual is their error, and edits keep half of it (learn.editing.DETAIL). The mean is
removed because it says how the brightness and colour of light or material were misjudged.

Shading changes brightness more than colour. Where the residual varies in colour over the object, it
is more likely to be a print, or the mirror image of something coloured: `coarse_share` is then
below 1, and the coarse part of the residual is weakened by it. The part that is finer than the
network's pixels, which no normals can hold, is halved at most.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from learn.data import framing
from learn.editing.backgrounds import fill_from_nearest
from shaders.tone import LUMINANCE

# spread of the residual's colour, natural logarithms, at which half of its coarse part is left, and
# how sharply that falls there (docs/editing-measurements.md)
COLOURED, STEEPNESS = 0.15, 4
LEAST_FINE = 0.5  # share of the fine part that is always left
LARGEST_FINE = 1.5  # factor by which the fine part may brighten or darken a pixel at most
FINE_WIDTH = 1.5  # network pixels: what a Gaussian of this width removes is fine
LARGEST = 4.0  # factor by which the whole residual may brighten or darken a pixel at most
FLOOR = 0.02  # of the object's mean radiance: what is darker counts as this dark
FLOOR_OF_COLOURS = (
    0.05  # the same where colours are compared, because dark pixels show little colour
)
# the residual behind a printed label is filled in at so many pixels along the square's side, by a
# Gaussian of this width in these pixels
FILL_SIDE, FILL_WIDTH = 128, 6.0


def log_ratio(
    seen: np.ndarray, rendered: np.ndarray, inside: np.ndarray, floor: float = FLOOR
) -> np.ndarray:
    """Return log(seen / rendered) (h, w, 3).

    seen, rendered  (h, w, 3) linear radiance of the photograph and of its re-rendering
    inside          (h, w) bool: the object
    floor           of the object's mean radiance; in both, what is darker counts as this dark
    """
    mean = float(seen[inside].mean()) if inside.any() else 0.0
    least = floor * max(mean, 1e-6)
    return np.log(np.maximum(seen, least)) - np.log(np.maximum(rendered, least))


def complete_residual(
    seen: np.ndarray, rendered: np.ndarray, regions: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Return the residual (h, h, 3) float32, at most log LARGEST, with its gaps filled in.

    Behind a printed label it is a blurred mean of what surrounds it, and beyond the object that of
    the nearest pixel.

    seen, rendered  (h, h, 3) as `log_ratio` takes them
    regions         (h, h) numbers of the object's regions, 0 where a pixel is not covered whole
    weights         (h, h) in [0, 1]: 0 on printed labels
    """
    inside, limit = regions > 0, np.log(LARGEST)
    log = log_ratio(seen, rendered, inside).astype(np.float32)
    if not inside.any():
        return np.zeros_like(log)
    for number in np.unique(regions[inside]):
        of = regions == number
        counted = weights[of] if weights[of].any() else None
        log[of] -= np.average(log[of], axis=0, weights=counted)
    log = np.clip(log, -limit, limit)
    share = (inside * weights).astype(np.float32)
    if (share < inside).any():
        small = min(len(log), FILL_SIDE)
        width = FILL_WIDTH * small / FILL_SIDE
        weighted = framing.resize_square(np.dstack([log * share[..., None], share]), small)
        blurred = gaussian_filter(weighted, (width, width, 0))
        mean = blurred[..., :3] / np.maximum(blurred[..., 3:], 1e-3)
        behind = framing.resize_square(mean, len(log))
        log = share[..., None] * log + (1 - share[..., None]) * behind
    return fill_from_nearest(log, inside).astype(np.float32)


def weaken(residual: np.ndarray, inside: np.ndarray, share: float, width: float) -> np.ndarray:
    """Return a share of a residual (h, h, 3), but at least LEAST_FINE of its fine part.

    share   0 to 1
    inside  (h, h) bool: pixels that the object covers whole; the fine part is 0 elsewhere
    width   of the Gaussian that removes the fine part, pixels
    """
    if share >= LEAST_FINE or not inside.any():
        return np.float32(share) * residual
    whole = inside.astype(np.float32)
    near = np.maximum(gaussian_filter(whole, width), 1e-3)
    coarse = gaussian_filter(residual * whole[..., None], (width, width, 0)) / near[..., None]
    limit = np.log(LARGEST_FINE)
    fine = np.where(inside[..., None], np.clip(residual - coarse, -limit, limit), 0)
    return np.float32(share) * residual + np.float32(LEAST_FINE - share) * fine


def coarse_share(
    seen: np.ndarray, rendered: np.ndarray, regions: np.ndarray, weights: np.ndarray
) -> float:
    """Return the share, 0 to 1, of the residual's coarse part that is likely to be shading.

    seen, rendered  (h, w, 3) as `log_ratio` takes them
    regions         (h, w) numbers of the object's regions, 0 where it does not cover a pixel whole
    weights         (h, w) in [0, 1]: 0 on printed labels
    """
    counted = (regions > 0) & (weights > 0.5)
    if not counted.any():
        return 0.0
    full = log_ratio(seen, rendered, counted, FLOOR_OF_COLOURS)[counted]
    grey = log_ratio(seen @ LUMINANCE, rendered @ LUMINANCE, counted, FLOOR_OF_COLOURS)[counted]
    colour, numbers = full - grey[:, None], regions[counted]
    squares = 0.0
    for number in np.unique(numbers):
        of = colour[numbers == number]
        squares += float(((of - of.mean(0)) ** 2).sum())
    spread = np.sqrt(squares / colour.size)
    return float(1 / (1 + (spread / COLOURED) ** STEEPNESS))
