"""What the page keeps of one user, on the server: in memory, and in a folder of their own.

Nothing is shared between two users, whose sessions learn.app.sessions begins and ends. Files are
bounded before they are decoded (learn.data.photographs), and deleted with the session.
"""

import functools
import re
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from learn.app import background_decomposition, overlay, work_file
from learn.app.background_decomposition import Network, Progress, Stopped
from learn.app.choices import Chosen, Edit, Painted
from learn.app.selection import Selection
from learn.app.viewer import Viewer
from learn.app.work_file import MOST_KEPT
from learn.data import photographs
from learn.editing import decomposition, material_file, photograph
from learn.figures import montage
from learn.refinement import PHOTOGRAPHS
from manifests import files
from manifests.errors import InputError
from shaders import tone

MOST_BYTES = 64 << 20  # of a file that is sent to the page
# of a photograph: cameras and telephones of 24 megapixels make up to 24.5 million. A user's session
# then takes up to 2 GB while it renders
MOST_PIXELS = 25_000_000
SHOWN = (800, 1200)  # least and most pixels of the longer side of the picture that is clicked on
KEPT_VIEWS = 4  # pictures of results that a page may still be loading
ENDING = re.compile(r"\.[a-z0-9]{2,5}")  # of a photograph's file that saved work can have
EXAMPLE = "example:espresso-cup"
THE_PAGE = "the page"  # what an error is about that no file has caused
NEXT = "Next: choose a material"  # the button that decomposes
NO_PHOTOGRAPH = (THE_PAGE, "a photograph", "none", "choose a photograph first, in step 1")
NOT_DECOMPOSED = (
    THE_PAGE,
    "a decomposed photograph",
    "none",
    f"mark the object in step 1 first, and press “{NEXT}”",
)
LOST = (
    THE_PAGE,
    "the photograph of this page",
    "none",
    "the photograph is no longer kept, because the page was left or not used for an hour, or the"
    " program was started again: choose it again, or open work that you saved",
)


@dataclass(frozen=True)
class Kept:
    """An edit that a user keeps to compare it with others, and the file of its picture."""

    edit: Edit
    picture: Path


@dataclass
class Session:
    """One user's photograph, mask, decomposition and choices.

    folder     of this session alone
    soft_mask  of what was decomposed: coverage (H, W) from a file, before it is softened, or None
    by_hand    whether clicks or strokes had a part in what was decomposed
    before     the file of the photograph as the view shows it
    kept       edits to compare, in the order in which they were kept
    beside     the kept one that the view shows on its left, None: the photograph
    number     counts choices: a picture of an earlier one is not shown any more
    is_lost    whether the page had a session that ended, so that it shows what is no longer there
    key        by which the page has its session back after it was loaded again; it is a secret
    """

    folder: Path
    network: Network
    path: Path | None = None
    name: str = ""
    linear: bool = False
    refined: bool = False
    has_mask: bool = False
    coverage: np.ndarray | None = None
    soft_mask: np.ndarray | None = None
    by_hand: bool = False
    selection: Selection | None = None
    viewer: Viewer | None = None
    edit: Edit | None = None
    before: str = ""
    kept: list[Kept] = field(default_factory=list)
    beside: Kept | None = None
    number: int = 0
    is_lost: bool = False
    key: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    stop: threading.Event = field(default_factory=threading.Event)
    used: float = field(default_factory=time.monotonic)
    _views: list[Path] = field(default_factory=list)
    _example_mask: np.ndarray | None = None
    _saved: work_file.Work | None = None  # whose edits follow its photograph's decomposition

    def close(self) -> None:
        """Stop what runs, and delete the session's files."""
        self.stop.set()
        self.number += 1
        self.viewer = self.selection = self.coverage = self.soft_mask = None
        shutil.rmtree(self.folder, ignore_errors=True)

    def load(self, sent: Path) -> str:
        """Take a photograph that was sent, and return a sentence about its mask.

        Raises  InputError: no picture, a damaged or too large one
        """
        return self._accept(sent, *self._read(sent))

    def _read(self, sent: Path) -> tuple[np.ndarray, np.ndarray]:
        """Return radiance (H, W, 3) and alpha (H, W) of a photograph. Raises InputError."""
        radiance, alpha = photographs.read_pixels(sent, MOST_PIXELS)
        height, width = radiance.shape[:2]
        if height * width > MOST_PIXELS:  # an EXR
            rule = f"at most {MOST_PIXELS / 1e6:g} megapixels"
            raise InputError(sent, rule, f"{width} × {height}", "make it smaller")
        photographs.require_finite(sent, radiance)
        return radiance, alpha

    def _accept(self, sent: Path, radiance: np.ndarray, alpha: np.ndarray) -> str:
        """Take a photograph that was read; return a sentence about its mask."""
        ending = sent.suffix.lower()
        if not ENDING.fullmatch(ending):  # such as .jpg_large, which saved work could not have
            ending = ".img"
        path = self.folder / f"photograph{ending}"
        files.write_bytes(path, sent.read_bytes())
        self._take(path, sent.name, radiance)
        if (alpha < 0.5).any():
            self.coverage = alpha
            assert self.selection is not None
            self.selection.given = (alpha >= 0.5).astype(np.uint8)
            return "The object is what is not transparent. Clicks can divide it into parts."
        return (
            "Now click on the object, once on each of its surfaces. Or choose *Draw* and draw a"
            " line around it."
        )

    def load_example(self) -> str:
        """Take the program's example, a cup on a saucer, with its two regions."""
        path, regions = photograph.resolve_example(EXAMPLE, [], None)
        assert regions is not None
        radiance, _ = photographs.read_pixels(path)
        self._take(path, EXAMPLE, radiance)
        assert self.selection is not None
        self._example_mask = photographs.read_labels(regions, radiance.shape[:2])
        self.selection.given = self._example_mask
        return f"The example is marked already, in two parts: cup and saucer. Press “{NEXT}”."

    def load_work(self, sent: Path) -> str:
        """Take saved work: its photograph and mask now, its edits once it is decomposed.

        Raises  InputError: no saved work, a damaged or too large file
        """
        folder = self.folder / f"work-{secrets.token_hex(6)}"
        folder.mkdir()
        try:
            try:
                self._open_work(work_file.read(sent, folder))
            except InputError as error:  # the names of files alone are what the user knows
                name = Path(str(error.where).replace(str(folder), "").lstrip("/")).name
                where = sent.name if name == sent.name else f"{sent.name}: {name}"
                result = str(error.found).replace(str(folder), "").lstrip("/")
                raise InputError(where, error.expected, result, error.remedy) from None
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        return (
            "Your saved work is open. Its edits follow in step 2 as soon as the object is analysed."
        )

    def _open_work(self, work: work_file.Work) -> None:
        if work.photograph is None and work.name != EXAMPLE:
            raise InputError(work.name, EXAMPLE, "another example", work_file.REMEDY)
        # all files are read before the photograph that is open gives way
        opened = work.photograph or photograph.resolve_example(EXAMPLE, [], None)[0]
        radiance, alpha = self._read(opened)
        if work.mask is not None:
            coverage = photographs.read_mask(work.mask, radiance.shape[:2])
            photographs.require_object(work.mask, coverage)
        if work.regions is not None:
            photographs.read_labels(work.regions, radiance.shape[:2])
        if work.photograph is None:
            self.load_example()
        else:
            self._accept(opened, radiance, alpha)
            self.name = work.name
        if work.mask is not None:
            self.give_mask(work.mask)
        if work.regions is not None:
            selection = self.opened()
            selection.given = photographs.read_labels(work.regions, selection.size)
        self._saved, self.refined = work, work.refined

    def _take(self, path: Path, name: str, radiance: np.ndarray) -> None:
        self.is_lost, self._saved, self._example_mask = False, None, None
        for each in self.kept:
            each.picture.unlink(missing_ok=True)
        self.kept, self.beside = [], None
        self.number += 1
        self.stop.set()
        self.path, self.name, self.linear = path, name, photographs.holds_radiance(path)
        self.viewer = self.edit = self.coverage = self.soft_mask = None
        self.has_mask = False
        exposure = 1.0
        if self.linear:
            everywhere = np.ones(radiance.shape[:2], bool)
            exposure = tone.auto_exposure(radiance, everywhere)
        self.selection = Selection(display_of(radiance, exposure))

    def give_mask(self, sent: Path) -> str:
        """Take a mask's file: grey, or one value for each region. Raises InputError."""
        selection = self.opened()
        coverage = photographs.read_mask(sent, selection.size)
        photographs.require_object(sent, coverage)
        selection.given = (coverage >= 0.5).astype(np.uint8)
        selection.clear()
        self.coverage, self.has_mask = coverage, True
        return "The mask is taken from the file. Clicks can divide it into parts."

    def give_regions(self, sent: Path) -> str:
        """Take a file with one grey or colour for each region. Raises InputError."""
        selection = self.opened()
        selection.given = photographs.read_labels(sent, selection.size)
        selection.clear()
        self.coverage, self.has_mask = None, False
        return "The regions are taken from the file."

    def opened(self) -> Selection:
        """Return the selection of the photograph. Raises InputError before there is one."""
        if self.selection is None:
            raise InputError(*(LOST if self.is_lost else NO_PHOTOGRAPH))
        return self.selection

    @property
    def scale(self) -> float:
        """Pixels of the picture that is clicked on for one of the photograph."""
        longest = max(self.opened().size)
        return float(np.clip(longest, *SHOWN) / longest)

    def click(self, column: float, row: float, region: int) -> None:
        """Add a click on the picture of `overlay`. Raises InputError."""
        self.opened().click(column / self.scale, row / self.scale, region)

    def paint(self, strokes: Sequence[np.ndarray], region: int) -> None:
        """Add strokes, each (h, w) bool, on the picture of `reduced`. Raises InputError."""
        self.opened().paint(self._enlarged(strokes), region)

    def enclose(self, strokes: Sequence[np.ndarray], region: int) -> None:
        """Take strokes, each (h, w) bool, for a line around the object. Raises InputError."""
        self.opened().enclose(self._enlarged(strokes), region)

    def _enlarged(self, strokes: Sequence[np.ndarray]) -> np.ndarray:
        """Return which pixels (H, W) bool of the photograph strokes on `reduced` cover."""
        selection, size = self.opened(), self.reduced().shape[:2]
        for covered in strokes:
            if covered.shape != size:
                rule = f"strokes of the picture's size {size[1]} × {size[0]}"
                result = " × ".join(map(str, covered.shape[::-1]))
                raise InputError("the brush", rule, result, "load the photograph again")
        covered = np.logical_or.reduce(list(strokes))
        rows, columns = selection.size
        whole = Image.fromarray(covered).resize((columns, rows), Image.Resampling.NEAREST)
        return np.asarray(whole)

    def reduced(self) -> np.ndarray:
        """Return the photograph (h, w, 3) uint8, scaled."""
        return self.opened().reduced(overlay.size_of(self.opened(), self.scale))

    def overlay(self) -> np.ndarray:
        """Return the photograph (h, w, 3) uint8, scaled, with its regions in colour."""
        return overlay.draw(self.opened(), self.scale)

    def marked(self) -> photograph.Photograph:
        """Return the Photograph with its mask and regions. Raises InputError."""
        selection = self.opened()
        assert self.path is not None
        labels = selection.labels()
        if not labels.any():
            rule = "an object: a click on it, a mask file, strokes of the brush, or transparency"
            raise InputError(THE_PAGE, rule, "none", "click on the object in the picture first")
        covered, changed = self._soft_mask(labels)
        cut_out = covered is not None and not self.has_mask and labels.max() == 1
        if cut_out and not changed:
            return photograph.from_arrays(self.path, name=self.name)
        regions = labels if labels.max() > 1 else None
        mask = covered if covered is not None else None
        if mask is None and regions is None:
            mask = labels > 0
        return photograph.from_arrays(self.path, mask, regions, name=self.name)

    def _soft_mask(self, labels: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """Return the coverage (H, W) of a file, and whether clicks or strokes changed it.

        It has the file's soft edges where they left the object as it is. None without a file.
        """
        if self.coverage is None:
            return None, False
        changed = (labels > 0) != (self.coverage >= 0.5)
        covered = np.where(changed, (labels > 0).astype(np.float32), self.coverage)
        return covered, bool(changed.any())

    @property
    def saved_was_refined(self) -> bool:
        """Whether saved work is open that was refined, and is not decomposed yet."""
        return self._saved is not None and self._saved.refined

    def decompose(self, refine: bool = True, goes_on: bool = False) -> Iterator[Progress]:
        """Decompose the photograph and yield the progress.

        An earlier decomposition that still goes on is stopped: it may be of another mask.

        goes_on  whether the edit stays as it is, where the regions are as many as before
        Raises   InputError; Stopped
        """
        opened, selection = self.marked(), self.opened()
        soft_mask, _ = self._soft_mask(selection.labels())
        by_hand = bool(selection.marks) or selection.given is not self._example_mask
        self.stop.set()
        self.stop = stop = threading.Event()
        self.number += 1
        decomposed = yield from background_decomposition.decompose(
            opened, self.network, refine, stop
        )
        yield Progress(0.97, "preparing the view")
        viewer = Viewer(decomposed)
        if stop.is_set():
            raise Stopped
        self.viewer, self.refined = viewer, refine
        self.soft_mask, self.by_hand = soft_mask, by_hand
        before = self.edit
        self.edit, kept = self._edits_of(opened.count)
        if goes_on and before is not None and len(before.regions) == opened.count:
            self.edit = before
        self.beside = None
        for each in self.kept:
            each.picture.unlink(missing_ok=True)
        self.kept = [Kept(e, self.write_view(viewer.view(e), "kept")) for e in kept]

    def _edits_of(self, count: int) -> tuple[Edit, list[Edit]]:
        """Return the edit of a new decomposition with `count` regions, and those kept.

        They are saved work's. Kept ones of the decomposition before stay.
        """
        saved, self._saved = self._saved, None
        kept = [each.edit for each in self.kept] if saved is None else list(saved.kept)
        edit = Edit(tuple(Painted() for _ in range(count)))
        if saved is not None and len(saved.edit.regions) == count:
            edit = saved.edit
        return edit, [each for each in kept if len(each.regions) == count]

    def decomposed(self) -> tuple[Viewer, Edit]:
        """Return the viewer and the edit. Raises InputError before there is a decomposition."""
        if self.viewer is None or self.edit is None:
            raise InputError(*(LOST if self.is_lost else NOT_DECOMPOSED))
        return self.viewer, self.edit

    def choose(self, change: Callable[[Edit], Edit]) -> int:
        """Change the edit; return the number of the choice. Raises InputError."""
        _, edit = self.decomposed()
        self.edit = change(edit)
        self.number += 1
        return self.number

    def keep(self) -> None:
        """Keep the edit to compare it with others. Raises InputError for too many."""
        viewer, edit = self.decomposed()
        if any(each.edit == edit for each in self.kept):
            return
        if len(self.kept) >= MOST_KEPT:
            rule = f"at most {MOST_KEPT} kept pictures"
            raise InputError(
                THE_PAGE, rule, "one more", f"{rule} can be compared: remove one first"
            )
        self.kept.append(Kept(edit, self.write_view(viewer.view(edit, True), "kept")))

    def forget(self, number: int) -> None:
        """Keep the kept edit `number`, 0 the first, no longer. Raises InputError."""
        kept = self.kept_edit(number)
        self.kept.remove(kept)
        if self.beside is kept:
            self.beside = None
        kept.picture.unlink(missing_ok=True)

    def kept_edit(self, number: int) -> Kept:
        """Return a kept edit, 0 the first. Raises InputError."""
        if not 0 <= number < len(self.kept):
            raise InputError(THE_PAGE, "a kept picture", "none", "the picture is no longer kept")
        return self.kept[number]

    @property
    def left(self) -> str:
        """The file that the view shows on its left: the photograph, or a kept edit's picture."""
        return self.before if self.beside is None else str(self.beside.picture)

    def materials_of(self, sent: Path, name: str, number: int) -> dict[int, Chosen]:
        """Return {region: material} of another picture's object, or of a material.json.

        number  of the region that a single material is for; a file of several has one for each
                region, as `brdfactory edit` takes it
        Raises  InputError: no picture with transparency, no material, another number of them
        """
        if sent.suffix.lower() == ".json":
            labels, were = material_file.read_with_origin(sent)
            count = len(self.decomposed()[1].regions)
            if len(labels) not in (1, count):
                rule = (
                    "one material"
                    if count == 1
                    else f"one material, or {count}: one for each region"
                )
                remedy = "give the photograph these regions, or keep one label in the file"
                raise InputError(sent, rule, f"{len(labels)}", remedy)
            if len(labels) > 1:
                return {
                    region: Chosen(f"{name}, region {region}", label, named=False, read=read)
                    for region, (label, read) in enumerate(zip(labels, were, strict=True), 1)
                }
            return {number: Chosen(name, labels[0], named=False, read=were[0])}
        opened = photograph.from_arrays(sent, name=name)
        network, metadata = self.network.loaded()
        settings = PHOTOGRAPHS if self.refined else None
        label = decomposition.decompose(opened, network, metadata["size"], settings).label[0]
        return {number: Chosen(name, label, named=False, read=True)}

    def write_view(self, picture: np.ndarray, stem: str = "view") -> Path:
        """Write a picture to show, and delete earlier ones that no page loads any more."""
        ending = ".png" if picture.shape[-1] == 4 else ".jpg"
        path = self.folder / f"{stem}-{secrets.token_hex(6)}{ending}"
        options: dict[str, Any] = {"quality": 90} if ending == ".jpg" else {"compress_level": 1}
        files.write_image(path, picture, **options)
        if stem == "view":
            self._views.append(path)
            for old in self._views[:-KEPT_VIEWS]:
                old.unlink(missing_ok=True)
            del self._views[:-KEPT_VIEWS]
        return path


@functools.cache
def display_table() -> np.ndarray:
    """Return the display values (65536,) uint8 of linear values 0 to 1 in equal steps."""
    return montage.eight_bit(tone.display(np.arange(65536) / 65535, 1.0))


def display_of(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Return display values (H, W, 3) uint8 of linear radiance.

    They are looked up, which takes a tenth of the time that computing them does: 4 seconds for a
    photograph of 24 megapixels. Values of a file of 8 bits come back as they were.
    """
    steps = np.clip(radiance * np.float32(exposure), 0, 1)
    return display_table()[np.rint(steps * np.float32(65535)).astype(np.uint16)]
