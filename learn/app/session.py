"""What the page keeps of each user, on the server: in memory, and in a folder of their own.

A user is one open page, by the random name that the page has. Nothing is shared between two. Files
are bounded before they are decoded (learn.data.photographs) and deleted with the session: when the
page is closed, after IDLE_SECONDS without a request, when MOST_SESSIONS newer ones are open, or
when the server ends.
"""

import secrets
import shutil
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import torch
from PIL import Image
from scipy.ndimage import binary_dilation

from learn.app import choices
from learn.app.choices import Chosen, Edit, Painted
from learn.app.selection import Selection
from learn.app.viewer import Viewer
from learn.data import photographs
from learn.editing import decomposition, material_file, photograph
from learn.editing.decomposition import Decomposition
from learn.figures import montage
from learn.networks import weights as checkpoint
from learn.refinement import PHOTOGRAPHS
from manifests import files
from manifests.errors import InputError
from shaders import tone

MOST_SESSIONS = 16
IDLE_SECONDS = 3600.0
MOST_BYTES = 64 << 20  # of a file that is sent to the page
MOST_PIXELS = 24_000_000  # of a photograph: a user's session then takes up to 2 GB while it renders
SHOWN = (800, 1200)  # least and most pixels of the longer side of the picture that is clicked on
KEPT_VIEWS = 4  # pictures of results that a page may still be loading
# display colours of the regions on the page; region 1 is the first
REGION_COLORS = np.array(
    [
        (0, 158, 115),
        (230, 159, 0),
        (86, 180, 233),
        (204, 121, 167),
        (240, 228, 66),
        (0, 114, 178),
        (213, 94, 0),
        (150, 150, 150),
    ],
    np.float64,
)
NO_PHOTOGRAPH = ("the page", "a photograph", "none", "choose a file, or the example")
NOT_DECOMPOSED = ("the page", "a decomposed photograph", "none", "press Decompose first")


class Stopped(Exception):
    """The user pressed Stop, or closed the page."""


class Network:
    """The network that decomposes, loaded by the first photograph."""

    def __init__(self, weights: Path, device: str | torch.device = "cpu"):
        self.weights, self.device = weights, device
        self._lock = threading.Lock()
        self._loaded: tuple[torch.nn.Module, dict] | None = None

    def loaded(self) -> tuple[torch.nn.Module, dict]:
        """Return the network and its metadata."""
        with self._lock:
            if self._loaded is None:
                self._loaded = checkpoint.load_parts(self.weights, self.device)
            return self._loaded


@dataclass
class Progress:
    """How far a decomposition is. share: 0 to 1; text: what is being done, for people."""

    share: float
    text: str


@dataclass
class Session:
    """One user's photograph, mask, decomposition and choices.

    folder  of this session alone
    before  the file of the photograph as the view shows it
    number  counts choices: a picture of an earlier one is not shown any more
    """

    folder: Path
    network: Network
    path: Path | None = None
    name: str = ""
    linear: bool = False
    refined: bool = False
    has_mask: bool = False
    coverage: np.ndarray | None = None
    selection: Selection | None = None
    viewer: Viewer | None = None
    edit: Edit | None = None
    before: str = ""
    number: int = 0
    stop: threading.Event = field(default_factory=threading.Event)
    used: float = field(default_factory=time.monotonic)
    _views: list[Path] = field(default_factory=list)

    def close(self) -> None:
        """Stop what runs, and delete the session's files."""
        self.stop.set()
        self.number += 1
        self.viewer = self.selection = self.coverage = None
        shutil.rmtree(self.folder, ignore_errors=True)

    def load(self, sent: Path) -> str:
        """Take a photograph that was sent, and return a sentence about its mask.

        Raises  InputError: no picture, a damaged or too large one
        """
        radiance, alpha = photographs.read_pixels(sent, MOST_PIXELS)
        height, width = radiance.shape[:2]
        if height * width > MOST_PIXELS:  # an EXR
            rule = f"at most {MOST_PIXELS / 1e6:g} megapixels"
            raise InputError(sent, rule, f"{width} × {height}", "make it smaller")
        photographs.require_finite(sent, radiance)
        path = self.folder / f"photograph{sent.suffix.lower()}"
        files.write_bytes(path, sent.read_bytes())
        self._take(path, sent.name, radiance)
        if (alpha < 0.5).any():
            self.coverage = alpha
            assert self.selection is not None
            self.selection.given = (alpha >= 0.5).astype(np.uint8)
            return "The object is what is not transparent. Clicks can divide it into regions."
        return "Now mark the object: click on it, give a mask file, or paint it with the brush."

    def load_example(self) -> str:
        """Take the program's example, a cup on a saucer, with its two regions."""
        path, regions = photograph.example("example:espresso-cup", [], None)
        assert regions is not None
        radiance, _ = photographs.read_pixels(path)
        self._take(path, "example:espresso-cup", radiance)
        assert self.selection is not None
        self.selection.given = photographs.read_labels(regions, radiance.shape[:2])
        return "The example comes with a mask of two regions, cup and saucer. Press Decompose."

    def _take(self, path: Path, name: str, radiance: np.ndarray) -> None:
        self.number += 1
        self.stop.set()
        self.path, self.name, self.linear = path, name, photographs.holds_radiance(path)
        self.viewer = self.edit = self.coverage = None
        self.has_mask = False
        exposure = 1.0
        if self.linear:
            everywhere = np.ones(radiance.shape[:2], bool)
            exposure = tone.auto_exposure(radiance, everywhere)
        self.selection = Selection(montage.eight_bit(tone.display(radiance, exposure)))

    def give_mask(self, sent: Path) -> str:
        """Take a mask's file: grey, or one value for each region. Raises InputError."""
        selection = self.opened()
        coverage = photographs.read_mask(sent, selection.size)
        photographs.require_object(sent, coverage)
        selection.given = (coverage >= 0.5).astype(np.uint8)
        selection.clear()
        self.coverage, self.has_mask = coverage, True
        return "The mask is taken from the file. Clicks can divide it into regions."

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
            raise InputError(*NO_PHOTOGRAPH)
        return self.selection

    @property
    def scale(self) -> float:
        """Pixels of the picture that is clicked on for one of the photograph."""
        longest = max(self.opened().size)
        return float(np.clip(longest, *SHOWN) / longest)

    def click(self, column: float, row: float, region: int) -> None:
        """Add a click on the picture of `overlay`. Raises InputError."""
        self.opened().click(column / self.scale, row / self.scale, region)

    def overlay(self) -> np.ndarray:
        """Return the photograph (h, w, 3) uint8, scaled, with its regions in colour."""
        selection, scale = self.opened(), self.scale
        height, width = (max(1, round(scale * side)) for side in selection.size)
        labels = np.asarray(
            Image.fromarray(selection.labels()).resize((width, height), Image.Resampling.NEAREST)
        )
        display = Image.fromarray(selection.display).resize(
            (width, height), Image.Resampling.BICUBIC
        )
        shown = np.asarray(display, np.float64)
        colors = np.concatenate([np.zeros((1, 3)), REGION_COLORS])[labels]
        inside = (labels > 0)[..., None]
        shown = np.where(inside, 0.55 * shown + 0.45 * colors, 0.8 * shown)
        width = 2
        edge = np.zeros(labels.shape, bool)
        edge[1:] |= labels[1:] != labels[:-1]
        edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
        edge = binary_dilation(edge)
        shown[edge] = 255.0
        rows, columns = np.ogrid[: labels.shape[0], : labels.shape[1]]
        for click in selection.clicks:
            distance = (rows - scale * click.row) ** 2 + (columns - scale * click.column) ** 2
            shown[distance <= (3 * width + 2) ** 2] = 255.0
            color = REGION_COLORS[click.region - 1] if click.region else np.zeros(3)
            shown[distance <= (2 * width + 1) ** 2] = color
        return montage.eight_bit(shown)

    def marked(self) -> photograph.Photograph:
        """Return the Photograph with its mask and regions. Raises InputError."""
        selection = self.opened()
        assert self.path is not None
        labels = selection.labels()
        if not labels.any():
            rule = "an object: a click on it, a mask file, strokes of the brush, or transparency"
            raise InputError("the mask", rule, "none", "click on the object in the picture")
        covered = self.coverage
        if covered is not None:  # soft edges of a file, where clicks left the object as it is
            changed = (labels > 0) != (covered >= 0.5)
            covered = np.where(changed, (labels > 0).astype(np.float32), covered)
        cut_out = covered is not None and not self.has_mask and labels.max() == 1
        if cut_out and not changed.any():
            return photograph.from_arrays(self.path, name=self.name)
        regions = labels if labels.max() > 1 else None
        mask = covered if covered is not None else None
        if mask is None and regions is None:
            mask = labels > 0
        return photograph.from_arrays(self.path, mask, regions, name=self.name)

    def decompose(self, refine: bool = True) -> Iterator[Progress]:
        """Decompose the photograph and yield the progress.

        Raises  InputError; Stopped
        """
        opened = self.marked()
        self.stop = stop = threading.Event()
        self.number += 1
        reports: SimpleQueue[Progress | BaseException | Decomposition] = SimpleQueue()
        began = time.monotonic()

        def watch(done: int, expected: int) -> None:
            if stop.is_set():
                raise Stopped
            share = min(0.15 + 0.8 * done / expected, 0.95)
            seconds = time.monotonic() - began
            left = "" if done < 5 else f", about {seconds * (1 / share - 1):.0f} s left"
            text = f"refining, step {done} of about {max(expected, done)}{left}"
            reports.put(Progress(share, text))

        def work() -> None:
            try:
                reports.put(Progress(0.02, "loading the network"))
                network, metadata = self.network.loaded()
                if stop.is_set():
                    raise Stopped
                reports.put(Progress(0.08, "reading shape, light and material"))
                settings = PHOTOGRAPHS if refine else None
                size = metadata["size"]
                reports.put(decomposition.decompose(opened, network, size, settings, watch))
            except BaseException as error:
                reports.put(error)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        while True:
            try:
                report = reports.get(timeout=0.25)
            except Empty:
                if stop.is_set() and not thread.is_alive():
                    raise Stopped from None
                continue
            while not reports.empty():  # the latest one
                if not isinstance(report, Progress):
                    break
                report = reports.get()
            if isinstance(report, BaseException):
                raise report
            if isinstance(report, Decomposition):
                break
            yield report
        if stop.is_set():
            raise Stopped
        yield Progress(0.97, "preparing the view")
        viewer = Viewer(report)
        if stop.is_set():
            raise Stopped
        self.viewer, self.refined = viewer, refine
        self.edit = Edit(tuple(Painted() for _ in range(opened.count)))

    def decomposed(self) -> tuple[Viewer, Edit]:
        """Return the viewer and the edit. Raises InputError before there is a decomposition."""
        if self.viewer is None or self.edit is None:
            raise InputError(*NOT_DECOMPOSED)
        return self.viewer, self.edit

    def choose(self, change: Callable[[Edit], Edit]) -> int:
        """Change the edit; return the number of the choice. Raises InputError."""
        _, edit = self.decomposed()
        self.edit = change(edit)
        self.number += 1
        return self.number

    def material_of(self, sent: Path, name: str) -> Chosen:
        """Return the material of another picture's object, or of a material.json.

        Raises  InputError: no picture with transparency, no material
        """
        if sent.suffix.lower() == ".json":
            label = material_file.read(sent)[0]
            return Chosen(name, label, named=False)
        opened = photograph.from_arrays(sent, name=name)
        network, metadata = self.network.loaded()
        settings = PHOTOGRAPHS if self.refined else None
        label = decomposition.decompose(opened, network, metadata["size"], settings).label[0]
        return Chosen(name, label, named=False)

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

    def downloads(self) -> tuple[list[Path], str]:
        """Write the edit at the photograph's size with all that repeats it.

        The result is the files and the command. Raises InputError.
        """
        viewer, edit = self.decomposed()
        linear, display = viewer.full(edit)
        folder = self.folder / "download"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        result = folder / "edited.png"
        photographs.require_finite(result, linear)
        files.write_image(result, display, "PNG")
        photographs.write_exr(folder / "edited.exr", linear)
        network = self.network
        _, metadata = network.loaded()
        decomposed = viewer.decomposition
        first = [p.parts(own)[0][1] for p, own in zip(edit.regions, decomposed.label, strict=True)]
        second = [
            p.parts(own)[-1][1] for p, own in zip(edit.regions, decomposed.label, strict=True)
        ]
        for name, labels in (("material.json", first), ("material-blended.json", second)):
            if labels is first or any(len(p.parts(first[0])) > 1 for p in edit.regions):
                each = np.stack(labels)
                framed = decomposed.framed
                material_file.write(folder / name, each, framed, metadata, network.weights)
        masks = self._write_masks(folder, decomposed.photograph)
        choices.write(folder / "edit.json", edit)
        command = choices.command_line(edit, self.name, masks, self.refined)
        files.write_text(folder / "command.txt", command + "\n")
        main = [result, folder / "edited.exr", folder / "material.json", folder / "command.txt"]
        others = sorted(path for path in folder.iterdir() if path not in main)
        return [*main, *others], command

    def _write_masks(self, folder: Path, opened: photograph.Photograph) -> list[str]:
        """Write what the command line needs of the mask; return the files' names."""
        if self.name.startswith("example:") and not self._was_marked():
            return []
        names = []
        if not opened.cut_out and (self.coverage is not None or opened.count == 1):
            coverage = np.rint(255 * opened.coverage).astype(np.uint8)
            if self.coverage is None:  # softened by the program, each time that it is read
                coverage = np.where(opened.mask, 255, 0).astype(np.uint8)
            files.write_image(folder / "mask.png", coverage, "PNG")
            names.append("mask.png")
        if opened.count > 1:
            files.write_image(folder / "regions.png", opened.regions, "PNG")
            names.append("regions.png")
        return names

    def _was_marked(self) -> bool:
        selection = self.opened()
        return bool(selection.clicks or selection.strokes)


class Sessions:
    """The sessions of all users, by the names of their pages."""

    def __init__(self, folder: Path, network: Network):
        self.folder, self.network = folder, network
        self._sessions: OrderedDict[str, Session] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, name: str) -> Session:
        """Return the session of a page, a new one for a new page."""
        now = time.monotonic()
        with self._lock:
            session = self._sessions.get(name)
            if session is None:
                folder = self.folder / secrets.token_hex(
                    16
                )  # so that its address cannot be guessed
                folder.mkdir(mode=0o700)
                session = self._sessions[name] = Session(folder, self.network)
            session.used = now
            self._sessions.move_to_end(name)
            old = [k for k, each in self._sessions.items() if now - each.used > IDLE_SECONDS]
            more = list(self._sessions)[: max(0, len(self._sessions) - MOST_SESSIONS)]
            ended = [self._sessions.pop(each) for each in dict.fromkeys([*old, *more])]
        for each in ended:
            each.close()
        return session

    def close(self, name: str) -> None:
        """End the session of a page, if there is one."""
        with self._lock:
            session = self._sessions.pop(name, None)
        if session is not None:
            session.close()

    def close_all(self) -> None:
        """End all sessions."""
        for name in list(self._sessions):
            self.close(name)

    def __len__(self) -> int:
        return len(self._sessions)
