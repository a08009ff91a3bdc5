"""A photograph that is open on the page, and what in it is marked as the object.

A user marks on a picture of another size than the photograph's: on that of `overlay`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from learn.data import photographs
from learn.editing import photograph
from learn.selection import overlay
from learn.selection.marks import Selection
from manifests.errors import InputError

SHOWN = (800, 1200)  # least and most pixels of the longer side of the picture that is clicked on
THE_PAGE = "the page"  # what an error is about that no file has caused


@dataclass
class MarkedPhotograph:
    """A photograph's file, and its selection.

    path          of the file on the server
    name          of the file as the user knows it, or of the example
    selection     of its display values
    coverage      (H, W) of a mask's file or of transparency, None without them
    has_mask      whether the coverage is a file's
    is_brightened whether the selection shows a very dark photograph brighter than it is
    example_mask  (H, W) uint8 labels that come with the program's example, else None
    reduction     a sentence that says that the file was made smaller when it was read, else None
    """

    path: Path
    name: str
    selection: Selection
    coverage: np.ndarray | None = None
    has_mask: bool = False
    example_mask: np.ndarray | None = None
    is_brightened: bool = False
    reduction: str | None = None

    def give_mask(self, sent: Path) -> None:
        """Take a mask's file: grey, or one value for each region. Raises InputError."""
        coverage = photographs.read_mask(sent, self.selection.size)
        photographs.require_object(sent, coverage)
        self.selection.given = (coverage >= 0.5).astype(np.uint8)
        self.selection.clear()
        self.coverage, self.has_mask = coverage, True

    def give_regions(self, sent: Path) -> None:
        """Take a file with one grey or colour for each region. Raises InputError."""
        self.selection.given = photographs.read_labels(sent, self.selection.size)
        self.selection.clear()
        self.coverage, self.has_mask = None, False

    @property
    def scale(self) -> float:
        """Pixels of the picture that is clicked on for one of the photograph."""
        longest = max(self.selection.size)
        return float(np.clip(longest, *SHOWN) / longest)

    def click(self, column: float, row: float, region: int) -> None:
        """Add a click on the picture of `overlay`. Raises InputError."""
        self.selection.click(column / self.scale, row / self.scale, region)

    def paint(self, strokes: Sequence[np.ndarray], region: int) -> None:
        """Add strokes, each (h, w) bool, on the picture of `reduced`. Raises InputError."""
        self.selection.paint(self._enlarged(strokes), region)

    def enclose(self, strokes: Sequence[np.ndarray], region: int) -> None:
        """Take strokes, each (h, w) bool, for a line around the object. Raises InputError."""
        self.selection.enclose(self._enlarged(strokes), region)

    def _enlarged(self, strokes: Sequence[np.ndarray]) -> np.ndarray:
        """Return which pixels (H, W) bool of the photograph strokes on `reduced` cover."""
        size = self.reduced().shape[:2]
        for covered in strokes:
            if covered.shape != size:
                rule = f"strokes of the picture's size {size[1]} × {size[0]}"
                result = " × ".join(map(str, covered.shape[::-1]))
                raise InputError("the brush", rule, result, "load the photograph again")
        covered = np.logical_or.reduce(list(strokes))
        rows, columns = self.selection.size
        whole = Image.fromarray(covered).resize((columns, rows), Image.Resampling.NEAREST)
        return np.asarray(whole)

    def reduced(self) -> np.ndarray:
        """Return the photograph (h, w, 3) uint8, scaled."""
        return self.selection.reduced(overlay.size_of(self.selection, self.scale))

    def overlay(self) -> np.ndarray:
        """Return the photograph (h, w, 3) uint8, scaled, with its regions in colour."""
        return overlay.draw(self.selection, self.scale)

    @property
    def is_marked(self) -> bool:
        """Whether anything in it is marked as the object."""
        return bool(self.selection.labels().any())

    @property
    def by_hand(self) -> bool:
        """Whether clicks or strokes had a part in what is marked, or a file: all but an example's
        own mask.
        """
        return bool(self.selection.marks) or self.selection.given is not self.example_mask

    def to_edit(self, fit_mask: bool = True) -> photograph.Photograph:
        """Return the Photograph with its mask and regions.

        fit_mask  whether to fit the mask's edge to the photograph, if the mask is black and white
        Raises    InputError
        """
        labels = self.selection.labels()
        if not labels.any():
            rule = "an object: a click on it, a mask file, strokes of the brush, or transparency"
            raise InputError(THE_PAGE, rule, "none", "click on the object in the picture first")
        covered, changed = self._soft_mask_of(labels)
        cut_out = covered is not None and not self.has_mask and labels.max() == 1
        fitted = None if fit_mask else False
        if cut_out and not changed:
            return self._with(fitted)
        regions = labels if labels.max() > 1 else None
        mask = covered if covered is not None else None
        if mask is None and regions is None:
            mask = labels > 0
        return self._with(fitted, mask, regions)

    def _with(
        self,
        fitted: bool | None,
        mask: np.ndarray | None = None,
        regions: np.ndarray | None = None,
    ) -> photograph.Photograph:
        """Return the Photograph with a mask and regions; errors are in the page's words."""
        try:
            return photograph.from_arrays(self.path, mask, regions, name=self.name, fit_mask=fitted)
        except InputError as error:
            remedy = error.remedy
            if "--exposure" in remedy:  # of an object that is too dark, or an EXR too bright
                remedy = "mark an object that can be seen, or choose a brighter photograph"
                if photographs.holds_radiance(self.path):
                    remedy = "scale the photograph's file so that white is 1"
            where = error.where.replace(self.path.name, self.name)
            raise InputError(where, error.expected, error.found, remedy) from None

    @property
    def soft_mask(self) -> np.ndarray | None:
        """The coverage (H, W) of a file, with its soft edges where marks left the object as it is.

        None without a file.
        """
        return self._soft_mask_of(self.selection.labels())[0]

    def _soft_mask_of(self, labels: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """Return `soft_mask`, and whether clicks or strokes changed it."""
        if self.coverage is None:
            return None, False
        changed = (labels > 0) != (self.coverage >= 0.5)
        covered = np.where(changed, (labels > 0).astype(np.float32), self.coverage)
        return covered, bool(changed.any())
