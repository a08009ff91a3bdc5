"""Superpixels of a picture, and the random walk that carries marks from some of them to the rest.

Superpixels are SLIC's. What is marked is carried on by the random walker of Grady, "Random Walks
for Image Segmentation" (PAMI 2006), on the graph of neighbouring superpixels: a superpixel belongs
to the region whose marks a random walk from it meets first most probably. Walks rarely cross an
edge: a difference between the colours of two superpixels, or a line of change along their border,
which is often all that there is between a chair and a wall of its colour. With about two thousand
superpixels the linear system is solved in some tens of milliseconds.

Superpixels come from scikit-image, which the extra `learn` has already; GrabCut would need OpenCV,
a further 60 MB, and knows one region only.

labels  (H, W) uint8: 0 background, 1 … S the regions
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from PIL import Image
from scipy import sparse
from scipy.ndimage import gaussian_filter
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from learn.selection.guided_filter import GuidedFilter

BACKGROUND = 0
LONGEST = 512  # pixels of the longer side of the picture that superpixels are made of
SUPERPIXELS = 2000
FEWER = 1200  # for clicks alone
COMPACTNESS = 8.0  # of SLIC: how much place counts against colour
CONTRAST = 12.0  # CIELAB units: across such a difference of colour a walk goes e⁻¹ times as often
# CIELAB units per pixel: along a border of this gradient a walk crosses e⁻¹ times as often
GRADIENT = 4.0
SMOOTHING = 1.0  # pixels, of the picture whose gradient is taken
WEAKEST = 1e-4  # weight of the strongest edge: every walk arrives somewhere
FRAME_STRENGTH = 0.02  # of the picture's frame as background, against a mark's
SMALLEST = 0.02  # of the largest piece of a region, by area: smaller ones are background


@dataclass(frozen=True)
class Superpixels:
    """Superpixels of a picture reduced to LONGEST.

    index      (h, w) number of each pixel's superpixel
    area       (K,) pixels of each
    pairs      (E, 2) neighbours
    colours    (K, 3) their mean colours, CIELAB
    weights    (E,) how often a walk crosses from one to the other, up to 1 × the border's length
    frame      (K,) bool: superpixels at the picture's frame
    lab        (h, w, 3) the reduced picture, CIELAB
    """

    index: np.ndarray
    area: np.ndarray
    pairs: np.ndarray
    colours: np.ndarray
    weights: np.ndarray
    frame: np.ndarray
    lab: np.ndarray

    @classmethod
    def of(cls, display: np.ndarray, count: int = SUPERPIXELS, lines: bool = True) -> "Superpixels":
        """Return superpixels of a picture (H, W, 3) uint8.

        count  about how many there are
        lines  whether lines of change along a border are edges, beside differences of colour
        """
        from skimage import color, segmentation

        height, width = display.shape[:2]
        scale = min(1.0, LONGEST / max(height, width))
        size = max(1, round(width * scale)), max(1, round(height * scale))
        small = np.asarray(Image.fromarray(display).resize(size, Image.Resampling.BOX))
        index = segmentation.slic(
            small,
            n_segments=count,
            compactness=COMPACTNESS,
            sigma=0.7,
            start_label=0,
            channel_axis=-1,
        )
        _, flat = np.unique(index, return_inverse=True)
        index = flat.reshape(index.shape)
        number = int(index.max()) + 1
        lab = color.rgb2lab(small)
        area = np.bincount(index.ravel(), minlength=number)
        mean = np.stack(
            [np.bincount(index.ravel(), lab[..., k].ravel(), number) / area for k in range(3)], -1
        )
        slope = slopes(lab)
        sides: list[tuple[Any, Any]] = [
            (np.s_[:, :-1], np.s_[:, 1:]),
            (np.s_[:-1], np.s_[1:]),
        ]
        both, steep = [], []
        for one, other in sides:
            border = index[one] != index[other]
            both.append(np.stack([index[one][border], index[other][border]], -1))
            steep.append(np.maximum(slope[one], slope[other])[border])
        ends = np.concatenate(both)
        ends.sort(1)
        pairs, which, lengths = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
        contrast = ((mean[pairs[:, 0]] - mean[pairs[:, 1]]) ** 2).sum(-1) / CONTRAST**2
        if lines:
            along = np.bincount(which.ravel(), np.concatenate(steep), len(pairs)) / lengths
            contrast += (along / GRADIENT) ** 2
        weights = lengths * np.maximum(np.exp(-contrast), WEAKEST)
        frame = np.zeros(number, bool)
        for edge in (index[0], index[-1], index[:, 0], index[:, -1]):
            frame[edge] = True
        return cls(index, area, pairs, mean, weights, frame, lab)

    def at(self, column: int, row: int, size: tuple[int, int]) -> int:
        """Return the superpixel at a pixel of a picture of that size, rows × columns."""
        height, width = self.index.shape
        y, x = min(row * height // size[0], height - 1), min(column * width // size[1], width - 1)
        return int(self.index[y, x])

    def covered(self, pixels: np.ndarray) -> np.ndarray:
        """Return the numbers of the superpixels that pixels (H, W) bool cover by half.

        None by half: the one that is covered most. Raises ValueError where no pixel is covered.
        """
        if not pixels.any():
            raise ValueError("no pixel is covered")
        share = np.bincount(self.index.ravel(), self.reduced(pixels).ravel(), len(self.area))
        share = share / self.area
        if not share.any():  # thinner than the pixels that superpixels are made of
            rows, columns = np.nonzero(pixels)
            middle = len(rows) // 2
            size = pixels.shape[0], pixels.shape[1]
            return np.array([self.at(int(columns[middle]), int(rows[middle]), size)])
        half = np.flatnonzero(share >= 0.5)
        return half if len(half) else np.array([int(share.argmax())])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Return the mean (K,) over each superpixel of values (h, w)."""
        return np.bincount(self.index.ravel(), values.ravel(), len(self.area)) / self.area

    def reduced(self, pixels: np.ndarray) -> np.ndarray:
        """Return pixels (H, W) bool at the size of `index`."""
        height, width = self.index.shape
        small = Image.fromarray(pixels).resize((width, height), Image.Resampling.NEAREST)
        return np.asarray(small)

    def labels(
        self,
        seeds: Mapping[int, int],
        size: tuple[int, int],
        frame: bool,
        kept: Collection[int] | None = None,
    ) -> np.ndarray:
        """Return labels (H, W) of a picture of that size, rows × columns.

        seeds   {superpixel: region} of all that is marked
        frame   whether the picture's frame is background, but where it is marked
        kept    if given, small pieces of a region become background, but for those with one of
                these superpixels
        """
        shares, regions = self.probabilities(seeds, frame)
        if len(regions) == 1:
            return np.full(size, regions[0], np.uint8)
        greatest = shares.argmax(1)
        if kept is not None and BACKGROUND in regions:
            background = regions.index(BACKGROUND)
            greatest[self._small_pieces(greatest, background, kept)] = background
        # enlarged before the greatest is chosen, so that edges are no stairs of the small picture
        best, result = np.full(size, -np.inf, np.float32), np.zeros(size, np.uint8)
        for number, region in enumerate(regions):
            picture = Image.fromarray(self._filter((greatest == number)[self.index]))
            large = np.asarray(picture.resize(size[::-1], Image.Resampling.BILINEAR))
            result[large > best] = region
            best = np.maximum(best, large)
        return result

    @cached_property
    def _filter(self) -> GuidedFilter:
        """The filter that moves edges of labels to those of the picture, made once."""
        return GuidedFilter(self.lab)

    def _small_pieces(
        self, regions: np.ndarray, background: int, kept: Collection[int]
    ) -> np.ndarray:
        """Return which superpixels (K,) bool belong to small pieces without any of those kept.

        regions     (K,) of each superpixel
        background  the region that has no pieces
        """
        i, j = self.pairs[regions[self.pairs[:, 0]] == regions[self.pairs[:, 1]]].T
        count = len(regions)
        graph = sparse.coo_matrix((np.ones(len(i)), (i, j)), (count, count))
        _, piece = connected_components(graph, directed=False)
        area = np.bincount(piece, self.area)
        largest = np.zeros(regions.max() + 1)
        np.maximum.at(largest, regions, area[piece])
        is_small = (area[piece] < SMALLEST * largest[regions]) & (regions != background)
        return is_small & ~np.isin(piece, piece[list(kept)])

    def probabilities(self, seeds: Mapping[int, int], frame: bool) -> tuple[np.ndarray, list[int]]:
        """Return the probability (K, R) of each region for each superpixel, and the regions."""
        count = len(self.frame)
        regions = sorted({*seeds.values(), *([BACKGROUND] if frame else [])})
        i, j = self.pairs.T
        W = sparse.coo_matrix((self.weights, (i, j)), (count, count))
        W = (W + W.T).tocsr()
        # the frame is a weak pull towards background: the object may touch it
        ground = FRAME_STRENGTH * np.asarray(W.sum(1)).ravel() * self.frame * frame
        laplacian = sparse.diags(np.asarray(W.sum(1)).ravel() + ground) - W
        seeded = np.array(sorted(seeds), int)
        free = np.setdiff1d(np.arange(count), seeded)
        shares = np.zeros((count, len(regions)))
        for place in seeded:
            shares[place, regions.index(seeds[int(place)])] = 1
        if len(free):
            right = -laplacian[free][:, seeded] @ shares[seeded]
            if BACKGROUND in regions:
                right[:, regions.index(BACKGROUND)] += ground[free]
            # a superpixel that no walk leaves, in a picture of one colour, belongs to the first
            solved = spsolve(
                (laplacian[free][:, free] + 1e-9 * sparse.eye(len(free))).tocsc(), right
            )
            shares[free] = np.asarray(solved).reshape(len(free), len(regions))
        return shares, regions


def slopes(lab: np.ndarray) -> np.ndarray:
    """Return how steeply colours (h, w, 3) change at each pixel (h, w), in units per pixel."""
    smooth = gaussian_filter(lab, (SMOOTHING, SMOOTHING, 0))
    result = np.zeros(lab.shape[:2])
    for axis in (0, 1):
        if lab.shape[axis] > 1:
            result += (np.gradient(smooth, axis=axis) ** 2).sum(-1)
    return np.sqrt(result)
