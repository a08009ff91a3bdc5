"""Masks and regions made by marks: clicks, strokes of a brush, and lines around the object.

A click says of one point which region it belongs to, or that it is background, and strokes say it
of all that they cover. A line around the object says that all outside is background, and that the
object is deep inside and of other colours than what is outside. Random walks on superpixels
(learn.selection.superpixels) carry these marks to the rest of the picture; pixels that strokes
cover are what the strokes say.

labels  (H, W) uint8: 0 background, 1 … S the regions
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from PIL import Image
from scipy.ndimage import binary_closing, binary_fill_holes, distance_transform_edt

from learn.data.photographs import MOST_REGIONS
from learn.selection.inside_lines import seeds_inside
from learn.selection.superpixels import BACKGROUND, FEWER, Superpixels
from manifests.errors import InputError

DEEP = 3.0  # how much depth inside a region counts against distance from clicks
MOST_CLICKS = 500
MOST_STROKES = 50  # each keeps a byte for every pixel of the picture
WIDEST_GAP = 0.05  # of the picture's longer side: a gap of a line that is closed
LEAST_ENCLOSED = 0.001  # of the picture
SHOWN_LINE = 400  # pixels of the longer side of the picture in which a line's inside is sought
TOP, BOTTOM, LEFT, RIGHT = np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]
# sides of the frame that may close a line: none, one, or two that meet
CLOSED_SIDES: tuple[tuple, ...] = (
    (),
    *((side,) for side in (TOP, BOTTOM, LEFT, RIGHT)),
    *((one, other) for one in (TOP, BOTTOM) for other in (LEFT, RIGHT)),
)


@dataclass(frozen=True)
class Click:
    """A point (column, row) of the picture that belongs to a region, 0: to the background."""

    column: int
    row: int
    region: int


@dataclass(frozen=True, eq=False)
class Stroke:
    """Pixels (H, W) bool that a brush covered, and their region, 0: the background."""

    covered: np.ndarray
    region: int


@dataclass(frozen=True, eq=False)
class Line:
    """Pixels (H, W) bool that a line around an object encloses, and the object's region."""

    inside: np.ndarray
    region: int


Mark = Click | Stroke | Line


@dataclass
class Selection:
    """The mask of a picture while it is being made.

    display  (H, W, 3) uint8
    given    (H, W) uint8 labels that a file or transparency gave; clicks then divide it into
             regions and remove parts of it. None: marks make the mask. It is replaced as a whole,
             never written into
    marks    what the user marked, in order
    """

    display: np.ndarray
    given: np.ndarray | None = None
    marks: list[Mark] = field(default_factory=list)
    # the last result of `labels`, and of what it was made
    _made: tuple[np.ndarray | None, tuple[Mark, ...], np.ndarray] | None = None
    _small: np.ndarray | None = None  # the last result of `reduced`

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        return self.display.shape[0], self.display.shape[1]

    @property
    def clicks(self) -> list[Click]:
        """The clicks, in order."""
        return [mark for mark in self.marks if isinstance(mark, Click)]

    @property
    def strokes(self) -> list[Stroke]:
        """The strokes, in order."""
        return [mark for mark in self.marks if isinstance(mark, Stroke)]

    @property
    def lines(self) -> list[Line]:
        """The lines around objects, in order."""
        return [mark for mark in self.marks if isinstance(mark, Line)]

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
        self.marks.append(Click(int(column), int(row), region))

    def paint(self, covered: np.ndarray, region: int) -> None:
        """Give the pixels that a brush covered (H, W) bool to a region, 0: to the background.

        Strokes count more than clicks, and later strokes more than earlier ones.
        Raises  InputError for strokes on a picture of another size, and for too many of them
        """
        self._require_room(covered)
        if covered.any():
            self.marks.append(Stroke(np.asarray(covered, bool), region))

    def enclose(self, covered: np.ndarray, region: int) -> None:
        """Take pixels that a brush covered (H, W) bool for a line around an object.

        region  of the object; 0, background, is taken for 1
        Raises  InputError for a line that encloses nothing, and as `paint`
        """
        self._require_room(covered)
        inside = enclosed(np.asarray(covered, bool))
        remedy = "draw it all around the object, up to where it began"
        self.enclose_pixels(inside, region, "the line", remedy)

    def enclose_pixels(self, inside: np.ndarray, region: int, where: str, remedy: str) -> None:
        """Say that pixels (H, W) bool hold an object, and that all others are background.

        region         of the object; 0, background, is taken for 1
        where, remedy  of the error for fewer pixels than LEAST_ENCLOSED
        Raises         InputError
        """
        if inside.mean() < LEAST_ENCLOSED:
            rule = "a closed line around the object"
            raise InputError(where, rule, "one that encloses nothing", remedy)
        self.marks.append(Line(inside, region or 1))

    def _require_room(self, covered: np.ndarray) -> None:
        if covered.shape != self.size:
            rule = f"strokes of the picture's size {self.size[1]} × {self.size[0]}"
            result = " × ".join(map(str, covered.shape[::-1]))
            raise InputError("the brush", rule, result, "load the photograph again")
        if len(self.strokes) + len(self.lines) >= MOST_STROKES:
            rule, remedy = f"at most {MOST_STROKES} uses of the brush", "use a mask file"
            raise InputError("the brush", rule, "one more", remedy)

    def undo(self) -> bool:
        """Take back the last mark; return if there was one."""
        if not self.marks:
            return False
        self.marks.pop()
        return True

    def clear(self) -> None:
        """Take back all marks; what a file gave stays."""
        self.marks.clear()

    @cached_property
    def superpixels(self) -> Superpixels:
        """The picture's superpixels, made once."""
        return Superpixels.of(self.display)

    @cached_property
    def for_clicks(self) -> Superpixels:
        """Those for clicks alone, which have little to set against edges inside the object."""
        return Superpixels.of(self.display, FEWER, lines=False)

    def reduced(self, size: tuple[int, int]) -> np.ndarray:
        """Return the picture (h, w, 3) uint8 at another size, (width, height)."""
        if self._small is None or self._small.shape[1::-1] != size:
            picture = Image.fromarray(self.display).resize(size, Image.Resampling.BICUBIC)
            self._small = np.asarray(picture)
        return self._small

    def labels(self) -> np.ndarray:
        """Return labels (H, W) of all that was given and marked; regions are 1 … S.

        Regions that have no pixels are left out, so that numbers have no gap. The result is kept
        until something is marked, since a photograph of 24 megapixels takes seconds; it is
        read-only.
        """
        marks = tuple(self.marks)
        if self._made is None or not (self._made[0] is self.given and self._made[1] == marks):
            labels = self._labels()
            labels.flags.writeable = False
            self._made = self.given, marks, labels
        return self._made[2]

    def _labels(self) -> np.ndarray:
        if self.given is None:
            result = self._walked() if self.marks else np.zeros(self.size, np.uint8)
        else:
            result = self._divided(self.given)
        for stroke in self.strokes:
            result[stroke.covered] = stroke.region
        # a count by number takes a tenth of the time that sorting millions of pixels does
        present = np.flatnonzero(np.bincount(result.ravel(), minlength=256)[1:]) + 1
        numbers = np.zeros(256, np.uint8)
        numbers[present] = np.arange(1, len(present) + 1)
        return numbers[result]

    def _walked(self) -> np.ndarray:
        """Labels (H, W) where there is no mask, from all marks."""
        lines, clicks = self.lines, self.clicks
        if len(clicks) == len(self.marks):
            return self._walked_from(clicks, frame=True)
        pixels, seeds, marked = self.superpixels, dict[int, int](), dict[int, int]()
        for mark in self.marks:  # of two marks of one superpixel the later one counts
            if isinstance(mark, Click):
                marked[pixels.at(mark.column, mark.row, self.size)] = mark.region
            elif isinstance(mark, Stroke):
                marked |= dict.fromkeys(map(int, pixels.covered(mark.covered)), mark.region)
        kept = set(marked)
        if lines:
            enclosed = np.logical_or.reduce([line.inside for line in lines])
            outside = np.array([], int) if enclosed.all() else pixels.covered(~enclosed)
            seeds |= dict.fromkeys(map(int, outside), BACKGROUND)
            background = {number for number, region in marked.items() if region == BACKGROUND}
            known = outside, background, marked.keys() - background
            inside = [(line.region, *seeds_inside(line.inside, pixels, *known)) for line in lines]
            for _, _, beside in inside:  # first, so that no line takes another one's object away
                seeds |= dict.fromkeys(map(int, beside), BACKGROUND)
            for region, objects, _ in inside:
                seeds |= dict.fromkeys(map(int, objects), region)
                kept |= set(map(int, objects[:1]))  # each line has an object, however small
        seeds |= marked
        return pixels.labels(seeds, self.size, not lines, kept if lines else None)

    def _divided(self, given: np.ndarray) -> np.ndarray:
        """Labels (H, W) of a given mask as clicks divide it and lines cut it off."""
        result, clicks = given.copy(), self.clicks
        if clicks:
            walked = self._walked_from(clicks)
            inside = (result > 0) & self._concerned(given, clicks)
            result[inside] = walked[inside]
        if self.lines:
            result[~np.logical_or.reduce([line.inside for line in self.lines])] = BACKGROUND
        return result

    def _walked_from(self, clicks: list[Click], frame: bool = False) -> np.ndarray:
        seeds = {self.for_clicks.at(c.column, c.row, self.size): c.region for c in clicks}
        return self.for_clicks.labels(seeds, self.size, frame)

    def _concerned(self, given: np.ndarray, clicks: list[Click]) -> np.ndarray:
        """Pixels (H, W) bool of a given mask that clicks speak about.

        Where only parts are clicked away, or only one further region is marked, the rest keeps the
        region that it had: as if each given region had been clicked where it is farthest from all
        clicks.
        """
        clicked = {click.region for click in clicks}
        kept = [level for level in np.unique(given) if level and level not in clicked]
        if not kept:
            return np.ones(self.size, bool)
        marks = np.ones(self.size, bool)
        for click in clicks:
            marks[click.row, click.column] = False
        from_clicks = distance_transform_edt(marks)
        seeds = []
        for level in kept:
            # deep inside the region, where no superpixel reaches across its edge
            inside = distance_transform_edt(np.pad(given == level, 1))[1:-1, 1:-1]
            depth = np.minimum(from_clicks, DEEP * inside)
            row, column = np.unravel_index(int(depth.argmax()), self.size)
            seeds.append(Click(int(column), int(row), MOST_REGIONS + 1))
        return self._walked_from([*clicks, *seeds]) <= MOST_REGIONS


def enclosed(line: np.ndarray) -> np.ndarray:
    """Return pixels (H, W) bool that a drawn line (H, W) bool encloses, without the line.

    A gap of WIDEST_GAP at most is closed. So is a line that ends at the picture's frame, on one
    side or on two that meet in a corner: the frame may cut the object off.
    """
    scale = min(1.0, SHOWN_LINE / max(line.shape))
    size = max(1, round(line.shape[1] * scale)), max(1, round(line.shape[0] * scale))
    grey = Image.fromarray(line.astype(np.uint8) * 255).resize(size, Image.Resampling.BOX)
    small = np.asarray(grey) > 0
    inside = np.zeros_like(small)
    for gap in (0.0, WIDEST_GAP / 4, WIDEST_GAP / 2, WIDEST_GAP):
        width = round(gap * max(small.shape) / 2)
        disk = np.hypot(*np.mgrid[-width : width + 1, -width : width + 1]) <= width
        closed = binary_closing(np.pad(small, width + 1), disk)[width + 1 :, width + 1 :]
        closed = closed[: small.shape[0], : small.shape[1]]
        for sides in CLOSED_SIDES:
            whole = np.pad(closed, 1)
            for side in sides:
                whole[side] = True
            inside = binary_fill_holes(whole)[1:-1, 1:-1] & ~closed
            if inside.mean() >= LEAST_ENCLOSED:
                whole_size = line.shape[1], line.shape[0]
                large = Image.fromarray(inside).resize(whole_size, Image.Resampling.NEAREST)
                return np.asarray(large) & ~line
    return np.zeros_like(line)
