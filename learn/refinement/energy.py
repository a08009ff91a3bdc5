"""What refinement lowers: the picture's difference from what was seen, and how far each property is
from the prediction.

    E = image + a · normals + b · light + c · material

Eq. 6, each term a mean, so that a weight means the same at any size of picture and map
image     mean over pixels and channels of (C(I*) − C(I))²
normals   mean over pixels of |n* − n'|²
light     mean over the sphere (solid angle) and channels of (log(1 + L*) − log(1 + L'))²
material  mean over regions of |z|²/K: distance from the prediction in units of the training
materials' spread; not in Eq. 6, c = 0 there

C(I) = log(1 + 8 e I)/log 9 with the exposure e that brings the object's 99th percentile to 1: as
the display's curve, but a highlight beyond white still counts Deviates  Eq. 6 names neither curve
nor normalisation; sums over pixels and texels would weigh the terms by the picture's size
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from learn.data.devices import array
from learn.layer.predictions import Policy, radiance
from learn.networks.coding import compressed
from learn.training.losses import reduced, solid_angles
from shaders import tone


@dataclass(frozen=True)
class State:
    """label (1, S, 108) float64, light (1, 3, 64, 128), n (1, 3, H, W), and z {name: vector} of
    learn.refinement.coordinates.
    """

    label: torch.Tensor
    light: torch.Tensor
    n: torch.Tensor
    z: dict

    @property
    def drawable(self):
        """Whether the layer takes it: the first stride of a line search may end at a material of
        e^100, or at none.
        """
        material = self.label.detach().exp().to(self.n.dtype)
        return bool(
            ((material > 0) & material.isfinite()).all()
            and self.light.isfinite().all()
            and self.n.isfinite().all()
        )


class Energy:
    """The energy of one picture.

    batch   learn.data.batch.Batch of one
    start   State: the prediction
    """

    def __init__(self, batch, start, settings):
        self.settings, self.start, self.elevation = settings, start, batch.elevation
        inside = (batch.segments[0] > 0) & (batch.mask[0, 0] > 0)
        self.inside = inside.flatten().nonzero()[:, 0]
        self.frame, self.segments = inside[None], batch.segments.clamp(min=1)
        self.regions = start.label.shape[1]
        image = batch.image[0].movedim(0, -1).reshape(-1, 3)
        exposure = tone.auto_exposure(array(image[self.inside]), np.ones(len(self.inside), bool))
        self.exposure, self.seen = exposure, compressed(image * exposure)
        self.log_light = torch.log1p(start.light)
        self.share = solid_angles(start.light)

    def pixels(self, count):
        """Indices of `count` pixels of the object, evenly spread over it; all of them for 0."""
        if not count or count >= len(self.inside):
            return self.inside
        # golden section: any count is even, and no row is preferred
        at = (torch.arange(count) * 0.6180339887498949) % 1
        return self.inside[(at * len(self.inside)).long().unique().to(self.inside.device)]

    def image(self, state, where, light, method, tolerance):
        """Mean square over pixels `where` and channels; all pixels go to the layer as a frame,
        whose neighbours' normals are alike.
        """
        n = state.n.movedim(1, -1)
        whole = len(where) == len(self.inside)
        mask, segments = (
            (self.frame, self.segments)
            if whole
            else (None, self.segments.flatten()[where][None, None])
        )
        picture = radiance(
            n.contiguous() if whole else n.flatten(1, 2)[:, where][:, None],
            state.label,
            reduced(state.light, light),
            segments,
            mask,
            self.elevation,
            Policy(method, tolerance),
        )
        shown = picture.flatten(0, 2)[where] if whole else picture.flatten(0, 2)
        return ((compressed(shown * self.exposure) - self.seen[where]) ** 2).mean()

    def terms(self, state, where, light=(64, 128), method="auto", tolerance=None):
        """{name: scalar}, not yet weighed; tolerance None: the settings'."""
        image = self.image(
            state, where, light, method, self.settings.tolerance if tolerance is None else tolerance
        )
        moved = (state.n - self.start.n).flatten(2)[0].index_select(1, where)
        relit = (torch.log1p(state.light) - self.log_light) ** 2 * self.share
        return {
            "image": image,
            "normals": (moved**2).sum(0).mean(),
            "light": relit.sum((2, 3)).mean(),
            "material": (state.z["material"] ** 2).mean(),
        }

    def total(self, terms):
        """The weighted sum."""
        s = self.settings
        return (
            terms["image"] + s.a * terms["normals"] + s.b * terms["light"] + s.c * terms["material"]
        )

    def finest(self, state):
        """{name: float} of all pixels under the whole map, and "total": what accepts or rejects a
        step; inf for what cannot be drawn.
        """
        if not state.drawable:
            return dict.fromkeys(("image", "normals", "light", "material", "total"), math.inf)
        with torch.no_grad():
            terms = self.terms(state, self.inside)
            return {name: float(value) for name, value in terms.items()} | {
                "total": float(self.total(terms))
            }
