"""What estimators ask of a renderer, and what it gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from manifests.schema import Tier


NORMAL = slice(3, 6)  # of guides


class Portion(NamedTuple):
    """Samples first … first + count − 1 of one seed's sequence, or the mean of several such.

    noisy   (height, width, 3) their mean, linear radiance
    alpha   (height, width) the object's coverage
    guides  (height, width, G) what a denoiser sees besides: albedo and normal
    indirect  (height, width, 3) the part of `noisy` that the object reflects onto itself
    """

    noisy: np.ndarray
    alpha: np.ndarray
    guides: np.ndarray
    indirect: np.ndarray


class Effort(NamedTuple):
    """How thoroughly a picture is denoised.

    quality  of Open Image Denoise's network
    flips    of the picture over which the mean is taken, 1 to 4
    cost     processor time, in units of one flip at "HIGH"
    leaves   error, in units of that of the least effort
    prefilter  whether the guides are denoised first
    """

    quality: Literal["BALANCED", "HIGH"]
    flips: int
    cost: float
    leaves: float
    prefilter: bool = False


STANDARD = 64 * 64  # pixels of the frame in which constants of the rules were measured
# by the least samples of a half. At 256² the denoiser takes about a tenth of their time, from 16 on
EFFORTS = {
    0: Effort("BALANCED", 1, cost=0.45, leaves=1.0),
    40: Effort("HIGH", 2, cost=2.0, leaves=0.8),
    128: Effort("HIGH", 4, cost=4.0, leaves=0.74),
}


def effort(samples: int) -> Effort:
    """Return how thoroughly a half of so many samples is denoised."""
    return EFFORTS[max(least for least in EFFORTS if least <= samples)]


class DirectPicture(NamedTuple):
    """Direct light without shadows, by the closed form at a few points of each pixel.

    radiance  (height, width, 3)
    alpha     (height, width) the object's coverage
    variance  (height, width, 3) of the radiance, by the differences of the grids of points, as if
              they had been placed independently; 0 of a single grid
    sampled   whether lobes are so narrow that they are sampled
    """

    radiance: np.ndarray
    alpha: np.ndarray
    variance: np.ndarray
    sampled: bool = False


class DirectWork(NamedTuple):
    """What a DirectPicture takes.

    points   per pixel
    leaning  share of the points whose normals lean from their facets: these take sums of their own
    maps     nodes of the materials' maps, in units of those of a lobe of α = 1. Views of one
             material and light share them
    """

    points: int
    leaning: float = 0.0
    maps: float = 0.0


class Share(NamedTuple):
    """Sums over the rays of each pixel, (height, width, 3) float64.

    arrived  light that rays met
    sent     light of all rays
    """

    arrived: np.ndarray
    sent: np.ndarray

    @property
    def factor(self) -> np.ndarray:
        """By which direct light is multiplied, (height, width, 3) float32; 1 without rays."""
        known = self.sent > 0
        factor = np.ones(self.sent.shape, np.float32)
        np.divide(self.arrived, self.sent, out=factor, where=known, casting="same_kind")
        return factor

    def add(self, other: Share) -> Share:
        """Return the sums over the rays of both."""
        return Share(self.arrived + other.arrived, self.sent + other.sent)


class Renderer(Protocol):
    """What the estimators call: factory.render.studio.Studio, or a substitute without Blender.

    denoised              radiance (height, width, 3) of a portion, or of the mean of several
    direct_light          by so many points per pixel, or more where few mean nothing, or fewer
                          where memory does not suffice. None where no closed form holds. With
                          `where` (height, width) only these pixels, and the others as in `known`;
                          None also where so many points of them do not fit
    direct_light_work     what it takes; None as above
    visible_share         of the direct light, which the object does not block: by `rays` rays from
                          each of a half's points, which are others with each `turn`. None where
                          no closed form holds
    forget_grids          makes `direct_light` see the shape again, as it does in another view
    may_shade_itself      False where the tiers `shadow` and `full` show nothing but direct light
    """

    def portion(self, first: int, count: int, seed: int, tier: Tier) -> Portion: ...

    def denoise(self, portion: Portion, effort: Effort) -> np.ndarray: ...

    def direct_light(
        self, points: int, known: DirectPicture | None = None, where: np.ndarray | None = None
    ) -> DirectPicture | None: ...

    def visible_share(
        self,
        points: int,
        rays: int,
        seed: int,
        half: int,
        where: np.ndarray | None = None,
        turn: int = 0,
    ) -> Share | None: ...

    def direct_light_work(self, points: int) -> DirectWork | None: ...

    def forget_grids(self) -> None: ...

    def may_shade_itself(self) -> bool: ...


@dataclass(frozen=True)
class Shown:
    """What the renderer shows, how its noise is seeded, and the pixels whose errors count.

    mask  (height, width) bool
    """

    renderer: Renderer
    seed: int
    tier: Tier
    mask: np.ndarray
