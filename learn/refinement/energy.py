"""The energy that refinement lowers (Eq. 6): misfit of the picture and distance moved.

    E = image + a · normals + b · light + b_colour · colour + c · material

Each term is a mean, so that a weight means the same at any size of picture and light map.
image     mean over pixels and channels of (C(I*) − C(I))²
normals   mean over pixels of |n* − n'|²
light     mean over the sphere (solid angle) and channels of (log(1 + L*) − log(1 + L'))²
colour    the same of log(FAINT + L) in place of log(1 + L), and of what a channel's difference is
          beyond the mean of the three; not in Eq. 6. The dark parts of a light have to be held to
          their colours too, for they are most of it
material  mean over regions of |z|²/K, the distance from the prediction in units of the training
          materials' spread; not in Eq. 6, c = 0 there

C(I) = log(1 + 8 e I)/log 9, with the exposure e that brings the object's 99th percentile to 1. The
curve is close to the display's, but a highlight beyond white still counts.
Where the file shows white, I is a lower bound: a re-rendering that is brighter costs nothing there.
Of a pixel that is clipped in part, this holds for that share of its cost.
Where a picture has another colour than its object, it is likely to show a print or something in
front, which one material cannot explain: its misfit counts less by `explained_weights` and
`label_weights`, the less the more matte the predicted material is.
Deviates  Eq. 6 names neither curve nor normalisation; sums over pixels and texels would weigh the
          terms by the picture's size
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import maximum_filter

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.layer.albedo import narrow_share
from learn.layer.light_maps import reduce_maps, solid_angles
from learn.layer.predictions import Policy, radiance
from learn.networks.coding import compress
from learn.refinement.settings import RefinementSettings
from shaders import tone

FAINT = 0.05  # of a light's mean: ratios of what is darker count little
DARK = 0.02  # of white: colours of what is darker count little
# the share of a foreign colour in a pixel at which its weight is a half, and how sharply the weight
# falls there: labels need nearly no weight, because their misfit is large, and dust nearly all
FOREIGN, STEEPNESS = 0.27, 8
LABEL_RADIUS = 2  # network pixels, of label_weights
LEAST_UNLABELLED = 0.5  # of a region, if the rest is to be a label
TERMS = ("image", "normals", "light", "colour", "material")


@dataclass(frozen=True)
class State:
    """One point of the descent.

    label (1, S, 108) float64, light (1, 3, 64, 128), n (1, 3, H, W)
    z     {property: vector} of learn.refinement.coordinates
    """

    label: torch.Tensor
    light: torch.Tensor
    n: torch.Tensor
    z: dict[str, torch.Tensor]

    @property
    def is_renderable(self) -> bool:
        """Whether the layer accepts this state.

        The first step of a line search may end at a material of e^100, or at one of zeros.
        """
        material = self.label.detach().exp().to(self.n.dtype)
        return bool(
            ((material > 0) & material.isfinite()).all()
            and self.light.isfinite().all()
            and self.n.isfinite().all()
        )


def misfit(
    rendered: torch.Tensor, seen: torch.Tensor, clipped: torch.Tensor | None = None
) -> torch.Tensor:
    """Return (rendered − seen)² of pictures of one shape, one-sided where `seen` is clipped.

    clipped  shares in [0, 1] of the same shape: that share of the cost counts only where `rendered`
             is darker, because a clipped value says "at least this bright"; None: nothing is
             clipped
    """
    difference = rendered - seen
    if clipped is None:
        return difference**2
    return (1 - clipped) * difference**2 + clipped * difference.clamp(max=0) ** 2


def explained_weights(
    image: torch.Tensor, segments: torch.Tensor, half: float, clipped: torch.Tensor | None = None
) -> torch.Tensor:
    """Return weights (P,) of pixels, 1 where the own colour of their region and white explain them.

    A surface of one material shows its own colour, more or less shaded, and in highlights that of
    the light, which is taken to be white (Shafer 1985). What no sum of both explains is a print, or
    something in front. A print in black or white is not recognised, and a side that is lit in
    another colour is taken for a print.

    image     (P, 3) with white at about 1; segments (P,): regions, whose colour is their median's
    half      share of a pixel that neither explains at which its weight is a half: the setting
              `unexplained_share_at_half_weight`
    clipped   (P,) shares that are clipped, whose colour is not known: they weigh 1
    """
    clipped = torch.zeros_like(image[:, 0]) if clipped is None else clipped
    share = _by_region(_unexplained_share, image, segments, clipped)
    return 1 - (1 - clipped) * (1 - 1 / (1 + (share / half) ** 2))


def label_weights(
    image: torch.Tensor, segments: torch.Tensor, clipped: torch.Tensor | None, radius: int
) -> torch.Tensor:
    """Return weights (H, W): 0 on labels printed on an object, 1 elsewhere and beyond the object.

    Such a label (not the 108 numbers of a material) has a colour clearly unlike that of its region,
    and may be white. It includes its edge and gaps in it, such as letters in black or in the
    object's own colour. A highlight may be white too, but pixels in or near it are clipped in the
    file. A region most of which would be label has many colours, and no label.

    image     (H, W, 3) with white at about 1; segments (H, W): numbers of regions, 0 beyond them
    clipped   (H, W) shares that are clipped; None: nothing is
    radius    largest width of highlights' edges and of gaps in labels, in pixels
    """
    inside = segments > 0
    clipped = torch.zeros_like(image[..., 0]) if clipped is None else clipped
    pixels = image[inside], segments[inside], clipped[inside]
    share = torch.zeros_like(image[..., 0])
    share[inside] = _by_region(_foreign_share, *pixels)
    near = _largest_near(clipped, radius)
    foreign = (1 - near) * (1 - 1 / (1 + (share / FOREIGN) ** STEEPNESS))
    wide = _largest_near(foreign, radius + -(-radius // 2))
    closed = 1 - _largest_near(1 - wide, radius)
    weights = 1 - (1 - near) * closed
    for region in segments[inside].unique():
        of = segments == region
        if weights[of].mean() < LEAST_UNLABELLED:
            weights[of] = 1.0
    return weights


def _largest_near(values: torch.Tensor, radius: int) -> torch.Tensor:
    """Return the largest of values (H, W) within a square of 2 · radius + 1 about each pixel."""
    largest = maximum_filter(to_numpy(values), 2 * radius + 1, mode="nearest")
    return torch.from_numpy(largest).to(values.device)


def raise_mirror_weights(
    weights: torch.Tensor, segments: torch.Tensor, labels: np.ndarray
) -> torch.Tensor:
    """Return weights (P,), raised towards 1 where the material is mirror-like.

    Reflections may have any colour of the surroundings.

    segments  (P,) numbers 1 … S of regions; labels (S, 108) of their materials
    """
    mirrored = torch.tensor([0.0, *map(narrow_share, labels)]).to(weights)[segments]
    return mirrored + (1 - mirrored) * weights


def _by_region(
    share: Callable[[torch.Tensor, torch.Tensor], torch.Tensor],
    image: torch.Tensor,
    segments: torch.Tensor,
    clipped: torch.Tensor,
) -> torch.Tensor:
    """Return `share` (P,) of pixels (P, 3), computed with the own colour of each one's region."""
    result = torch.zeros_like(image[:, 0])
    for region in segments.unique():
        of = segments == region
        sure = of & (clipped == 0)
        result[of] = share(image[of], _own_colour(image[sure if sure.any() else of]))
    return result


def _own_colour(image: torch.Tensor) -> torch.Tensor:
    """Return the median direction (3,), of unit length, of pixels (P, 3) of one region."""
    length = image.norm(dim=-1, keepdim=True).clamp(min=DARK)
    return F.normalize((image / length).median(0).values, dim=0)


def _foreign_share(image: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
    """Return the share (P,) of pixels (P, 3) that no multiple of the colour `own` (3,) explains."""
    shaded = (image @ own)[:, None] * own
    return (image - shaded).norm(dim=-1) / (image.norm(dim=-1) + DARK)


def _unexplained_share(image: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
    """Return the share (P,) of pixels (P, 3) that no sum of a colour (3,) and white explains.

    Sums of both are a sector of the plane that they span; what counts is the distance to its
    nearest point.
    """
    white = F.normalize(torch.ones_like(own), dim=0)
    across = F.normalize(white - (white @ own) * own, dim=0, eps=1e-4)
    along, aside = image @ own, (image @ across).clamp(min=0)
    nearest = along[:, None] * own + aside[:, None] * across
    beyond_white = aside * (white @ own) > along * (white @ across)
    nearest[beyond_white] = (image[beyond_white] @ white)[:, None] * white
    return (image - nearest).norm(dim=-1) / (image.norm(dim=-1) + DARK)


class Compared(NamedTuple):
    """What a re-rendering is compared with at P pixels.

    seen     (P, 3) the picture, compressed
    clipped  (P, 3) shares that are clipped; None: nothing is
    weights  (P, 1) of each pixel's misfit; None: all count alike
    """

    seen: torch.Tensor
    clipped: torch.Tensor | None
    weights: torch.Tensor | None


class Energy:
    """The energy of one picture.

    batch   of one picture; start: the prediction
    """

    def __init__(self, batch: ExampleBatch, start: State, settings: RefinementSettings):
        self.settings, self.start, self.elevation = settings, start, batch.elevation
        inside = (batch.segments[0] > 0) & (batch.mask[0, 0] > 0)
        self.inside = inside.flatten().nonzero()[:, 0]
        self.frame, self.segments = inside[None], batch.segments.clamp(min=1)
        self.regions = start.label.shape[1]
        image = batch.image[0].movedim(0, -1).reshape(-1, 3)
        exposure = tone.auto_exposure(to_numpy(image[self.inside]), np.ones(len(self.inside), bool))
        self.exposure, self.seen = exposure, compress(image * exposure)
        self.clipped = (
            None if batch.clipped is None else batch.clipped[0].movedim(0, -1).reshape(-1, 3)
        )
        self.weights = None
        if settings.unexplained_share_at_half_weight is not None:
            regions = self.segments.flatten()[self.inside].clamp(max=self.regions)
            clipped = None if self.clipped is None else self.clipped[self.inside].amax(-1)
            weights = explained_weights(
                image[self.inside] * exposure,
                regions,
                settings.unexplained_share_at_half_weight,
                clipped,
            )
            whole = None if batch.clipped is None else batch.clipped[0].amax(0)
            picture = batch.image[0].movedim(0, -1) * exposure
            labels = label_weights(picture, self.segments[0] * inside, whole, LABEL_RADIUS)
            weights = torch.minimum(weights, labels[inside])
            self.weights = raise_mirror_weights(weights, regions, to_numpy(start.label[0].detach()))
        self._compared: tuple[torch.Tensor, Compared] | None = None
        self.log_light = torch.log1p(start.light)
        self.log_ratio = (FAINT + start.light).log()
        self.share = solid_angles(start.light)

    def pixels(self, count: int) -> torch.Tensor:
        """Return indices of `count` pixels, evenly spread over the object; 0: of all its pixels."""
        if not count or count >= len(self.inside):
            return self.inside
        # golden section: even for any count, without preferring a row
        at = (torch.arange(count) * 0.6180339887498949) % 1
        return self.inside[(at * len(self.inside)).long().unique().to(self.inside.device)]

    def image(
        self,
        state: State,
        where: torch.Tensor,
        light: tuple[int, int],
        method: str,
        tolerance: float,
    ) -> torch.Tensor:
        """Return the mean square misfit over channels and the pixels `where`.

        All pixels together go to the layer as a frame, in which neighbours have similar normals.
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
            reduce_maps(state.light, light),
            segments,
            mask,
            self.elevation,
            Policy(method, tolerance),
        )
        shown = picture.flatten(0, 2)
        shown = shown.index_select(0, where) if whole else shown
        compared = self.targets(where)
        cost = misfit(compress(shown * self.exposure), compared.seen, compared.clipped)
        return cost.mean() if compared.weights is None else (cost * compared.weights).mean()

    def targets(self, where: torch.Tensor) -> Compared:
        """Return what the pixels `where` are compared with; that of the last ones is kept."""
        if self._compared is None or self._compared[0] is not where:
            clipped = None if self.clipped is None else self.clipped[where]
            weights = None
            if self.weights is not None:
                weights = self.weights[torch.searchsorted(self.inside, where)][:, None]
            self._compared = where, Compared(self.seen[where], clipped, weights)
        return self._compared[1]

    def terms(
        self,
        state: State,
        where: torch.Tensor,
        light: tuple[int, int] = (64, 128),
        method: str | None = None,
        tolerance: float | None = None,
    ) -> dict[str, torch.Tensor]:
        """Return {term: scalar}, without weights; method and tolerance None: the settings'."""
        image = self.image(
            state,
            where,
            light,
            self.settings.method if method is None else method,
            self.settings.tolerance if tolerance is None else tolerance,
        )
        moved = (state.n - self.start.n).flatten(2)[0].index_select(1, where)
        relit = torch.log1p(state.light) - self.log_light
        ratio = (FAINT + state.light).log() - self.log_ratio
        coloured = ratio - ratio.mean(1, keepdim=True)
        return {
            "image": image,
            "normals": (moved**2).sum(0).mean(),
            "light": (relit**2 * self.share).sum((2, 3)).mean(),
            "colour": (coloured**2 * self.share).sum((2, 3)).mean(),
            "material": (state.z["material"] ** 2).mean(),
        }

    def total(self, terms: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the weighted sum of the terms."""
        s = self.settings
        return (
            terms["image"]
            + s.a * terms["normals"]
            + s.b * terms["light"]
            + s.b_colour * terms["colour"]
            + s.c * terms["material"]
        )

    def terms_of_all_pixels(self, state: State) -> dict[str, float]:
        """Return {term: float} and "total" over all pixels under the full light map.

        This total accepts or rejects a step; it is inf for a state that cannot be rendered.
        """
        if not state.is_renderable:
            return dict.fromkeys((*TERMS, "total"), math.inf)
        with torch.no_grad():
            terms = self.terms(state, self.inside)
            return {name: float(value) for name, value in terms.items()} | {
                "total": float(self.total(terms))
            }
