"""The two halves of a picture, and estimates of display errors from their difference."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from shaders import tone

if TYPE_CHECKING:
    from manifests.schema import Tier

OWN = 4 / 3  # squared difference over 4 of normal noise: variance 2/3 of its mean square, twice
CONFIDENCE = 1.645  # standard errors: 95 % of a normal distribution lie below
# times the squared darkening of the display curve, for the error that the halves' difference lacks.
# On 22 shots 2 makes estimates right on average, and 3 those of rare light, whose limits are missed
CURVE = 3.0


class Portion(NamedTuple):
    """Samples first … first + count − 1 of one seed's sequence.

    noisy     (height, width, 3) their mean, linear radiance
    alpha     (height, width) the object's coverage
    denoised  (height, width, 3), None where it was not requested
    """

    noisy: np.ndarray
    alpha: np.ndarray
    denoised: np.ndarray | None = None


class DirectPicture(NamedTuple):
    """Direct light without shadows, by the closed form: radiance (height, width, 3), and alpha."""

    radiance: np.ndarray
    alpha: np.ndarray


class Renderer(Protocol):
    """What the estimators call: factory.render.studio.Studio, or a substitute without Blender.

    direct_light          None where no closed form holds
    direct_light_samples  directions per pixel that it evaluates besides its maps; None as above
    may_shade_itself      False where the tiers `shadow` and `full` show nothing but direct light
    """

    def portion(
        self, first: int, count: int, seed: int, tier: Tier, denoise: bool = False
    ) -> Portion: ...

    def direct_light(self) -> DirectPicture | None: ...

    def direct_light_samples(self) -> int | None: ...

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


class Halves:
    """Two pictures of one shot by independent seeds, which grow.

    samples  of each half, per pixel
    last     of each half, what `grow` added last
    """

    def __init__(self, shown: Shown):
        self.shown, self.samples = shown, 0
        self.last: list[Portion] = []
        self._sums: list[np.ndarray] = []
        self._alphas: list[np.ndarray] = []

    def unblocked(self, count: int, denoise: bool = True) -> list[Portion]:
        """Return direct light without shadows of both halves' last `count` samples."""
        at, first = self.shown, self.samples - count
        return [
            at.renderer.portion(first, count, half_seed(at.seed, half), "direct", denoise)
            for half in (0, 1)
        ]

    def error_of_direct_light(self) -> Estimate:
        """Return the error that direct light without shadows would have as the picture.

        It is rendered with the samples of both halves, most of whose noise is common with them.
        """
        mask, exposure = self.shown.mask, self._exposure()
        unblocked = self.unblocked(self.samples, denoise=False)
        one, other = (
            tone.display(shown[mask], exposure) - tone.display(alone.noisy[mask], exposure)
            for shown, alone in zip(self.pictures, unblocked, strict=True)
        )
        return mean_over((one * other).mean(-1))

    def grow(self, count: int, denoise: bool = False) -> list[np.ndarray]:
        """Render `count` further samples of each half; return both denoised ones if requested."""
        at, parts = self.shown, []
        for half in (0, 1):
            seed = half_seed(at.seed, half)
            parts.append(at.renderer.portion(self.samples, count, seed, at.tier, denoise))
        sums = [part.noisy * np.float32(count) for part in parts]
        alphas = [part.alpha * np.float32(count) for part in parts]
        if self.samples:
            sums = [a + b for a, b in zip(self._sums, sums, strict=True)]
            alphas = [a + b for a, b in zip(self._alphas, alphas, strict=True)]
        self._sums, self._alphas = sums, alphas
        self.samples += count
        self.last = parts
        return [part.denoised for part in parts if part.denoised is not None]

    @property
    def pictures(self) -> tuple[np.ndarray, np.ndarray]:
        """Both halves' radiance, (height, width, 3) each."""
        first, second = (total / np.float32(self.samples) for total in self._sums)
        return first, second

    @property
    def picture(self) -> np.ndarray:
        """Radiance (height, width, 3) of both halves together."""
        return (self._sums[0] + self._sums[1]) / np.float32(2 * self.samples)

    @property
    def alpha(self) -> np.ndarray:
        """The object's coverage (height, width), by both halves together."""
        return (self._alphas[0] + self._alphas[1]) / np.float32(2 * self.samples)

    def estimate(self) -> Estimate:
        """Return the error of `picture`: a quarter of the halves' squared difference, and more.

        The display curve is concave. Where one half has found light that few paths find and the
        other none, the picture is nearer to the bright half in display values, whereas the truth is
        nearer to the dark one. By how much the picture is brighter there than its halves are on
        average is by how much noise darkens it, and CURVE times its square is added.
        """
        mask, exposure = self.shown.mask, self._exposure()
        a, b, both = (tone.display(each[mask], exposure) for each in (*self.pictures, self.picture))
        curve = CURVE * tone.squared_difference(both, (a + b) / 2)
        estimate = mean_over(tone.squared_difference(a, b) / 4 + curve)
        return replace(estimate, curve=float(curve.mean(dtype=np.float64)))

    def denoised_estimate(
        self, denoised: Sequence[np.ndarray], halves: Sequence[np.ndarray] | None = None
    ) -> Estimate:
        """Return the error of the mean of two pictures, each independent of the other's half.

        Bias is included. The pictures are denoised halves, or what was computed from them.

        halves  unbiased pictures of both halves (default: `pictures`)
        """
        exposure = tone.auto_exposure((denoised[0] + denoised[1]) / 2, self.shown.mask)
        return self.error_and_bias(denoised, halves or self.pictures, exposure)[0]

    def error_and_bias(
        self, pair: Sequence[np.ndarray], halves: Sequence[np.ndarray], exposure: float
    ) -> tuple[Estimate, float]:
        """Return the error of the mean of two pictures, and the squared bias that is part of it.

        halves  unbiased pictures: each of the pair is independent of the other half's

        A denoised half is compared with the other half as it was rendered, whose noise is
        independent: E|dA − B|² is dA's error plus B's noise, and |A − B|² / 2 is that noise. Of the
        mean of dA and dB the error is the mean of theirs, less |dA − dB|² / 4. That is as well the
        noise of the mean, and what it leaves of the error is bias.
        """
        mask = self.shown.mask
        a, b = (tone.display(half[mask], exposure) for half in halves)
        da, db = (tone.display(half[mask], exposure) for half in pair)
        across = tone.squared_difference(da, b) + tone.squared_difference(db, a)
        noise = tone.squared_difference(a, b)
        spread = tone.squared_difference(da, db)
        estimate = mean_over((across - noise) / 2 - spread / 4)
        return estimate, estimate.error - float(spread.mean(dtype=np.float64)) / 4

    def _exposure(self) -> float:
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
