"""The two halves of a picture, and estimates of display errors from their difference."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factory.render.estimators.renderer import Portion, Renderer, Shown, effort
from shaders import tone

if TYPE_CHECKING:
    from manifests.schema import Tier

OWN = 4 / 3  # squared difference over 4 of normal noise: variance 2/3 of its mean square, twice
CONFIDENCE = 1.645  # standard errors: 95 % of a normal distribution lie below
# times the squared darkening of the display curve, for the error that the halves' difference lacks.
# On 22 shots 2 makes estimates right on average, and 3 those of rare light, whose limits are missed
CURVE = 3.0


# standard deviation of the albedo that guides a half, above which guides are denoised first. It is
# 2e-4 to 2.4e-3 where that would blur them, 0.011 on a steel and 0.64 on a flake paint: a
# mirror-like surface has the albedo of what it mirrors
NOISY_GUIDES = 0.005


@dataclass(frozen=True)
class Estimate:
    """An estimate of a display L2, and the standard error of the picture's own about it.

    curve  what the display curve adds to the error of noise, a part of `error`. It falls with the
           square of the samples
    """

    error: float
    standard_error: float
    curve: float = 0.0

    @property
    def noise(self) -> float:
        """The error without the display curve's part, in proportion to 1/samples."""
        return max(self.error, 0.0) - self.curve

    @property
    def noise_bound(self) -> float:
        """`bound` without the display curve's part."""
        return self.bound - self.curve

    @property
    def bound(self) -> float:
        """The error that is not exceeded with 95 % confidence."""
        return max(self.error, 0.0) + CONFIDENCE * self.standard_error


def half_seed(seed: int, half: int) -> int:
    """Return the seed of half 0, the shot's own, or of half 1, a hash of it."""
    if half == 0:
        return seed
    return int.from_bytes(hashlib.blake2b(f"half {seed}".encode(), digest_size=4).digest(), "big")


class _GrowingPicture:
    """The portions of one seed's sequence that were rendered so far, in one tier.

    samples  per pixel
    mean     the portion of all of them; None before the first
    """

    def __init__(self, renderer: Renderer, seed: int, tier: Tier):
        self._renderer, self._seed, self._tier = renderer, seed, tier
        self.samples = 0
        self.mean: Portion | None = None
        self._denoised: np.ndarray | None = None
        self._denoised_indirect: np.ndarray | None = None

    def grow(self, count: int) -> None:
        """Render `count` further samples."""
        part = self._renderer.portion(self.samples, count, self._seed, self._tier)
        if self.mean is not None:
            share = np.float32(count / (self.samples + count))
            part = Portion(*(a + share * (b - a) for a, b in zip(self.mean, part, strict=True)))
        self.resume(self.samples + count, part)

    def resume(self, samples: int, mean: Portion) -> None:
        """Continue from the mean of so many samples of the same seed."""
        self.mean, self._denoised, self._denoised_indirect = mean, None, None
        self.samples = samples

    def denoised_picture(self, prefilter: bool) -> np.ndarray:
        """Return radiance (height, width, 3) of all samples, denoised."""
        if self._denoised is None:
            assert self.mean is not None
            how = effort(self.samples)._replace(prefilter=prefilter)
            self._denoised = self._renderer.denoise(self.mean, how)
        return self._denoised

    def denoised_indirect(self, prefilter: bool) -> np.ndarray:
        """Return the indirect light (height, width, 3) of all samples, denoised."""
        if self._denoised_indirect is None:
            assert self.mean is not None
            how = effort(self.samples)._replace(prefilter=prefilter)
            part = self.mean._replace(noisy=self.mean.indirect)
            self._denoised_indirect = self._renderer.denoise(part, how)
        return self._denoised_indirect


class Halves:
    """Two pictures of one shot by independent seeds, which grow.

    samples  of each half, per pixel
    """

    def __init__(self, shown: Shown):
        self.shown = shown
        seeds = [half_seed(shown.seed, half) for half in (0, 1)]
        self._shown = [_GrowingPicture(shown.renderer, seed, shown.tier) for seed in seeds]
        self._unblocked = [_GrowingPicture(shown.renderer, seed, "direct") for seed in seeds]

    @property
    def samples(self) -> int:
        return self._shown[0].samples

    @property
    def unblocked_samples(self) -> int:
        """Samples of each half that have been rendered as direct light without shadows, too."""
        return self._unblocked[0].samples

    def grow(self, count: int) -> None:
        """Render `count` further samples of each half."""
        for half in self._shown:
            half.grow(count)

    @property
    def means(self) -> list[Portion]:
        """The mean of each half's samples."""
        return [half.mean for half in self._shown if half.mean is not None]

    def resume(self, samples: int, means: Sequence[Portion]) -> None:
        """Continue from the means of samples that were rendered earlier with the same seeds."""
        for half, mean in zip(self._shown, means, strict=True):
            half.resume(samples, mean)

    def denoised_pictures(self) -> list[np.ndarray]:
        """Return both halves' radiance (height, width, 3), each of all its samples, denoised."""
        prefilter = self.has_noisy_guides
        return [half.denoised_picture(prefilter) for half in self._shown]

    def indirect_pictures(self, denoised: bool = False) -> list[np.ndarray]:
        """Return both halves' light (height, width, 3) that the object reflects onto itself."""
        means = [half.mean for half in self._shown]
        if denoised and any(mean is not None and mean.indirect.any() for mean in means):
            prefilter = self.has_noisy_guides
            return [half.denoised_indirect(prefilter) for half in self._shown]
        return [mean.indirect for mean in means if mean is not None]

    def noise_of_indirect_light(self) -> Estimate:
        """Return the error that the noise of indirect light makes in the mean of both halves."""
        mask, mean = self.shown.mask, self.picture
        slope = tone.display_slope(mean[mask], self.exposure)
        one, other = (each[mask] * slope for each in self.indirect_pictures())
        return mean_over(tone.squared_difference(one, other) / 4)

    def energy_of_indirect_light(self) -> float:
        """Return the error that the picture would have without indirect light."""
        mask, mean = self.shown.mask, self.picture
        slope = tone.display_slope(mean[mask], self.exposure)
        one, other = (each[mask] * slope for each in self.indirect_pictures())
        return max(float((one * other).mean(dtype=np.float64)), 0.0)

    def traced_direct_pictures(self) -> tuple[np.ndarray, np.ndarray]:
        """Return both halves' direct light (height, width, 3), with the shadows of the tier."""
        (a, b), (one, other) = self.pictures, self.indirect_pictures()
        return a - one, b - other

    @property
    def has_noisy_guides(self) -> bool:
        """Whether the albedo that guides the denoiser differs between the halves."""
        first, second = (half.mean for half in self._shown)
        assert first is not None and second is not None
        mask = self.shown.mask
        difference = first.guides[mask][:, :3] - second.guides[mask][:, :3]
        return math.sqrt(float((difference**2).mean(dtype=np.float64)) / 2) > NOISY_GUIDES

    def unblocked_pictures(self) -> list[np.ndarray]:
        """Return radiance (height, width, 3) of direct light without shadows, of both halves.

        It has the samples that both halves have, of which only new ones are rendered.
        """
        for half in self._unblocked:
            if half.samples < self.samples:
                half.grow(self.samples - half.samples)
        return [half.mean.noisy for half in self._unblocked if half.mean]

    def denoised_unblocked_pictures(self) -> list[np.ndarray]:
        """Return the same, denoised."""
        self.unblocked_pictures()
        prefilter = self.has_noisy_guides
        return [half.denoised_picture(prefilter) for half in self._unblocked]

    def error_of_direct_light(self) -> Estimate:
        """Return the error that direct light without shadows would have as the picture.

        It is rendered with the samples of both halves, most of whose noise is common with them.
        """
        mask, exposure = self.shown.mask, self.exposure
        one, other = (
            tone.display(shown[mask], exposure) - tone.display(alone[mask], exposure)
            for shown, alone in zip(self.pictures, self.unblocked_pictures(), strict=True)
        )
        return mean_over((one * other).mean(-1))

    @property
    def pictures(self) -> tuple[np.ndarray, np.ndarray]:
        """Both halves' radiance, (height, width, 3) each."""
        first, second = (half.mean for half in self._shown)
        assert first is not None and second is not None
        return first.noisy, second.noisy

    @property
    def picture(self) -> np.ndarray:
        """Radiance (height, width, 3) of both halves together."""
        first, second = self.pictures
        return (first + second) / np.float32(2)

    @property
    def alpha(self) -> np.ndarray:
        """The object's coverage (height, width), by both halves together."""
        first, second = (half.mean for half in self._shown)
        assert first is not None and second is not None
        return (first.alpha + second.alpha) / np.float32(2)

    def estimate(self) -> Estimate:
        """Return the error of `picture`: a quarter of the halves' squared difference, and more.

        The display curve is concave. Where one half has found light that few paths find and the
        other none, the picture is nearer to the bright half in display values, whereas the truth is
        nearer to the dark one. By how much the picture is brighter there than its halves are on
        average is by how much noise darkens it, and CURVE times its square is added.
        """
        mask, exposure = self.shown.mask, self.exposure
        a, b, both = (tone.display(each[mask], exposure) for each in (*self.pictures, self.picture))
        curve = CURVE * tone.squared_difference(both, (a + b) / 2)
        estimate = mean_over(tone.squared_difference(a, b) / 4 + curve)
        return replace(estimate, curve=float(curve.mean(dtype=np.float64)))

    def estimate_denoised(self, denoised: Sequence[np.ndarray]) -> Estimate:
        """Return the error of the mean of two pictures, each independent of the other's half.

        Bias is included. The pictures are denoised halves, or what was computed from them.
        """
        return self.error_and_bias(denoised, self.pictures, self.slope(denoised))[0]

    def slope(self, smooth: Sequence[np.ndarray], exposure: float | None = None) -> np.ndarray:
        """Return the display curve's slope (P, 3) at the mean of two pictures with little noise.

        exposure  None: that of the picture without noise, as the halves say it
        """
        mean = ((smooth[0] + smooth[1]) / 2)[self.shown.mask]
        return tone.display_slope(mean, self.exposure if exposure is None else exposure)

    def slope_map(self, smooth: Sequence[np.ndarray]) -> np.ndarray:
        """Return the same as (height, width, 3), 0 outside the mask."""
        result = np.zeros_like(smooth[0])
        result[self.shown.mask] = self.slope(smooth)
        return result

    def error_and_bias(
        self, pair: Sequence[np.ndarray], halves: Sequence[np.ndarray], slope: np.ndarray
    ) -> tuple[Estimate, float]:
        """Return the error of the mean of two pictures, and the squared bias that is part of it.

        halves  unbiased pictures: each of the pair is independent of the other half's
        slope   (P, 3) as `slope` returns it

        A denoised half is compared with the other half as it was rendered, whose noise is
        independent: E|dA − B|² is dA's error plus B's noise, and |A − B|² / 2 is that noise. Of the
        mean of dA and dB the error is the mean of theirs, less |dA − dB|² / 4. That is as well the
        noise of the mean, and what it leaves of the error is bias.
        """
        mask = self.shown.mask
        a, b, da, db = (each[mask] * slope for each in (*halves, *pair))
        across = tone.squared_difference(da, b) + tone.squared_difference(db, a)
        noise = tone.squared_difference(a, b)
        spread = tone.squared_difference(da, db)
        estimate = mean_over((across - noise) / 2 - spread / 4)
        return estimate, estimate.error - float(spread.mean(dtype=np.float64)) / 4

    @property
    def exposure(self) -> float:
        """Return the exposure of the picture without noise.

        Noise raises a percentile. To first order it does so in proportion to 1/samples, so the
        difference between each half and both together says how much is left.
        """
        mask = self.shown.mask
        each = [1 / tone.auto_exposure(half, mask) for half in self.pictures]
        both = 1 / tone.auto_exposure(self.picture, mask)
        return 1 / float(np.clip(2 * both - (each[0] + each[1]) / 2, both / 2, both))


def mean_over(values: np.ndarray) -> Estimate:
    """Return the mean of the pixels' values (P,), and by how much the picture's error differs.

    Noise is independent between pixels, and an error that is estimated from one squared difference
    is off by about itself: each value counts as its own standard standard_error.
    """
    squares = float(values.astype(np.float64) @ values.astype(np.float64))
    return Estimate(float(values.mean(dtype=np.float64)), math.sqrt(OWN * squares) / len(values))
