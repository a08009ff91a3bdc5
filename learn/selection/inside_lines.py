"""What a line around an object says of the superpixels inside it.

The object is deep inside the line, and what is outside shows the background's colours. Each
superpixel inside has a score, which grows with its depth and with the difference of its colour from
the background. Those of high scores are the object, those of low ones are beside it, and the random
walk decides about the rest. How much colours count depends on how well they tell the object from
the background: before a wall of its own colour, depth decides.

docs/log/editing.md, "What a line says about colours", has what was tried.
"""

from collections.abc import Collection

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from learn.selection.superpixels import Superpixels

# shares of the greatest score: above OBJECT is the object, below BESIDE the background
OBJECT, BESIDE = 0.3, 0.03
# colours count fully if what lies below DEEP, a share of the greatest depth, differs from the
# background by CLEAR on average, or if CLEAR of the area inside the line differs by a half
DEEP, CLEAR = 0.6, 0.3
# a colour that differs by one of these, the greater one, counts half: CIELAB units, and a share of
# the greatest difference, so that what mixes object and background at an edge counts little
UNLIKE, MIXED = 10.0, 0.25
SAME = 1e-3  # CIELAB units, added to all differences: where all colours are the same, depth decides
NEAREST = 3  # background superpixels of the most similar colours, over which differences are means
# what the user marks as background inside a line says the same of what has its colour and is nearer
# than FAR, a share of the greatest depth; what is nearer than NEAR is not taken for the object.
# What is marked as object keeps the same from being taken for the background
NEAR, FAR = 0.3, 0.6


def seeds_inside(
    line: np.ndarray,
    superpixels: Superpixels,
    outside: np.ndarray,
    background: Collection[int] = (),
    objects: Collection[int] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Return the superpixels inside a line that are the object's, and those beside the object.

    Both are numbers of superpixels; the random walk decides about the others. Those of the object
    are in order of their scores, the greatest first.

    line                 (H, W) bool: pixels of the picture inside it
    outside              numbers of superpixels outside all lines
    background, objects  numbers of superpixels that the user marked as background, and as objects
    """
    enclosed = superpixels.reduced(line)
    inside = superpixels.mean(enclosed) > 0.5
    depths = distance_transform_edt(np.pad(enclosed, 1))[1:-1, 1:-1]
    deepest = max(1.0, float(depths.max()))  # 0 for a line that is thinner than the reduced pixels
    depth = superpixels.mean(depths) / deepest
    unlike = _unlikeness(superpixels, outside)
    trust = _trust_in_colours(superpixels, unlike, inside, inside & (depth > DEEP))
    is_near_background = np.zeros(len(superpixels.area), bool)
    if background:
        share = _distance(superpixels, background) / deepest
        of_marked = _unlikeness(superpixels, np.array(sorted(background)), nearest=1)
        unlike = np.where(share < FAR, np.minimum(unlike, of_marked), unlike)
        is_near_background = share < NEAR
    # √depth × unlikeness where colours can be trusted, and depth where they cannot
    score = depth ** (1 - trust / 2) * unlike**trust * inside
    greatest = score.max()
    is_object = (score > OBJECT * greatest) & ~is_near_background
    is_beside = (score < BESIDE * greatest) & inside
    if objects:
        share = _distance(superpixels, objects) / deepest
        differs = _unlikeness(superpixels, np.array(sorted(objects)), nearest=1) > 0.5
        is_beside &= (share > NEAR) & (differs | (share > FAR))
    falling = np.argsort(-score)
    return falling[is_object[falling]], np.flatnonzero(is_beside)


def _distance(superpixels: Superpixels, marked: Collection[int]) -> np.ndarray:
    """Return how far each superpixel (K,) is from marked ones, in pixels of the reduced picture."""
    return superpixels.mean(distance_transform_edt(~np.isin(superpixels.index, list(marked))))


def _trust_in_colours(
    superpixels: Superpixels, unlike: np.ndarray, inside: np.ndarray, deep: np.ndarray
) -> float:
    """Return from 0 to 1 how well colours tell the object from the background.

    unlike        (K,) of `_unlikeness`
    inside, deep  (K,) bool: superpixels inside the line, and deep inside it
    """
    area = superpixels.area
    whole = area[inside].sum()
    clear = area[inside & (unlike > 0.5)].sum() / whole if whole else 0.0
    if deep.any():
        clear = max(clear, np.average(unlike[deep], weights=area[deep]))
    return min(1.0, float(clear) / CLEAR)


def _unlikeness(
    superpixels: Superpixels, background: np.ndarray, nearest: int = NEAREST
) -> np.ndarray:
    """Return how little each superpixel's colour (K,) is like the background's, from 0 to 1.

    background  numbers of its superpixels; without any, all colours count 1
    """
    if not len(background):
        return np.ones(len(superpixels.area))
    tree = cKDTree(superpixels.colours[background])
    count = min(nearest, len(background))
    differences, _ = tree.query(superpixels.colours, range(1, count + 1))
    difference = SAME + differences.mean(1)
    return difference / (difference + max(UNLIKE, MIXED * difference.max()))
