"""A photograph taken decomposition: what the network says of it, refined or not, and brought to the
photograph's own size.

A Painter renders the object again in any material, and puts it back before its background:
    edited = coverage · O / (exposure · balance) + (1 − coverage) · background
where O is the layer's picture of normals, light and wanted material. The background behind the
object's soft edge is taken from the nearest pixel that the object does not touch. Normals come at
the network's size (128² as a rule), are continued beyond the mask by their nearest neighbour,
enlarged bilinearly and scaled to unit length; the layer renders them on a grid as fine as the
photograph between FINEST and COARSEST.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt, gaussian_filter

from learn.data import photographs
from learn.data.batch import ExampleBatch
from learn.data.devices import array
from learn.editing import predict
from learn.editing.photograph import Photograph
from learn.layer import render
from learn.layer.display_method import method_for
from learn.networks.prediction import Prediction
from learn.refinement import RefinementResult, refine

# rows of the grid rendered: smaller objects are supersampled; normals have no detail finer than
# this
COARSEST, FINEST = 256, 1024
CLEAR = 0.02  # coverage under which a pixel is background
DETAIL_WIDTH = 1.5  # network pixels: what is finer than this, normals do not have
LARGEST_DETAIL = 1.5  # factor


@dataclass(frozen=True)
class Decomposition:
    """framed: what the network saw; batch: of one; start: Prediction; refined: RefinementResult,
    or None where it was not asked for.
    """

    photograph: Photograph
    framed: photographs.Framed
    batch: ExampleBatch
    start: Prediction
    refined: RefinementResult | None

    @property
    def parts(self):
        """The Prediction to edit with."""
        return self.start if self.refined is None else self.refined.prediction

    @property
    def exposure(self):
        """(3,) factors from the photograph's radiance to the network's."""
        return self.framed.exposure * self.photograph.balance


def decompose(photograph, network, size, settings=None):
    """Decomposition. network and size from learn.networks.weights.load_network; settings of
    refinement, None for no refinement.
    """
    framed = photographs.framed(photograph.balanced, photograph.mask, size, photograph.exposure)
    regions = photographs.framed_regions(photograph.regions, framed)
    batch, start = predict.of(framed, network, regions, photograph.count)
    if photograph.record is not None:  # a record's own camera; a photograph's is taken for ours
        batch = replace(batch, elevation=float(np.radians(photograph.record.camera.elevation_deg)))
    return Decomposition(
        photograph,
        framed,
        batch,
        start,
        None if settings is None else refine(batch, start, settings, network.training_labels),
    )


class Painter:
    """Paints a Decomposition in other materials.

    tolerance  of the layer
    detail     how much of the shading that is finer than the network's pixels is kept: 0 none, 1
    all
    """

    def __init__(self, decomposition, tolerance=1e-2, detail=0.0):
        self.decomposition, self.tolerance, self.detail = decomposition, tolerance, detail
        top, left, side = decomposition.framed.box
        self.side, self.grid = side, int(np.clip(side, COARSEST, FINEST))
        self.regions = photographs.placed(decomposition.photograph.regions, (top, left, side))
        self.coverage = photographs.placed(decomposition.photograph.coverage, (top, left, side))
        self.n = enlarged_normals(decomposition.parts.n[0], decomposition.framed.mask, self.grid)
        self.filled = nearest(self.regions, self.regions > 0)
        rows = ((np.arange(self.grid) + 0.5) * side / self.grid).astype(int)
        wide = dilated(self.coverage > 0)[rows][:, rows]
        segments = np.where(wide, self.filled[rows][:, rows], 0).astype(np.int64)
        self.segments = torch.from_numpy(segments).to(self.n.device)
        self.own = array(decomposition.parts.label[0].float())
        self._again = self._ratio = self._behind = None

    def radiance(self, label):
        """(side, side, 3) linear radiance in the photograph's own exposure; label (S, 108) or (1,
        108) for all regions.
        """
        label = torch.as_tensor(label, dtype=torch.float32).to(self.n.device)
        several = len(label) > 1
        with torch.no_grad():
            picture = array(
                render(
                    self.n[None],
                    (label if several else label[0])[None].exp(),
                    self.decomposition.parts.light.movedim(1, -1).contiguous(),
                    segments=self.segments[None] if several else None,
                    mask=self.segments[None] > 0,
                    method=method_for(label),
                    tolerance=self.tolerance,
                    elevation=self.decomposition.batch.elevation,
                )[0]
            )
        return self.enlarged(picture) / self.decomposition.exposure.astype(np.float32)

    def enlarged(self, picture):
        """(side, side, 3) of a picture on the rendered grid."""
        return photographs.resized(picture, self.side)

    def edited(self, labels):
        """(H, W, 3) linear: the photograph with its object in other materials.

        labels  one for each region, each (108,) or None: that region stays as it is; or (1, …): the
        same for all
        """
        regions = len(self.own)
        requested = list(labels) * regions if len(labels) == 1 else list(labels)
        label = np.stack(
            [
                self.own[s] if requested[s] is None else np.asarray(requested[s], np.float32)
                for s in range(regions)
            ]
        )
        object_ = self.radiance(label)
        if self.detail:
            object_ = object_ * self.ratio() ** self.detail
        return self.put_back(
            object_, np.isin(self.filled, [s + 1 for s in range(regions) if requested[s] is None])
        )

    def rendered_again(self):
        """(H, W, 3) linear: the photograph with its object as normals, light and material alone
        make it, none of its detail.
        """
        return self.put_back(self.again())

    def put_back(self, object_, kept=False):
        """(H, W, 3) linear: the photograph with object_ (side, side, 3) before its background; kept
        (side, side): what stays as it is.
        """
        photograph = self.decomposition.photograph
        inside = self.coverage * ~np.asarray(kept)
        cut = photographs.placed(photograph.radiance, self.decomposition.framed.box)
        if photograph.cut_out:
            mixed = np.where((inside > 0)[..., None], object_, cut)
        else:
            if self._behind is None:
                self._behind = nearest(cut, self.coverage < CLEAR)
            soft = (inside > 0) & (inside < 1 - CLEAR)
            mixed = inside[..., None] * object_ + (1 - inside)[..., None] * np.where(
                soft[..., None], self._behind, cut
            )
        return photographs.put_back(
            photograph.radiance, mixed.astype(np.float32), self.decomposition.framed.box
        )

    def again(self):
        """(side, side, 3) radiance of the object in its own materials, rendered once."""
        if self._again is None:
            self._again = self.radiance(self.own)
        return self._again

    def ratio(self):
        """(side, side, 3) the photograph over its own re-rendering, its coarse part taken out:
        shading that normals are too coarse for.
        """
        if self._ratio is None:
            again = self.again()
            seen = photographs.placed(
                self.decomposition.photograph.radiance, self.decomposition.framed.box
            )
            floor = 0.02 * max(float(seen[self.regions > 0].mean()), 1e-6)
            log = np.log(np.maximum(seen, floor)) - np.log(np.maximum(again, floor))
            width = DETAIL_WIDTH * self.side / len(self.decomposition.framed.mask)
            weight = (self.coverage > 1 - CLEAR).astype(np.float32)
            share = np.maximum(gaussian_filter(weight, width), 1e-3)
            fine = [
                (log[..., k] - gaussian_filter(log[..., k] * weight, width) / share) * weight
                for k in range(3)
            ]
            self._ratio = np.exp(
                np.clip(np.stack(fine, -1), -np.log(LARGEST_DETAIL), np.log(LARGEST_DETAIL))
            )
        return self._ratio


def enlarged_normals(n, mask, size):
    """(size, size, 3) unit normals of n (3, h, w), continued beyond the mask (h, w)."""
    filled = torch.stack([torch.from_numpy(nearest(channel, mask)) for channel in array(n)]).to(
        n.device
    )
    smooth = F.interpolate(
        filled[None], (size, size), mode="bilinear", antialias=size < n.shape[-1]
    )[0]
    return F.normalize(smooth, dim=0).movedim(0, -1).contiguous()


def nearest(array, where):
    """The array (H, W) or (H, W, C) with the nearest value from `where` (H, W) put everywhere
    else.
    """
    if not where.any():
        return array
    index = distance_transform_edt(~where, return_distances=False, return_indices=True)
    return array[tuple(index)]


def dilated(mask):
    """The mask and the pixels beside it."""
    return distance_transform_edt(~mask) < 1.5
