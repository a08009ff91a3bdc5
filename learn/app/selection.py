"""Masks and regions made on the page, by clicks and by strokes of a brush.

A click says of one point which region it belongs to, or that it is background. Superpixels (SLIC)
carry the clicks to the rest of the picture by the random walker of Grady, "Random Walks for Image
Segmentation" (PAMI 2006), on the graph of neighbouring superpixels: a superpixel belongs to the
region whose clicks a random walk from it meets first most probably. Walks rarely cross an edge of
colour, and the frame of the picture counts as background. With about a thousand superpixels the
linear system is solved in milliseconds, so that every click shows its result at once.

Superpixels come from scikit-image, which the extra `learn` has already; GrabCut would need OpenCV,
a further 60 MB, and knows one region only.

labels  (H, W) uint8: 0 background, 1 … S the regions
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from PIL import Image
from scipy import sparse
from scipy.ndimage import distance_transform_edt
from scipy.sparse.linalg import spsolve

from learn.data.photographs import MOST_REGIONS
from manifests.errors import InputError

LONGEST = 512  # pixels of the longer side of the picture that superpixels are made of
SUPERPIXELS = 1200
COMPACTNESS = 8.0  # of SLIC: how much place counts against colour
CONTRAST = 12.0  # CIELAB units: across such a difference of colour a walk goes e⁻¹ times as often
WEAKEST = 1e-4  # weight of the strongest edge of colour: every walk arrives somewhere
FRAME_STRENGTH = 0.02  # of the picture's frame as background, against a click's
DEEP = 3.0  # how much depth inside a region counts against distance from clicks
MOST_CLICKS = 500
MOST_STROKES = 50  # each keeps a byte for every pixel of the picture
BACKGROUND = 0


@dataclass(frozen=True)
class Click:
    """A point (column, row) of the picture that belongs to a region, 0: to the background."""

    column: int
    row: int
    region: int


@dataclass(frozen=True)
class Marks:
    """All from which labels are made, as Selection holds it."""

    given: np.ndarray | None
    clicks: tuple[Click, ...]
    strokes: tuple[tuple[np.ndarray, int], ...]

    def is_same(self, other: "Marks") -> bool:
        """Return whether both hold the very same marks; arrays are not compared by value."""
        return (
            self.given is other.given
            and self.clicks == other.clicks
            and len(self.strokes) == len(other.strokes)
            and all(a is b for a, b in zip(self.strokes, other.strokes, strict=True))
        )


@dataclass
class Selection:
    """The mask of a picture while it is being made.

    display  (H, W, 3) uint8
    given    (H, W) uint8 labels that a file or transparency gave; clicks then divide it into
             regions and remove parts of it. None: clicks make the mask. It is replaced as a whole,
             never written into
    """

    display: np.ndarray
    given: np.ndarray | None = None
    clicks: list[Click] = field(default_factory=list)
    strokes: list[tuple[np.ndarray, int]] = field(default_factory=list)
    _order: list[list] = field(default_factory=list)  # `clicks` or `strokes`, as each was added
    _made: tuple["Marks", np.ndarray] | None = None  # the last result of `labels`
    _small: np.ndarray | None = None  # the last result of `reduced`

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        return self.display.shape[0], self.display.shape[1]

    def click(self, column: float, row: float, region: int) -> None:
        """Add a click. Raises InputError outside the picture, and for too many clicks."""
        height, width = self.size
        where = "a click"
        if not (0 <= column < width and 0 <= row < height):
            rule = f"a point of the picture, {width} × {height}"
            raise InputError(where, rule, f"{column:g}, {row:g}", "click on the picture")
        if not 0 <= region <= MOST_REGIONS:
            rule = f"a region from 0 to {MOST_REGIONS}"
            raise InputError(where, rule, f"{region}", "0 is background")
        if len(self.clicks) >= MOST_CLICKS:
            raise InputError(where, f"at most {MOST_CLICKS} clicks", "one more", "use a mask file")
        self.clicks.append(Click(int(column), int(row), region))
        self._order.append(self.clicks)

    def paint(self, covered: np.ndarray, region: int) -> None:
        """Give the pixels that a brush covered (H, W) bool to a region, 0: to the background.

        Strokes count more than clicks, and later strokes more than earlier ones.
        Raises  InputError for strokes on a picture of another size, and for too many of them
        """
        if covered.shape != self.size:
            rule = f"strokes of the picture's size {self.size[1]} × {self.size[0]}"
            result = " × ".join(map(str, covered.shape[::-1]))
            raise InputError("the brush", rule, result, "load the photograph again")
        if len(self.strokes) >= MOST_STROKES:
            rule, remedy = f"at most {MOST_STROKES} uses of the brush", "use a mask file"
            raise InputError("the brush", rule, "one more", remedy)
        self.strokes.append((np.asarray(covered, bool), region))
        self._order.append(self.strokes)

    def undo(self) -> bool:
        """Take back the last click or strokes, whichever came later; return if there was one."""
        if not self._order:
            return False
        self._order.pop().pop()
        return True

    def clear(self) -> None:
        """Take back all clicks and strokes; what a file gave stays."""
        self.clicks.clear()
        self.strokes.clear()
        self._order.clear()

    @cached_property
    def superpixels(self) -> "Superpixels":
        """The picture's superpixels, made once."""
        return Superpixels.of(self.display)

    def reduced(self, size: tuple[int, int]) -> np.ndarray:
        """Return the picture (h, w, 3) uint8 at another size, (width, height)."""
        if self._small is None or self._small.shape[1::-1] != size:
            picture = Image.fromarray(self.display).resize(size, Image.Resampling.BICUBIC)
            self._small = np.asarray(picture)
        return self._small

    def labels(self) -> np.ndarray:
        """Return labels (H, W) of all that was given, clicked and painted; regions are 1 … S.

        Regions that have no pixels are left out, so that numbers have no gap. The result is kept
        until something is marked, since a photograph of 24 megapixels takes seconds; it is
        read-only.
        """
        marks = Marks(self.given, tuple(self.clicks), tuple(self.strokes))
        if self._made is None or not self._made[0].is_same(marks):
            labels = self._labels()
            labels.flags.writeable = False
            self._made = marks, labels
        return self._made[1]

    def _labels(self) -> np.ndarray:
        result = np.zeros(self.size, np.uint8) if self.given is None else self.given.copy()
        if self.clicks:
            walked = self.superpixels.labels(self.clicks, self.size, frame=self.given is None)
            if self.given is None:
                result = walked
            else:
                inside = (result > 0) & self._concerned(walked)
                result[inside] = walked[inside]
        for covered, region in self.strokes:
            result[covered] = region
        # a count by number takes a tenth of the time that sorting millions of pixels does
        present = np.flatnonzero(np.bincount(result.ravel(), minlength=256)[1:]) + 1
        numbers = np.zeros(256, np.uint8)
        numbers[present] = np.arange(1, len(present) + 1)
        return numbers[result]

    def _concerned(self, walked: np.ndarray) -> np.ndarray:
        """Pixels (H, W) bool of a given mask that clicks speak about.

        Where only parts are clicked away, or only one further region is marked, the rest keeps the
        region that it had: as if each given region had been clicked where it is farthest from all
        clicks.
        """
        assert self.given is not None
        clicked = {click.region for click in self.clicks}
        kept = [level for level in np.unique(self.given) if level and level not in clicked]
        if not kept:
            return np.ones(self.size, bool)
        marks = np.ones(self.size, bool)
        for click in self.clicks:
            marks[click.row, click.column] = False
        from_clicks = distance_transform_edt(marks)
        seeds = []
        for level in kept:
            # deep inside the region, where no superpixel reaches across its edge
            inside = distance_transform_edt(np.pad(self.given == level, 1))[1:-1, 1:-1]
            depth = np.minimum(from_clicks, DEEP * inside)
            row, column = np.unravel_index(int(depth.argmax()), self.size)
            seeds.append(Click(int(column), int(row), MOST_REGIONS + 1))
        again = self.superpixels.labels([*self.clicks, *seeds], self.size, frame=False)
        return again <= MOST_REGIONS


@dataclass(frozen=True)
class Superpixels:
    """Superpixels of a picture reduced to LONGEST.

    index    (h, w) number of each pixel's superpixel
    pairs    (E, 2) neighbours
    weights  (E,) how often a walk crosses from one to the other, up to 1 × the border's length
    frame    (K,) bool: superpixels at the picture's frame
    """

    index: np.ndarray
    pairs: np.ndarray
    weights: np.ndarray
    frame: np.ndarray

    @classmethod
    def of(cls, display: np.ndarray) -> "Superpixels":
        """Return the superpixels of a picture (H, W, 3) uint8."""
        from skimage import color, segmentation

        height, width = display.shape[:2]
        scale = min(1.0, LONGEST / max(height, width))
        size = max(1, round(width * scale)), max(1, round(height * scale))
        small = np.asarray(Image.fromarray(display).resize(size, Image.Resampling.BOX))
        index = segmentation.slic(
            small,
            n_segments=SUPERPIXELS,
            compactness=COMPACTNESS,
            sigma=0.7,
            start_label=0,
            channel_axis=-1,
        )
        _, flat = np.unique(index, return_inverse=True)
        index = flat.reshape(index.shape)
        count = int(index.max()) + 1
        lab = color.rgb2lab(small).reshape(-1, 3)
        area = np.bincount(index.ravel(), minlength=count)
        mean = np.stack([np.bincount(index.ravel(), lab[:, k], count) / area for k in range(3)], -1)
        borders = [(index[:, :-1], index[:, 1:]), (index[:-1], index[1:])]
        both = np.concatenate([np.stack([a[a != b], b[a != b]], -1) for a, b in borders])
        both.sort(1)
        pairs, lengths = np.unique(both.reshape(-1, 2), axis=0, return_counts=True)
        contrast = ((mean[pairs[:, 0]] - mean[pairs[:, 1]]) ** 2).sum(-1) / CONTRAST**2
        weights = lengths * np.maximum(np.exp(-contrast), WEAKEST)
        frame = np.zeros(count, bool)
        for edge in (index[0], index[-1], index[:, 0], index[:, -1]):
            frame[edge] = True
        return cls(index, pairs, weights, frame)

    def labels(self, clicks: list[Click], size: tuple[int, int], frame: bool) -> np.ndarray:
        """Return labels (H, W) of a picture of that size, from clicks in its pixels.

        frame  whether the picture's frame is background, but where it is clicked
        """
        shares, regions = self.probabilities(clicks, size, frame)
        if len(regions) == 1:
            return np.full(size, regions[0], np.uint8)
        # enlarged before the greatest is chosen, so that edges are no stairs of the small picture
        best, result = np.full(size, -1.0, np.float32), np.zeros(size, np.uint8)
        for share, region in zip(shares.T, regions, strict=True):
            picture = Image.fromarray(share[self.index].astype(np.float32))
            large = np.asarray(picture.resize(size[::-1], Image.Resampling.BILINEAR))
            result[large > best] = region
            best = np.maximum(best, large)
        return result

    def probabilities(
        self, clicks: list[Click], size: tuple[int, int], frame: bool
    ) -> tuple[np.ndarray, list[int]]:
        """Return the probability (K, R) of each region for each superpixel, and the regions."""
        count = len(self.frame)
        height, width = self.index.shape
        seeds: dict[int, int] = {}
        for click in clicks:  # of two clicks into one superpixel the later one counts
            row = min(click.row * height // size[0], height - 1)
            column = min(click.column * width // size[1], width - 1)
            seeds[int(self.index[row, column])] = click.region
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
