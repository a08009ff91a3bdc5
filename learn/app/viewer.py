"""Edits of a decomposed photograph as a user sees them while choosing, and at full size.

While choosing, the photograph is shown reduced to LONGEST. For a distant viewer, one material and
one light, radiance is a function of the normal alone: a reflectance map (learn.editing.
reflectance_store), which is looked up at each pixel. A quick map takes some hundredths of a second;
the exact one, which takes up to two seconds for mirrors, follows and is kept. A blend is the
weighted sum of its parts' maps.

At full size the layer renders, as `learn edit` does.

Under another light than the photograph's own, or the same one turned, the background remains as it
is, the light has unit mean luminance and the photograph's exposure, and the photograph's fine
shading, which belongs to its own light, is left out.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from PIL import Image

from learn.app.choices import Edit, LightChoice, Painted
from learn.app.composition import Covered, composed, covered_pixels, displayed, with_opacity
from learn.data import framing
from learn.data.devices import to_numpy
from learn.editing import drawing, interactive, reflectance_store
from learn.editing.compositor import Compositor
from learn.editing.decomposition import Decomposition
from learn.figures import montage
from learn.layer import predictions
from shaders import tone

LONGEST = 640  # pixels of the longer side of what is shown while choosing
QUICK = 64  # intervals of a quick map
KEPT_MAPS = 96  # of 0.8 MB at most, for each user


class Superseded(Exception):
    """A later choice made this picture needless."""


class Viewer:
    """Shows edits of one Decomposition."""

    def __init__(self, decomposed: Decomposition):
        self.decomposition = decomposed
        self.small = Compositor(reduced(decomposed, LONGEST), predictions.SHOWN.tolerance)
        self.exposure = drawing.display_exposure(decomposed.photograph)
        self.own_light = to_numpy(decomposed.parts.light[0].movedim(0, -1))
        n, segments = self.small.n, to_numpy(self.small.segments)
        self._pixels = [
            np.flatnonzero(segments == number) for number in range(1, len(decomposed.label) + 1)
        ]
        self._normals = [to_numpy(n.reshape(-1, 3)[torch.from_numpy(at)]) for at in self._pixels]
        self._maps: OrderedDict[tuple[bytes, bytes, bool], np.ndarray] = OrderedDict()
        self._scenes: OrderedDict[bytes, reflectance_store.Scene] = OrderedDict()
        self._lock = threading.Lock()
        self._full: Compositor | None = None
        self._covered: Covered | None = None

    def view(
        self, edit: Edit, exact: bool = False, is_current: Callable[[], bool] = lambda: True
    ) -> np.ndarray:
        """Return a display picture (h, w, 3 or 4) uint8 of an edit, LONGEST pixels at most.

        exact       from exact maps, else from the best that there are
        is_current  asked before each exact map
        Raises      Superseded as soon as is_current says no
        """
        if edit.unchanged:
            return self._shown(self.small.decomposition.photograph.radiance, edit)
        radiance = np.zeros((self.small.grid**2, 3), np.float32)
        for painted, own, at, n in zip(
            edit.regions, self.decomposition.label, self._pixels, self._normals, strict=True
        ):
            if len(at) and not (painted.unchanged and edit.light.unchanged):
                values = self.map_of(painted, own, edit.light, exact, is_current)
                radiance[at] = reflectance_store.interpolate(values, n)
        radiance *= edit.gain
        object_ = self.small.upsample(radiance.reshape(self.small.grid, self.small.grid, 3))
        return self._composed(object_, edit)

    def is_exact(self, edit: Edit) -> bool:
        """Return whether `view` shows an edit from exact maps already."""
        return all(
            self._key(label, edit.light, True) in self._maps
            for painted, own in zip(edit.regions, self.decomposition.label, strict=True)
            for _, label in painted.parts(own)
            if not (painted.unchanged and edit.light.unchanged)
        )

    def map_of(
        self,
        painted: Painted,
        own: np.ndarray,
        light: LightChoice,
        exact: bool,
        is_current: Callable[[], bool] = lambda: True,
    ) -> np.ndarray:
        """Return the reflectance map of a region's material: the weighted sum of a blend's maps.

        Maps have different numbers of nodes; the coarser ones are read at the nodes of the finest.
        """
        values, parts = [], painted.parts(own)
        for _, label in parts:
            if exact and not is_current():
                raise Superseded
            factor = self.small.mirror_correction(label, read_labels([painted]))
            values.append(self._one_map(label, light, exact) * factor)
        size = max(len(each) for each in values)
        total = np.zeros((size, size, 3), np.float32)
        for (weight, _), each in zip(parts, values, strict=True):
            total += np.float32(weight) * reflectance_store.upsample(each, size)
        return total

    def _one_map(self, label: np.ndarray, light: LightChoice, exact: bool) -> np.ndarray:
        with self._lock:
            for key in (self._key(label, light, True), self._key(label, light, False)):
                if key in self._maps and (key[2] or not exact):
                    self._maps.move_to_end(key)
                    return self._maps[key]
        scene = self._scene(light)
        if exact:
            values, _ = reflectance_store.values_of(label, scene)
        else:
            values = reflectance_store.render_map(label, scene, QUICK, "auto")
        with self._lock:
            self._maps[self._key(label, light, exact)] = values
            while len(self._maps) > KEPT_MAPS:
                self._maps.popitem(last=False)
        return values

    def _key(self, label: np.ndarray, light: LightChoice, exact: bool) -> tuple[bytes, bytes, bool]:
        return np.asarray(label, np.float32).tobytes(), light_key(light), exact

    def _scene(self, light: LightChoice) -> reflectance_store.Scene:
        key = light_key(light)
        with self._lock:
            if key not in self._scenes:
                L = torch.from_numpy(np.array(light.of(self.own_light), np.float32))
                scene = interactive.make_scene(
                    self.small, L.movedim(-1, 0)[None].contiguous().to(self.small.n)
                )
                exposure = self.exposure / self.decomposition.exposure
                self._scenes[key] = scene._replace(exposure=exposure)
                while len(self._scenes) > KEPT_MAPS:
                    self._scenes.popitem(last=False)
            return self._scenes[key]

    def full(self, edit: Edit) -> tuple[np.ndarray, np.ndarray]:
        """Return an edit at the photograph's size, rendered by the layer.

        The result is linear radiance (H, W, 3), and display values (H, W, 3 or 4) uint8.
        """
        if self._full is None:
            self._full = Compositor(self.decomposition, predictions.SHOWN.tolerance)
        compositor = self._full
        each = [p.parts(own) for p, own in zip(edit.regions, self.decomposition.label, strict=True)]
        # all regions' first parts at once, then the second ones, each pixel with its weight
        object_: np.ndarray | float = 0.0
        for number in range(max(map(len, each))):
            parts = [region[min(number, len(region) - 1)] for region in each]
            weights = [
                weight if number < len(region) else 0.0
                for (weight, _), region in zip(parts, each, strict=True)
            ]
            label = np.stack([label for _, label in parts]).astype(np.float32)
            rendered = self._rendered(compositor, label, edit)
            share = np.array([0.0, *weights], np.float32)[compositor.filled_regions]
            object_ = object_ + share[..., None] * rendered
        linear = composed(compositor, edit.gain * np.asarray(object_), edit)
        photograph = self.decomposition.photograph
        return linear, displayed(linear, self.exposure, photograph, edit.hide_background)

    def _rendered(self, compositor: Compositor, label: np.ndarray, edit: Edit) -> np.ndarray:
        """Return radiance (side, side, 3) in the photograph's own exposure."""
        light, read = edit.light, read_labels(edit.regions)
        if light.unchanged:
            return compositor.radiance(label, read)
        L = np.ascontiguousarray(light.of(self.own_light), np.float32)
        frame = compositor.relight(label, L, read)
        square = framing.cut_square(frame, self.decomposition.framed.box)
        return square / self.decomposition.exposure.astype(np.float32)

    def _composed(self, object_: np.ndarray, edit: Edit) -> np.ndarray:
        """Return what `composed` and `displayed` make of an object, of the pixels it covers alone.

        object_  (side, side, 3) radiance times the display's exposure
        """
        if self._covered is None:
            self._covered = covered_pixels(self.small, self.exposure)
        covered = self._covered
        inside = np.ones_like(covered.share) if edit.hide_background else covered.share
        values = object_.reshape(-1, 3)[covered.at]
        if edit.light.unchanged:
            values = values * np.exp(np.float32(edit.detail) * covered.residual)
            kept = [number for number, p in enumerate(edit.regions, 1) if p.unchanged]
            inside = inside * ~np.isin(covered.regions, kept)[:, None]
        behind = np.where(inside > 0, covered.behind, covered.photograph)
        mixed = inside * values + (1 - inside) * behind
        shown = covered.display.copy()
        shown[covered.rows, covered.columns] = montage.eight_bit(tone.display(mixed, 1.0))
        photograph = self.small.decomposition.photograph
        return with_opacity(shown, photograph, edit.hide_background)

    def _shown(self, linear: np.ndarray, edit: Edit) -> np.ndarray:
        photograph = self.small.decomposition.photograph
        return displayed(linear, self.exposure, photograph, edit.hide_background)

    def before(self) -> np.ndarray:
        """Return the photograph (h, w, 3 or 4) uint8 as `view` shows it."""
        photograph = self.small.decomposition.photograph
        shown = tone.display(photograph.radiance, self.exposure)
        return montage.eight_bit(drawing.with_alpha(shown, photograph))

    def parts(self) -> list[tuple[str, np.ndarray]]:
        """Return captions and display pictures of the decomposition."""
        decomposed, photograph = self.decomposition, self.small.decomposition.photograph
        n = to_numpy(decomposed.parts.n[0].movedim(0, -1))
        again = drawing.on_ground(
            tone.display(self.small.render_again(), self.exposure), photograph
        )
        names = [f"material {s}" for s in range(1, len(decomposed.label) + 1)]
        return [
            ("shape", montage.normals_picture(n, decomposed.framed.mask)),
            ("light, all directions", montage.light_picture(self.own_light)),
            *(
                (name, drawing.material_sphere(label, decomposed))
                for name, label in zip(names, decomposed.label, strict=True)
            ),
            ("rendered again from these", again),
        ]


def read_labels(regions: Sequence[Painted]) -> list[np.ndarray]:
    """Return the labels (108,) of regions' materials that were read from pictures or files."""
    chosen = (each for painted in regions for each in (painted.first, painted.second))
    return [each.label for each in chosen if each is not None and each.read]


def light_key(light: LightChoice) -> bytes:
    """Return what tells a light from others of the same photograph."""
    return light.columns.to_bytes(2, "little") + (b"" if light.map is None else light.map.tobytes())


def reduced(decomposed: Decomposition, longest: int) -> Decomposition:
    """Return a Decomposition whose photograph has `longest` pixels at most along a side."""
    whole = decomposed.photograph
    height, width = whole.mask.shape
    scale = min(1.0, longest / max(height, width))
    if scale == 1.0:
        return decomposed
    size = max(1, round(height * scale)), max(1, round(width * scale))

    def small(picture: np.ndarray) -> np.ndarray:
        return np.asarray(
            Image.fromarray(np.ascontiguousarray(picture, np.float32)).resize(
                size[::-1], Image.Resampling.BOX
            )
        )

    rows = np.minimum(((np.arange(size[0]) + 0.5) * height / size[0]).astype(int), height - 1)
    columns = np.minimum(((np.arange(size[1]) + 0.5) * width / size[1]).astype(int), width - 1)
    regions = whole.regions[rows][:, columns]
    for number in range(1, whole.count + 1):  # one that lies between the places that are looked at
        if not (regions == number).any():
            regions[small(whole.regions == number) > 0] = number
    photograph = replace(
        whole,
        radiance=np.stack([small(whole.radiance[..., k]) for k in range(3)], -1),
        coverage=small(whole.coverage),
        regions=regions,
        alpha=None if whole.alpha is None else small(whole.alpha),
    )
    top, left, side = decomposed.framed.box
    box = round(top * scale), round(left * scale), max(1, round(side * scale))
    return replace(decomposed, photograph=photograph, framed=replace(decomposed.framed, box=box))
