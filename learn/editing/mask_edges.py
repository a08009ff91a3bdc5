"""Fits a mask's edge to its photograph.

Masks that people draw or click, and those of programs that cut objects out, are often too wide, too
narrow or shifted by a few pixels, and their edges are jagged. In a narrow band about a mask's edge,
the photograph's colours are often a better guide to where the object ends:

1. Pixels outside the band keep their side of the mask. The band is narrower where the object, or a
   gap in it, is thin, so that its middle line also keeps its side.
2. Each pixel of the band is compared with mixtures of the colours of the nearest pixels beyond the
   band, object on one side and background on the other. The object's share in the best mixture is
   evidence, which counts the more, the more the two colours differ.
3. Neighbours of similar colour should have similar shares: the minimum of a quadratic energy over
   the band (Grady, "Random walks for image segmentation", PAMI 2006, with priors) decides which
   pixels are at least half covered. Where colours do not help, the given mask decides.
4. Within SOFT pixels of the new edge, coverage is the share in the best mixture again. Where
   colours do not help, it is that of an edge blurred by SOFTENING.

coverage  (H, W) in [0, 1]: the object's share of each pixel
"""

import numpy as np
from scipy import sparse
from scipy.ndimage import distance_transform_edt, gaussian_filter, label, maximum_filter
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from shaders import tone

# how far an edge may move, as shares of the longer side of the picture and of the object's box
OF_PICTURE, OF_OBJECT = 0.008, 0.02
NARROWEST, WIDEST = 4, 16  # pixels that an edge may move at least and at most
THIN = 0.5  # largest part of the half width of a thin part, or of a gap, that the band may cover
NEAREST = 6  # number of pixels beyond the band, on either side, that a pixel is compared with
NOISE = 0.03  # of values in [0, 1]: colours that differ by this much hardly differ
# the weight that ties two neighbours falls to e^-1/2 of its maximum at a difference of display
# values of CONTRAST, or of ROUGH times the median difference in the band if that is more
CONTRAST, ROUGH = 0.05, 1.5
EVIDENCE, GIVEN = 0.1, 0.02  # weights of the best mixture and of the given mask in the energy
SMOOTH = 0.15  # width of the Gaussian that smooths the shares, as a part of the band's width
# the certainty is a half if the squared difference of the mean colours of both sides is UNSURE
# times the sum of noise, spread and misfit
UNSURE = 4.0
SOFT = 1.0  # pixels about the new edge whose coverage is the share in the best mixture
SOFTENING = 0.7  # pixels, of the Gaussian that blurs a hard edge so that its steps do not show
CHUNK = 1 << 15  # pixels compared at once
# pixels of a band: finding the energy's minimum takes about 600 bytes for each. The band of an
# object that fills a photograph of 25 megapixels has up to about a million
MOST_IN_BAND = 1_500_000


class RaggedError(ValueError):
    """A mask has so much edge that its band has more than MOST_IN_BAND pixels."""


def fit(radiance: np.ndarray, coverage: np.ndarray, fixed: np.ndarray | None = None) -> np.ndarray:
    """Return coverage (H, W) float32 whose edge follows the photograph's colours.

    radiance  (H, W, 3) linear, of which display values are compared
    coverage  (H, W) in [0, 1]: the given mask
    fixed     (H, W) bool: pixels of unknown colour, such as transparent ones. They stay as they
              are, and so do those so near to them that an edge could be theirs; None: no pixel
    Raises    RaggedError
    """
    inside = coverage >= 0.5
    if not inside.any() or inside.all():
        return coverage.astype(np.float32)
    width = band_width(inside)
    box = _around(inside, 3 * width)
    part = coverage[box].astype(np.float32)
    display = tone.display(radiance[box], 1.0).astype(np.float32) / 255
    fitted = _fit(display, radiance[box], part, None if fixed is None else fixed[box], width)
    result = coverage.astype(np.float32)
    result[box] = fitted
    return result


def band_width(inside: np.ndarray) -> int:
    """Return how many pixels an object's edge may be moved in a picture (H, W) bool."""
    object_ = max(np.ptp(np.flatnonzero(inside.any(axis))) + 1 for axis in (0, 1))
    width = min(OF_PICTURE * max(inside.shape), OF_OBJECT * int(object_))
    return int(np.clip(round(width), NARROWEST, WIDEST))


def _around(inside: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Return the box of an object in a picture, with a margin."""
    spans = []
    for axis in (1, 0):
        at = np.flatnonzero(inside.any(axis))
        spans.append(slice(max(int(at[0]) - margin, 0), int(at[-1]) + margin + 1))
    return spans[0], spans[1]


def _fit(
    display: np.ndarray,
    radiance: np.ndarray,
    coverage: np.ndarray,
    fixed: np.ndarray | None,
    width: int,
) -> np.ndarray:
    """Return fitted coverage (h, w) of the part of a picture around the object; see `fit`."""
    inside = coverage >= 0.5
    band = band_about(inside, width)
    if fixed is not None and fixed.any():
        band &= distance_transform_edt(~fixed) > width
    if (count := int(band.sum())) > MOST_IN_BAND:
        raise RaggedError(f"{count} pixels about the edge")
    object_, background = inside & ~band, ~inside & ~band
    if not (band.any() and object_.any() and background.any()):
        return coverage
    share, certainty = object_shares(display, band, object_, background)
    moved = _minimise_energy(display, inside, band, share, certainty, width)
    depth = signed_distance(moved)
    soft = (np.abs(depth) <= SOFT) & band
    blurred = gaussian_filter(moved.astype(np.float32), SOFTENING)
    result = np.where(band, blurred, np.where(inside == moved, coverage, blurred))
    object_, background = depth > SOFT, depth < -SOFT
    if soft.any() and object_.any() and background.any():
        share, certainty = object_shares(np.minimum(radiance, 1), soft, object_, background)
        result[soft] = certainty * share + (1 - certainty) * blurred[soft]
    return result.astype(np.float32)


def signed_distance(inside: np.ndarray) -> np.ndarray:
    """Return distances (H, W) of pixel centres to the edge of a mask; positive inside."""
    within, without = (distance_transform_edt(each) for each in (inside, ~inside))
    return np.where(inside, within - 0.5, 0.5 - without)


def band_about(inside: np.ndarray, width: int) -> np.ndarray:
    """Return the pixels (H, W) bool about a mask's edge whose side the photograph decides."""
    result = np.zeros_like(inside)
    for side in (inside, ~inside):
        depth = distance_transform_edt(side)
        half = maximum_filter(depth, 2 * width + 1)
        result |= side & (depth <= width) & (depth <= THIN * half)
    return result


def object_shares(
    colours: np.ndarray,
    where: np.ndarray,
    object_: np.ndarray,
    background: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the object's colours in the best mixture for each pixel.

    colours              (H, W, 3)
    where                (H, W) bool: the N pixels
    object_, background  (H, W) bool: pixels known to be so, of which the NEAREST ones are mixed
    Returns              the object's share (N,) in [0, 1], and its certainty (N,) in [0, 1]
    """
    at = np.argwhere(where)
    seen = colours[where]
    # only pixels next to `where` can be nearest
    sides = [np.argwhere(side & maximum_filter(where, 5)) for side in (object_, background)]
    sides = [
        near if len(near) else np.argwhere(side)
        for near, side in zip(sides, (object_, background), strict=True)
    ]
    trees = [cKDTree(near) for near in sides]
    share, certainty = np.empty((2, len(at)), np.float32)
    for first in range(0, len(at), CHUNK):
        part = slice(first, first + CHUNK)
        F, B = (
            colours[tuple(near[_nearest(tree, at[part])].transpose(2, 0, 1))]
            for near, tree in zip(sides, trees, strict=True)
        )
        share[part], certainty[part] = _best_mixture(seen[part], F, B)
    return share, certainty


def _nearest(tree: cKDTree, at: np.ndarray) -> np.ndarray:
    """Return indices (N, K) of the nearest points of a tree, K of NEAREST or all."""
    count = min(NEAREST, tree.n)
    return tree.query(at, count)[1].reshape(len(at), count)


def _best_mixture(seen: np.ndarray, F: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return share (N,) and certainty (N,) of the mixture of F (N, K, 3) and B (N, J, 3) that is
    most like what is seen (N, 3).

    The certainty grows with the difference between F and B, and falls with the spread within each
    and with the misfit of the mixture.
    """
    difference2 = ((F.mean(1) - B.mean(1)) ** 2).sum(-1)
    spread2 = F.var(1).sum(-1) + B.var(1).sum(-1)
    F, B = F[:, :, None], B[:, None]
    step = F - B
    length2 = (step**2).sum(-1)
    from_b = seen[:, None, None] - B
    share = np.clip((from_b * step).sum(-1) / (length2 + 1e-6), 0, 1)
    residual2 = ((from_b - share[..., None] * step) ** 2).sum(-1)
    # of two pairs that explain a pixel equally well, the one whose colours differ more is taken
    cost = (residual2 + NOISE**2 / 4) / (length2 + NOISE**2)
    flat = cost.reshape(len(seen), -1).argmin(1)
    pick = np.arange(len(seen)), flat
    share, residual2 = (each.reshape(len(seen), -1)[pick] for each in (share, residual2))
    unsure2 = UNSURE * (NOISE**2 + spread2 + residual2)
    return share, difference2 / (difference2 + unsure2)


def _minimise_energy(
    display: np.ndarray,
    inside: np.ndarray,
    band: np.ndarray,
    share: np.ndarray,
    certainty: np.ndarray,
    width: int,
) -> np.ndarray:
    """Return the pixels (H, W) bool that the object covers by half at the energy's minimum.

    share, certainty  (N,) of the band's pixels
    """
    system, right = _energy_equations(display, inside, band, share, certainty)
    shares = inside.astype(np.float32)
    shares[band] = spsolve(system, right)
    result = np.where(band, gaussian_filter(shares, SMOOTH * width) >= 0.5, inside)
    return _remove_islands_and_holes(result, inside & ~band, ~inside & ~band)


def _energy_equations(
    display: np.ndarray,
    inside: np.ndarray,
    band: np.ndarray,
    share: np.ndarray,
    certainty: np.ndarray,
) -> tuple[sparse.csc_matrix, np.ndarray]:
    """Return the matrix (N, N) and right side (N,) whose solution is the energy's minimum.

    share, certainty  (N,) of the band's pixels
    """
    number = np.full(band.shape, -1)
    number[band] = np.arange(int(band.sum()))
    diagonal = EVIDENCE * certainty + GIVEN
    right = EVIDENCE * certainty * share + GIVEN * inside[band]
    rows, columns, values = [], [], []
    usual2 = np.median(((display[1:] - display[:-1]) ** 2).sum(-1)[band[1:]])
    contrast2 = max(CONTRAST**2, ROUGH**2 * float(usual2))
    for first, second in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        difference2 = ((display[first] - display[second]) ** 2).sum(-1)
        weight = np.exp(-difference2 / (2 * contrast2)) + 1e-3
        for one, other in ((first, second), (second, first)):
            here, there = number[one], number[other]
            among = here >= 0
            np.add.at(diagonal, here[among], weight[among])
            both = among & (there >= 0)
            rows.append(here[both])
            columns.append(there[both])
            values.append(-weight[both])
            alone = among & (there < 0)
            np.add.at(right, here[alone], weight[alone] * inside[other][alone])
    count = len(diagonal)
    system = sparse.csc_matrix(
        (
            np.concatenate([*values, diagonal]),
            (
                np.concatenate([*rows, np.arange(count)]),
                np.concatenate([*columns, np.arange(count)]),
            ),
        ),
        (count, count),
    )
    return system, right


def _remove_islands_and_holes(
    moved: np.ndarray, object_: np.ndarray, background: np.ndarray
) -> np.ndarray:
    """Return a mask (H, W) without islands and holes that contain no pixel known to be so."""
    for certain, value in ((object_, True), (background, False)):
        parts, _ = label(moved == value)
        kept = np.unique(parts[certain])
        moved = np.where((parts > 0) & ~np.isin(parts, kept), not value, moved)
    return moved
