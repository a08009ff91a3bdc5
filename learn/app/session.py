"""What the page keeps of one user, on the server: in memory, and in a folder of their own.

Nothing is shared between two users, whose sessions learn.app.sessions begins and ends. All files
are deleted with the session.
"""

import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from learn.app import background_decomposition, opening, work_file
from learn.app.background_decomposition import Network, Progress, Stopped
from learn.app.choices import Edit, Painted
from learn.app.marked_photograph import THE_PAGE, MarkedPhotograph
from learn.app.viewer import Viewer
from learn.app.work_file import MOST_KEPT
from learn.editing.photograph import Photograph
from manifests import files
from manifests.errors import InputError

KEPT_VIEWS = 4  # pictures of results that a page may still be loading
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
    "the photograph is no longer kept, because the page was left or not used for an hour, the"
    " program was started again, or this page was opened twice: choose the photograph again, or"
    " open work that you saved",
)


@dataclass(frozen=True)
class Kept:
    """An edit that a user keeps to compare it with others, and the file of its picture."""

    edit: Edit
    picture: Path


@dataclass
class Session:
    """One user's photograph, its decomposition, and choices.

    folder      of this session alone
    photograph  the one that is open, with what is marked in it
    refined     whether what was decomposed was refined
    fit_mask    whether the next decomposition fits the mask's edge (learn.editing.mask_edges)
    fit_was_on  the same of what was decomposed
    shape       the object's in the next decomposition, one of learn.primitives.PRIMITIVES; None:
                predicted
    shape_was   the same of what was decomposed
    soft_mask   of what was decomposed: coverage (H, W) from a file, before it is softened, or None
    by_hand     whether clicks or strokes had a part in what was decomposed
    before      the file of the photograph as the view shows it
    kept        edits to compare, in the order in which they were kept
    beside      the kept one that the view shows on its left, None: the photograph
    number      counts choices: a picture of an earlier one is not shown any more
    is_lost     whether the page had a session that ended, so that it shows what is no longer there
    key         by which the page has its session back after it was loaded again; it is a secret
    """

    folder: Path
    network: Network
    photograph: MarkedPhotograph | None = None
    refined: bool = False
    fit_mask: bool = True
    fit_was_on: bool = True
    shape: str | None = None
    shape_was: str | None = None
    soft_mask: np.ndarray | None = None
    by_hand: bool = False
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
    _clicked_at: float = 0.0
    # held while what belongs together changes: a page sends several requests at once
    _lock: threading.RLock = field(default_factory=threading.RLock)
    _saved: work_file.Work | None = None  # whose edits follow its photograph's decomposition

    def close(self) -> None:
        """Stop what runs, and delete the session's files."""
        self.stop.set()
        self.number += 1
        self.viewer = self.photograph = self.soft_mask = None
        shutil.rmtree(self.folder, ignore_errors=True)

    def load(self, sent: Path) -> str:
        """Take a photograph that was sent, and return a sentence about its mask.

        Raises  InputError: no picture, a damaged or too large one
        """
        opened = opening.open_file(sent, self.folder)
        self._take(opened)
        said = ""
        if opened.reduction is not None:
            said = f"{opened.reduction[0].upper()}{opened.reduction[1:]}. "
        if opened.coverage is not None:
            return said + "The object is what is not transparent. Clicks can divide it into parts."
        dark = (
            "The photograph is very dark, and shown brighter here than it is; a brighter one shows"
            " materials better. "
        )
        return (
            said
            + (dark if opened.is_brightened else "")
            + (
                "Now click on the object, once on each of its surfaces. Or choose *Draw* and draw a"
                " line around it."
            )
        )

    def load_example(self) -> str:
        """Take the program's example, a cup on a saucer, with its two regions."""
        self._take(opening.open_example())
        return f"The example is marked already, in two parts: cup and saucer. Press “{NEXT}”."

    def load_work(self, sent: Path) -> str:
        """Take saved work: its photograph and mask now, its edits once it is decomposed.

        Raises  InputError: no saved work, a damaged or too large file
        """
        opened, work = opening.open_work(sent, self.folder)
        self._take(opened)
        self._saved, self.refined = work, work.refined
        self.fit_mask, self.shape = work.fit_mask, work.shape
        return (
            "Your saved work is open. Its edits follow in step 2 as soon as the object is analysed."
        )

    def _take(self, opened: MarkedPhotograph) -> None:
        with self._lock:
            self.is_lost, self._saved = False, None
            for each in self.kept:
                each.picture.unlink(missing_ok=True)
            self.kept, self.beside = [], None
            self.number += 1
            self.stop.set()
            if self.photograph is not None:  # the shape was that of its object
                self.shape = None
            self.viewer = self.edit = self.soft_mask = None
            self.photograph = opened

    def give_mask(self, sent: Path) -> str:
        """Take a mask's file: grey, or one value for each region. Raises InputError."""
        self.opened().give_mask(sent)
        return "The mask is taken from the file. Clicks can divide it into parts."

    def give_regions(self, sent: Path) -> str:
        """Take a file with one grey or colour for each region. Raises InputError."""
        self.opened().give_regions(sent)
        return "The regions are taken from the file."

    def opened(self) -> MarkedPhotograph:
        """Return the photograph. Raises InputError before there is one."""
        if self.photograph is None:
            raise InputError(*(LOST if self.is_lost else NO_PHOTOGRAPH))
        return self.photograph

    @property
    def saved_was_refined(self) -> bool:
        """Whether saved work is open that was refined, and is not decomposed yet."""
        return self._saved is not None and self._saved.refined

    def decompose(self, refine: bool = True, goes_on: bool = False) -> Iterator[Progress]:
        """Decompose the photograph and yield the progress.

        An earlier decomposition that still goes on is stopped: it may be of another mask.

        The edit stays as it is if the same object is decomposed again with another `fit_mask` or
        `shape`.

        goes_on  whether it stays as it is wherever the regions are as many as before
        Raises   InputError; Stopped
        """
        marked, fit_mask, shape = self.opened(), self.fit_mask, self.shape
        opened, soft_mask, by_hand = marked.to_edit(fit_mask), marked.soft_mask, marked.by_hand
        with self._lock:
            if self.photograph is not marked:
                raise Stopped
            self.stop.set()
            self.stop = stop = threading.Event()
            self.number += 1
        decomposed = yield from background_decomposition.decompose(
            opened, self.network, refine, stop, shape
        )
        yield Progress(0.97, "preparing the view")
        viewer = Viewer(decomposed)
        with self._lock:
            if stop.is_set():
                raise Stopped
            is_changed = (fit_mask, shape) != (self.fit_was_on, self.shape_was)
            goes_on = goes_on or (is_changed and self._shows(opened))
            self.viewer, self.refined = viewer, refine
            self.fit_was_on, self.shape_was = fit_mask, shape
            self.soft_mask, self.by_hand = soft_mask, by_hand
            before = self.edit
            self.edit, kept = self._edits_of(opened.count)
            if goes_on and before is not None and len(before.regions) == opened.count:
                self.edit = before
            self.beside = None
            for each in self.kept:
                each.picture.unlink(missing_ok=True)
            self.kept = [Kept(e, self.write_view(viewer.view(e), "kept")) for e in kept]

    def _shows(self, opened: Photograph) -> bool:
        """Return whether the view is of the same photograph, with the same mask as it was given."""
        if self.viewer is None:
            return False
        shown = self.viewer.decomposition.photograph
        return np.array_equal(shown.given_regions, opened.given_regions)

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
        with self._lock:
            if self.viewer is None or self.edit is None:
                self.opened()
                raise InputError(*NOT_DECOMPOSED)
            return self.viewer, self.edit

    def is_latest_click(self, at: float) -> bool:
        """Return whether no later click came before one; at: its time, as the browser has it.

        Requests that a browser sends one after the other can arrive in another order.
        """
        with self._lock:
            self._clicked_at = max(at, self._clicked_at)
            return at >= self._clicked_at

    def choose(self, change: Callable[[Edit], Edit]) -> int:
        """Change the edit; return the number of the choice. Raises InputError."""
        with self._lock:
            _, edit = self.decomposed()
            self.edit = change(edit)
            self.number += 1
            return self.number

    def keep(self) -> None:
        """Keep the edit to compare it with others. Raises InputError for too many."""
        viewer, edit = self.decomposed()
        picture = viewer.view(edit, True)
        with self._lock:
            if self.viewer is not viewer or any(each.edit == edit for each in self.kept):
                return
            if len(self.kept) >= MOST_KEPT:
                rule = f"at most {MOST_KEPT} kept pictures"
                remedy = f"{rule} can be compared: remove one first"
                raise InputError(THE_PAGE, rule, "one more", remedy)
            self.kept.append(Kept(edit, self.write_view(picture, "kept")))

    def forget(self, kept: Kept) -> None:
        """Keep a kept edit no longer."""
        with self._lock:
            self.kept = [each for each in self.kept if each is not kept]
            if self.beside is kept:
                self.beside = None
        kept.picture.unlink(missing_ok=True)

    def put_beside(self, kept: Kept) -> None:
        """Show a kept edit on the left of the view, or the photograph again if it is there."""
        with self._lock:
            if any(each is kept for each in self.kept):  # not removed meanwhile
                self.beside = None if self.beside is kept else kept

    def kept_edit(self, name: str) -> Kept:
        """Return the kept edit whose picture's file has a name. Raises InputError.

        A number would mean another one after a first click of two on Remove.
        """
        for kept in self.kept:
            if kept.picture.name == name:
                return kept
        raise InputError(THE_PAGE, "a kept picture", "none", "the picture is no longer kept")

    @property
    def left(self) -> str:
        """The file that the view shows on its left: the photograph, or a kept edit's picture."""
        return self.before if self.beside is None else str(self.beside.picture)

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
