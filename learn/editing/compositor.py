"""Compositing: renders an object in other materials and puts it back into its photograph.

    edited = share · S · O / (exposure · balance) + (1 − share) · background

where O is the layer's picture of normals, light and target material, times the factor of
learn.editing.mirror_correction, and S the residual shading that is kept
(learn.editing.residual_shading).

- Background behind the object's soft edge: the mean of nearby pixels that the object does not
  cover, corrected so that its mixture with the object's colour is closer to the photograph.
- Share of the object in a pixel's colour: its coverage, or 1 in front of a transparent background.
- Normals: predicted at the network's size, extended beyond the mask by their nearest neighbours,
  upsampled bilinearly, and scaled to unit length. The layer renders them on a grid as fine as the
  photograph, but no coarser than COARSEST and no finer than FINEST.
"""

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt

from learn.data import framing
from learn.data.devices import to_numpy
from learn.editing import mirror_correction, reflectance_store, residual_shading
from learn.editing.backgrounds import background_behind, fill_by_nearby_mean, fill_from_nearest
from learn.editing.decomposition import Decomposition
from learn.editing.photograph import CLEAR
from learn.layer import predictions
from learn.networks.prediction import require_part
from learn.refinement.energy import LABEL_RADIUS, label_weights, raise_mirror_weights
from shaders import tone

# rows of the rendered grid: small objects are supersampled; normals have no detail beyond FINEST
COARSEST, FINEST = 256, 1024


class Compositor:
    """Renders the object of a Decomposition in other materials, and puts it into its photograph.

    tolerance  largest relative error of the rendering layer
    detail     how much of the photograph's residual shading to keep: 0 none, 1 all

    The square about the object has `side` pixels a side in the photograph, and the grid on which
    the layer renders it has `grid`.
    """

    def __init__(
        self,
        decomposition: Decomposition,
        tolerance: float = predictions.SHOWN.tolerance,
        detail: float = 0.0,
    ):
        self.decomposition, self.tolerance, self.detail = decomposition, tolerance, detail
        top, left, side = decomposition.framed.box
        self.side, self.grid = side, int(np.clip(side, COARSEST, FINEST))
        self.regions = framing.cut_square(decomposition.photograph.regions, (top, left, side))
        self.coverage = framing.cut_square(decomposition.photograph.coverage, (top, left, side))
        # unit normals (grid, grid, 3), camera frame
        self.n = upsample_normals(decomposition.parts.n[0], decomposition.framed.mask, self.grid)
        # beyond the object, the number of the nearest region
        self.filled_regions = fill_from_nearest(self.regions, self.regions > 0)
        rows = ((np.arange(self.grid) + 0.5) * side / self.grid).astype(int)
        # from a coarser grid, pixels are interpolated from its neighbours in all directions
        pixels = 1 if side <= self.grid else int(np.ceil(1.5 * side / self.grid))
        wide = dilate(self.coverage > 0, pixels)[rows][:, rows]
        segments = np.where(wide, self.filled_regions[rows][:, rows], 0).astype(np.int64)
        self.segments = torch.from_numpy(segments).to(self.n.device)
        self.own_labels = decomposition.label
        self._own_radiance: np.ndarray | None = None
        self._residual: np.ndarray | None = None
        self._unlabelled: np.ndarray | None = None
        self._background: np.ndarray | None = None
        self._share: np.ndarray | None = None

    def radiance(
        self, label: np.ndarray | torch.Tensor, read: Sequence[np.ndarray] = ()
    ) -> np.ndarray:
        """Return linear radiance (side, side, 3) of the object in the photograph's own exposure.

        label  (S, 108), or (1, 108) for all regions
        read   as `mirror_correction` takes it
        """
        picture = self._render(label, self.decomposition.parts.light, read)
        return picture / self.decomposition.exposure.astype(np.float32)

    def relight(
        self,
        label: np.ndarray | torch.Tensor,
        light: np.ndarray,
        read: Sequence[np.ndarray] = (),
    ) -> np.ndarray:
        """Return linear radiance (H, W, 3) of the object alone under another light.

        The result has the size of the photograph but the scale of the light, and is 0 outside the
        object.

        label  (S, 108), or (1, 108) for all regions
        light  (64, 128, 3), light frame
        read   as `mirror_correction` takes it
        """
        L = torch.from_numpy(light).movedim(-1, 0)[None].to(self.n.device)
        picture = self._render(label, L, read) * (self.coverage > 0)[..., None]
        frame = np.zeros_like(self.decomposition.photograph.radiance)
        return framing.paste_square(frame, picture, self.decomposition.framed.box)

    def _render(
        self,
        label: np.ndarray | torch.Tensor,
        light: torch.Tensor,
        read: Sequence[np.ndarray],
    ) -> np.ndarray:
        """Return radiance (side, side, 3) under a light (1, 3, 64, 128), at the network's scale."""
        labels = to_numpy(torch.as_tensor(label, dtype=torch.float32))
        segments = to_numpy(self.segments)
        picture = np.zeros((self.grid, self.grid, 3), np.float32)
        for number, row in enumerate(labels, 1):
            inside = segments == number if len(labels) > 1 else segments > 0
            if inside.any():
                picture[inside] = self.mirror_correction(
                    row, read
                ) * reflectance_store.radiance_at_normals(
                    row,
                    to_numpy(self.n)[inside],
                    light,
                    self.decomposition.batch.elevation,
                    self.tolerance,
                )
        return self.upsample(picture)

    def mirror_correction(self, label: np.ndarray, read: Sequence[np.ndarray] = ()) -> np.float32:
        """Return the factor that corrects the layer's radiance in a material (108,).

        It is 1 for materials that were read from a picture, this one or another, because they were
        estimated along with normals and a light that have the same errors.

        read  labels (108,) of materials that were read from other pictures
        """
        if any(np.array_equal(label, each) for each in (*self.own_labels, *read)):
            return np.float32(1)
        return np.float32(mirror_correction.factor(label))

    def upsample(self, picture: np.ndarray) -> np.ndarray:
        """Return a picture on the rendered grid at the photograph's size (side, side, 3)."""
        return framing.resize_square(picture, self.side)

    def edit(
        self,
        labels: Sequence[np.ndarray | None],
        read: Sequence[np.ndarray] = (),
        stops: float = 0.0,
    ) -> np.ndarray:
        """Return the photograph (H, W, 3), linear, with its object in other materials.

        labels  a label (108,) for each region, or None for a region that stays as it is; a single
                one is for all regions
        read    as `mirror_correction` takes it
        stops   by which what is rendered is made brighter
        """
        regions = len(self.own_labels)
        requested = list(labels) * regions if len(labels) == 1 else list(labels)
        label = np.stack(
            [
                own if target is None else np.asarray(target, np.float32)
                for own, target in zip(self.own_labels, requested, strict=True)
            ]
        )
        object_ = self.radiance(label, read) * np.float32(2.0**stops)
        if self.detail:
            object_ = object_ * self.kept_shading()
        unchanged = [s + 1 for s in range(regions) if requested[s] is None]
        return self.put_back(object_, np.isin(self.filled_regions, unchanged))

    def render_again(self) -> np.ndarray:
        """Return the photograph (H, W, 3), linear, with its object in its own materials."""
        return self.put_back(self.own_radiance())

    def put_back(
        self, object_: np.ndarray, unchanged: np.ndarray | None = None, alone: bool = False
    ) -> np.ndarray:
        """Return the photograph (H, W, 3), linear, with an object in front of its background.

        object_    (side, side, 3) linear radiance
        unchanged  (side, side) bool: pixels that stay as they are; None: no pixel
        alone      whether the result is to be shown without its background
        """
        photograph = self.decomposition.photograph
        inside = self.share(alone)
        if unchanged is not None:
            inside = inside * ~unchanged
        cut = self._photograph_square()
        soft = (inside > 0) & (inside < 1 - CLEAR)
        behind = np.where(soft[..., None], self.background(), cut) if soft.any() else cut
        mixed = inside[..., None] * object_ + (1 - inside)[..., None] * behind
        return framing.paste_square(
            photograph.radiance, mixed.astype(np.float32), self.decomposition.framed.box
        )

    def share(self, alone: bool = False) -> np.ndarray:
        """Return the object's share (side, side) in the colour of each pixel that it covers.

        A pixel that would be transparent without the object has the object's colour alone.

        alone  whether the result is to be shown without its background
        """
        photograph = self.decomposition.photograph
        if alone or photograph.cut_out:
            return (self.coverage > 0).astype(np.float32)
        if self._share is None:
            self._share = self.coverage
            if photograph.alpha is not None:
                alpha = framing.cut_square(photograph.alpha, self.decomposition.framed.box)
                clear = (self.coverage < CLEAR) & self._inside_photograph()
                behind = (1 - self.coverage) * fill_from_nearest(alpha, clear)
                whole = np.where(self.coverage > 0, self.coverage + behind, 1)
                self._share = (self.coverage / whole).astype(np.float32)
        return self._share

    def background(self) -> np.ndarray:
        """Return radiance (side, side, 3) of what is behind the object's edge.

        It is not corrected in front of a transparent background.
        """
        if self._background is None:
            photograph = self.decomposition.photograph
            cut = self._photograph_square()
            if photograph.alpha is None:
                self._background = background_behind(cut, self.coverage, self._inside_photograph())
            else:
                self._background = fill_by_nearby_mean(
                    cut, (self.coverage < CLEAR) & self._inside_photograph()
                )
        return self._background

    def _inside_photograph(self) -> np.ndarray:
        """Return the square's pixels (side, side) bool that the photograph has."""
        everywhere = np.ones(self.decomposition.photograph.radiance.shape[:2], bool)
        return framing.cut_square(everywhere, self.decomposition.framed.box)

    def own_radiance(self) -> np.ndarray:
        """Return radiance (side, side, 3) of the object in its own materials, rendered once."""
        if self._own_radiance is None:
            self._own_radiance = self.radiance(self.own_labels)
        return self._own_radiance

    def residual(self) -> np.ndarray:
        """Return the residual shading (side, side, 3), natural logarithms, float32.

        Its coarse part is weakened where it has colours, and left out if the user named the shape:
        these normals are right, and what they do not explain is mostly print.
        """
        if self._residual is None:
            parts = (
                self._photograph_square(),
                self.own_radiance(),
                np.where(self.coverage > 1 - CLEAR, self.regions, 0),
                self._label_weights(),
            )
            whole, share = residual_shading.complete_residual(*parts), 0.0
            if self.decomposition.shape is None:
                share = residual_shading.coarse_share(*parts)
            width = residual_shading.FINE_WIDTH * self.side / len(self.decomposition.framed.mask)
            self._residual = residual_shading.weaken(whole, parts[2] > 0, share, width)
        return self._residual

    def kept_shading(self, detail: float | None = None) -> np.ndarray:
        """Return the factors (side, side, 3) float32 of the residual shading that edits keep.

        detail  as of the Compositor; None: its own
        """
        return np.exp(np.float32(self.detail if detail is None else detail) * self.residual())

    def _photograph_square(self) -> np.ndarray:
        """Return linear radiance (side, side, 3) of the photograph in the object's square."""
        return framing.cut_square(
            self.decomposition.photograph.radiance, self.decomposition.framed.box
        )

    def _label_weights(self) -> np.ndarray:
        """Return weights (side, side) of refinement's `label_weights`: 0 on printed labels.

        They are 0 beyond the object, too.

        In a square of more than FINEST pixels a side, only every second, third, … pixel is looked
        at, because each takes about 100 bytes.
        """
        if self._unlabelled is not None:
            return self._unlabelled
        photograph, framed = self.decomposition.photograph, self.decomposition.framed
        step = -(-self.side // FINEST)
        regions = self.regions[::step, ::step]
        inside, seen = regions > 0, self._photograph_square()[::step, ::step]
        clipped = None
        if photograph.clipped is not None:
            share = framing.cut_square(photograph.clipped, framed.box)[::step, ::step].max(-1)
            clipped = torch.from_numpy(share.astype(np.float32))
        numbers = torch.from_numpy(regions.astype(np.int64))
        image = torch.from_numpy(np.float32(seen * tone.auto_exposure(seen, inside)))
        radius = LABEL_RADIUS * len(regions) / len(framed.mask)
        weights = label_weights(image, numbers, clipped, max(round(radius), 1))[inside]
        predicted = to_numpy(require_part(self.decomposition.start.label)[0])
        result = np.zeros(inside.shape, np.float32)
        result[inside] = to_numpy(raise_mirror_weights(weights, numbers[inside], predicted))
        whole = result.repeat(step, 0).repeat(step, 1)[: self.side, : self.side]
        self._unlabelled = np.where(self.regions > 0, whole, 0)
        return self._unlabelled


def upsample_normals(n: torch.Tensor, mask: np.ndarray, size: int) -> torch.Tensor:
    """Upsample n (3, h, w) to unit normals (size, size, 3), extended beyond the mask (h, w)."""
    filled = torch.stack(
        [torch.from_numpy(fill_from_nearest(channel, mask)) for channel in to_numpy(n)]
    ).to(n.device)
    smooth = F.interpolate(
        filled[None], (size, size), mode="bilinear", antialias=size < n.shape[-1]
    )[0]
    return F.normalize(smooth, dim=0).movedim(0, -1).contiguous()


def dilate(mask: np.ndarray, pixels: int = 1) -> np.ndarray:
    """Return the mask (H, W) bool widened by some pixels."""
    return distance_transform_edt(~mask) < pixels + 0.5
