"""What the page keeps of one user, on the server: in memory, and in a folder of their own.

Nothing is shared between two users, whose sessions learn.app.sessions begins and ends. Files are
bounded before they are decoded (learn.data.photographs), and deleted with the session.
"""

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

from learn.app import background_decomposition, choices, overlay
from learn.app.background_decomposition import Network, Progress, Stopped
from learn.app.choices import Chosen, Edit, Painted
from learn.app.selection import Selection
from learn.app.viewer import Viewer, opacity_of, read_labels
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
NO_PHOTOGRAPH = ("the page", "a photograph", "none", "choose a file, or the example")
NOT_DECOMPOSED = ("the page", "a decomposed photograph", "none", "press Decompose first")


@dataclass
class Session:
    """One user's photograph, mask, decomposition and choices.

    folder     of this session alone
    soft_mask  of what was decomposed: coverage (H, W) from a file, before it is softened, or None
    by_hand    whether clicks or strokes had a part in what was decomposed
    before     the file of the photograph as the view shows it
    number     counts choices: a picture of an earlier one is not shown any more
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
    number: int = 0
    stop: threading.Event = field(default_factory=threading.Event)
    used: float = field(default_factory=time.monotonic)
    _views: list[Path] = field(default_factory=list)

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
        self.viewer = self.edit = self.coverage = self.soft_mask = None
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

    def paint(self, strokes: Sequence[np.ndarray], region: int) -> None:
        """Add strokes, each (h, w) bool, on the picture of `reduced`. Raises InputError."""
        selection, size = self.opened(), self.reduced().shape[:2]
        for covered in strokes:
            if covered.shape != size:
                rule = f"strokes of the picture's size {size[1]} × {size[0]}"
                result = " × ".join(map(str, covered.shape[::-1]))
                raise InputError("the brush", rule, result, "load the photograph again")
        covered = np.logical_or.reduce(list(strokes))
        rows, columns = selection.size
        whole = Image.fromarray(covered).resize((columns, rows), Image.Resampling.NEAREST)
        selection.paint(np.asarray(whole), region)

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
            raise InputError("the mask", rule, "none", "click on the object in the picture")
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

    def decompose(self, refine: bool = True) -> Iterator[Progress]:
        """Decompose the photograph and yield the progress.

        Raises  InputError; Stopped
        """
        opened, selection = self.marked(), self.opened()
        soft_mask, _ = self._soft_mask(selection.labels())
        by_hand = bool(selection.clicks or selection.strokes)
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
        opacity = opacity_of(viewer.decomposition.photograph, edit.hide_background)
        photographs.write_picture(folder / "edited.exr", linear, opacity)
        network = self.network
        _, metadata = network.loaded()
        decomposed = viewer.decomposition
        parts = [p.parts(own) for p, own in zip(edit.regions, decomposed.label, strict=True)]
        first, second = ([each[k][1] for each in parts] for k in (0, -1))
        read = [label.tobytes() for label in (*decomposed.label, *read_labels(edit.regions))]
        for name, labels in (("material.json", first), ("material-blended.json", second)):
            if labels is first or any(len(p.parts(first[0])) > 1 for p in edit.regions):
                each = np.stack(labels)
                framed = decomposed.framed
                were = [label.tobytes() in read for label in each]
                material_file.write(folder / name, each, framed, metadata, network.weights, were)
        masks = self._write_masks(folder, decomposed.photograph)
        choices.write(folder / "edit.json", edit)
        command = choices.command_line(edit, self.name, masks, self.refined, network.weights)
        files.write_text(folder / "command.txt", command + "\n")
        main = [result, folder / "edited.exr", folder / "material.json", folder / "command.txt"]
        others = sorted(path for path in folder.iterdir() if path not in main)
        return [*main, *others], command

    def _write_masks(self, folder: Path, opened: photograph.Photograph) -> list[str]:
        """Write what the command line needs of the mask; return the files' names."""
        if self.name.startswith("example:") and not self.by_hand:
            return []
        names = []
        if not opened.cut_out and (self.soft_mask is not None or opened.count == 1):
            # as it was before the program softened it, which it does each time that it is read
            given = opened.mask if self.soft_mask is None else self.soft_mask
            coverage = np.rint(255 * given.astype(np.float32)).astype(np.uint8)
            files.write_image(folder / "mask.png", coverage, "PNG")
            names.append("mask.png")
        if opened.count > 1:
            files.write_image(folder / "regions.png", opened.regions, "PNG")
            names.append("regions.png")
        return names
