"""Direct light without noise, times the share of it that rays find unblocked, plus indirect light.

what      closed form · share of the light that arrives (factory.render.shadow_rays) + indirect
          light, which is denoised unless its noise is small. Rays go where light would come from,
          so that all noise is that of visibility, which is a fraction of path tracing's; what the
          object reflects onto itself is the part of the halves that is left to be denoised, and in
          most shots a small one
halves    each has rays of its own from points of its own, and its own indirect light
bias      of the denoiser, on indirect light alone: the estimate contains it, and a share of the
          noisy one (`SHARES`) keeps it small; where mirror-like surfaces see each other, the
          noisy one alone may be best. That of shadowed direct light is added: it is
          measured by the halves' direct light, and by what is expected before (`DOUBT`)
cost      the closed form, and the rays, which are cast again where the halves differ
fails     where a small lamp is seen in part by a mirror-like surface: noise that more rays reduce
          slowly, and that the halves show
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from factory.render.estimators import blends, closed_form, denoised
from factory.render.estimators.blends import Blend
from factory.render.estimators.halves import Estimate, half_seed, mean_over
from factory.render.estimators.lost_detail import Effect
from factory.render.estimators.renderer import STANDARD, DirectPicture, Share, Shown, effort
from manifests.schema import Estimator
from shaders import tone

NAME: Estimator = "shadow-rays"
POINTS = 64  # per pixel, of which either half has half
FEW_POINTS = 16  # the same where the limit allows it
# limit in a frame of STANDARD pixels from which few do, and by which power of the pixels'
# number it is less in larger frames: what points miss lies at edges. By whether lobes are so narrow
# that they are sampled, of which few points in a small frame miss reflections of lamps
MUCH = {False: (6.0, 0.5), True: (25.0, 1.0)}
ENOUGH = 0.2  # of the limit: noise of the rays that needs no more
# the same once pixels have been given rays in proportion to their noise; and of what is left of the
# limit beside what else is expected
TOLERATED, OF_THE_REST = 0.35, 0.5
# points per pixel of further rounds, where the halves differ, and rays from each: what lies at
# edges is noise of where the points are, which more rays from each leave as it is
FURTHER = ((64, 1), (256, 1), (1024, 1), (1024, 4), (1024, 16))
ROUNDS = 3
GOAL = 0.7  # of the noise that is enough, which a round is planned for
# what shadowed direct light is off by differs between shots by this share of the spread that the
# closed form is expected to have, and by DOUBT besides, by whether lobes are so narrow that they
# are sampled. Measured on own shapes and other meshes (docs/log/rendering.md, "What shadowed direct
# light is off by")
SPREAD, DOUBT = 0.6, {False: 0.1, True: 0.15}
# of the law of `denoised`, of indirect light; the squared bias is at most MOST_LOST of its energy
SCALE, POWER, MOST_LOST = 1.75, 0.45, 0.3
DETAIL = Effect(bias=0.5, noise=0.05)  # on three shots of 256², where indirect light matters
SHARES = blends.UP_TO_ALL  # of noisy indirect light
LITTLE = 0.2  # of the limit: noise of indirect light that is left as it is
MOST_TRIES = 6
LEAST = 4  # samples of each half
MOST_SAMPLES = 1 << 20  # more never help
# samples of each half that take as long: of a frame, per pixel of the mask, and of each pixel, by
# its points
GROUPS, RAYS = 12000.0, {FEW_POINTS: 8.0, POINTS: 14.0}


def cost_in_samples(pixels: int, points: int) -> float:
    """Return the samples of each half that take as long as the rays of so many pixels."""
    return RAYS[points] + GROUPS / max(pixels, 1)


def expected_error(direct: Estimate, sampled: bool) -> Estimate:
    """Return what shadowed direct light is off by, before samples have measured it.

    direct   what the closed form is off by in the tier `direct`
    sampled  whether it has narrow lobes, which are sampled
    """
    spread = math.hypot(SPREAD * direct.standard_error, DOUBT[sampled])
    return Estimate(direct.error, spread)


def expected_scale(pixels: int) -> float:
    """Return the law's scale for a frame of so many pixels before any try has measured it."""
    return SCALE * denoised.size_factor(pixels)


def measure_scale(blend: Blend, noise: float, samples: int) -> float:
    """Return the law's scale by a try; noise: that of indirect light, of `samples` of each half."""
    return denoised.measure_scale(blend, noise, samples, POWER)


def points_of(limit: float, pixels: int, sampled: bool) -> int:
    """Return the points per pixel from which rays are cast, by the limit and the frame's pixels.

    sampled  whether the material has narrow lobes, which are sampled
    """
    much, power = MUCH[sampled]
    return FEW_POINTS if limit * (pixels / STANDARD) ** power >= much else POINTS


def is_little_noise(noise: Estimate, limit: float) -> bool:
    """Whether indirect light has so little noise that denoising it is not worth its time."""
    return noise.noise_bound <= LITTLE * limit


def predict_error(noise: float, scale: float, samples: int, limit: float, known: Estimate) -> float:
    """Return the error of the best blend that a limit allows.

    noise  of indirect light, of so many samples of each half
    known  what shadowed direct light is off by
    """
    return known.error + denoised.predict_error(noise, scale, samples, limit, POWER, SHARES, DETAIL)


def needed_samples(
    noise: float,
    samples: int,
    scale: float,
    limit: float,
    known: Callable[[int], Estimate],
    energy: float = math.inf,
    least: int = LEAST,
) -> int:
    """Return the samples of each half whose picture keeps a limit on error and bias, by the law.

    noise   of indirect light, of `samples` of each half
    known   returns what shadowed direct light is off by as so many samples of each half show it
    energy  of indirect light: the error of a picture without it
    least   samples that are worth a try
    """
    count = least
    while count <= MOST_SAMPLES:
        off = known(count)
        left = limit * (1 - ENOUGH) - off.bound
        most_bias = blends.MOST_BIAS * limit - off.error
        if most_bias <= 0:
            return MOST_SAMPLES + 1
        now = noise * samples / count
        law = scale * now**POWER * effort(count).leaves
        capped = scale * min(1.0, MOST_LOST * energy / max(law, 1e-9))
        for error, bias in denoised.blends_of(now, capped, count, POWER, SHARES, DETAIL):
            if error <= left and bias <= most_bias:
                return count
        count = math.ceil(1.1 * count)
    return count


@dataclass
class ShadowedLight:
    """Direct light with shadows: of either half by rays of its own.

    direct  the closed form's picture
    limit   on the error, by which rays are cast
    known   what it is expected to be off by besides
    shares  of both halves; [] before they are cast
    """

    shown: Shown
    direct: DirectPicture
    limit: float
    known: Estimate = field(default_factory=lambda: Estimate(0.0, 0.0))
    shares: list[Share] = field(default_factory=list)

    @property
    def pictures(self) -> list[np.ndarray]:
        """Radiance (height, width, 3) of both halves."""
        self._cast()
        return [self.direct.radiance * share.factor for share in self.shares]

    @property
    def picture(self) -> np.ndarray:
        """Radiance (height, width, 3) of all rays."""
        one, other = self.pictures
        return (one + other) / np.float32(2)

    @property
    def noise(self) -> Estimate:
        """The error that the rays of both halves leave."""
        return mean_over(self._parts())

    def _parts(self) -> np.ndarray:
        """Return the same of each pixel of the mask, (P,)."""
        mask, mean = self.shown.mask, self.picture
        slope = tone.display_slope(mean[mask], tone.auto_exposure(mean, mask))
        one, other = (each[mask] * slope for each in self.pictures)
        return tone.squared_difference(one, other) / 4

    def _cast(self) -> None:
        """Cast rays until the halves differ by little; where they do not, no more are cast."""
        if self.shares:
            return
        mask, enough = self.shown.mask, ENOUGH * self.limit
        rest = OF_THE_REST * (self.limit - self.known.bound)
        tolerated = max(min(TOLERATED * self.limit, rest), enough)
        first = points_of(self.limit, mask.size, self.direct.sampled)
        self.shares = self._round(0, first, 1, self.direct.alpha > 0)
        cast = np.full(int(mask.sum()), first)  # rays of each pixel
        further = [points * rays for points, rays in FURTHER if points * rays > first]
        levels = np.array([first, *further])
        for number in range(1, ROUNDS + 1):
            parts = self._parts()
            if parts.mean() <= (enough if number == 1 else tolerated):
                return
            by_first = closed_form.with_neighbours(parts * cast / first, mask)
            known = closed_form.points_per_pixel(by_first, cast, levels, GOAL * enough)
            for level, (points, rays) in enumerate(FURTHER):
                where = np.zeros_like(mask)
                where[mask] = (known > cast) & (known == points * rays)
                if where.any():
                    more = self._round(number * len(FURTHER) + level, points, rays, where)
                    self.shares = [
                        one.add(other) for one, other in zip(self.shares, more, strict=True)
                    ]
            cast = np.where(known > cast, cast + known, cast)

    def _round(self, number: int, points: int, rays: int, where: np.ndarray) -> list[Share]:
        """Return both halves' shares by rays from points per pixel, of seeds of their own."""
        shares = []
        for half in (0, 1):
            seed = half_seed(half_seed(self.shown.seed, half) + number, 1)
            share = self.shown.renderer.visible_share(points, rays, seed, half, where, number)
            assert share is not None  # there is a closed form
            shares.append(share)
        return shares

    def measure(self, direct: tuple[np.ndarray, np.ndarray]) -> Estimate:
        """Return what `picture` is off by, without the noise of its rays, as samples show it.

        direct  both halves' direct light with shadows, as it was traced
        """
        measured = closed_form.measure_error(self.picture, direct, self.shown.mask)
        return Estimate(measured.error - self.noise.error, measured.standard_error)
