"""One shot's way to its limit: the samples so far, what they say, and what was tried.

A pilot of a few samples of each half says how noisy the shot is. What is tried next is planned in
factory.render.estimators.plans. Every try has all samples that were rendered so far, so that
nothing that a failed one rendered is lost. Whatever is tried is accepted by its estimated error and
bias alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from factory.render.estimators import (
    blends,
    blocked_light,
    closed_form,
    denoised,
    path_tracing,
    ratio,
    shadow_rays,
)
from factory.render.estimators.halves import Estimate, Halves
from factory.render.estimators.picture import Picture
from factory.render.estimators.plans import MOST_SAMPLES, Plan, is_direct_light_worth_asking
from factory.render.estimators.renderer import DirectPicture, Shown
from manifests.schema import Estimator
from shaders import tone

PILOT = 4  # samples of each half
# of the unbiased pictures, by estimator
SHARES = {
    denoised.NAME: blends.SHARES,
    ratio.NAME: ratio.SHARES,
    shadow_rays.NAME: shadow_rays.SHARES,
}
GROWTH = 8  # a few samples say too little to ask for more than so many times their number at once


class _Candidate(NamedTuple):
    """Pictures of both halves by an estimator, and the unbiased ones that they are compared with.

    predicted  error by the estimator's model
    smooth     whether a denoiser made them, with which unbiased ones may be blended
    """

    estimator: Estimator
    pair: list[np.ndarray]
    predicted: float
    unbiased: Sequence[np.ndarray]
    smooth: bool = True


@dataclass
class Attempt:
    """What is known of a shot so far.

    error          the limit
    pilot, now     error of path tracing by the pilot, and by all samples so far
    tries          {estimator: how many times it was tried}
    tried          {estimator: (its last estimate, samples of each half that it was of)}
    blocked        error that direct light without shadows would have, by the pilot; None before it
                   is asked for
    direct         the closed form's picture; None before it is asked for, and where none holds
    asked          whether it has been asked for
    closed_direct  its error in the tier `direct`, by the last samples without shadows
    expected       the same before samples have measured it
    left           share of path tracing's noise that the ratio's unbiased pictures have, once it is
                   known
    shadowed       direct light with shadows by rays; None before it is tried
    scale          of the denoiser's law
    ratio_scale    of the ratio's law
    rays_scale     of the law of shadow rays
    """

    shown: Shown
    error: float
    estimators: tuple[Estimator, ...]
    halves: Halves = field(init=False)
    pilot: Estimate = field(init=False)
    now: Estimate = field(init=False)
    scale: float = field(init=False)
    ratio_scale: float = field(init=False)
    rays_scale: float = field(init=False)
    shadowed: shadow_rays.ShadowedLight | None = None
    tries: dict[Estimator, int] = field(default_factory=dict)
    tried: dict[Estimator, tuple[Estimate, int]] = field(default_factory=dict)
    blocked: Estimate | None = None
    direct: DirectPicture | None = None
    left: float = 1.0
    closed_direct: Estimate | None = None
    asked: bool = False
    expected: Estimate = field(init=False)

    def __post_init__(self) -> None:
        self.halves = Halves(self.shown)
        self.halves.grow(PILOT)
        self.pilot = self.now = self.halves.estimate()
        self.scale = denoised.expected_scale(self.shown.mask.size)
        self.ratio_scale = ratio.expected_scale(self.shown.mask.size)
        self.rays_scale = shadow_rays.expected_scale(self.shown.mask.size)
        self.expected = closed_form.expected_error_at_limit(self.error, self.shown.mask.size)

    @property
    def is_over(self) -> bool:
        """Whether path tracing keeps the limit, or no more samples may be rendered."""
        return self.now.bound <= self.error or self.halves.samples >= MOST_SAMPLES

    def path_traced_picture(self) -> Picture:
        """Return path tracing's picture of all samples so far."""
        return Picture(
            radiance=self.halves.picture,
            alpha=self.halves.alpha,
            estimator=path_tracing.NAME,
            samples=2 * self.halves.samples,
            predicted=path_tracing.predict_error(self.pilot, PILOT, self.halves.samples),
            estimated=self.now,
            traced=self.shown.tier,
        )

    def try_closed_form(self) -> Picture | None:
        """Return the closed form's picture if the samples so far show that it keeps the error."""
        if not self.asked and is_direct_light_worth_asking(self):
            self.asked = True
            self.direct = closed_form.compute_direct_light(self.shown, self.error)
            if self.direct is not None:
                self.expected = closed_form.expected_error(self.direct, self.shown.mask)
        if self.direct is None or closed_form.NAME not in self.estimators:
            return None
        # without noise if it may, since a blend is not worth it
        for shares in ((0.0,), blends.SHARES):
            smooth = [self.direct.radiance] * 2
            blend = blocked_light.raise_error(
                blends.choose_blend(self.halves, smooth, self.halves.pictures, self.error, shares),
                self.blocked,
            )
            bias = blends.bias_with_doubt(blend.bias, blend.estimate)
            if shares == (0.0,) and self.shown.tier == "direct":
                known = self._error_in_direct_light(self.halves.pictures)
                blend, bias = blend._replace(estimate=known), known.error
            # in the tier `direct` it is the closed form alone whose error further samples show
            if self.shown.tier != "direct" or shares == (0.0,):
                estimate = blends.add_bias(blend.estimate, bias)
                self.tried[closed_form.NAME] = (estimate, self.halves.samples)
            if blends.is_kept(blend.estimate, bias, self.error):
                return Picture(
                    radiance=(blend.pair[0] + blend.pair[1]) / 2,
                    alpha=self.direct.alpha,
                    estimator=closed_form.NAME,
                    samples=2 * self.halves.samples,
                    predicted=self.expected.error,
                    estimated=blend.estimate,
                    traced=self.shown.tier,
                )
        return None

    def _error_in_direct_light(self, unblocked: Sequence[np.ndarray]) -> Estimate:
        """Return the closed form's error by both halves' pictures of direct light."""
        assert self.direct is not None
        measured = closed_form.measure_error(self.direct.radiance, unblocked, self.shown.mask)
        return closed_form.combine_with_expectation(measured, self.expected)

    def measure_noise_left(self, smooth: Sequence[np.ndarray]) -> None:
        """Measure how much noise the ratio's unbiased pictures have; smooth: for the slope."""
        slope = self.halves.slope_map(smooth)
        self.left = ratio.share_of_noise_left(
            self.halves.pictures, self.halves.unblocked_pictures(), slope
        )

    def shadowed_error(self) -> Estimate:
        """Return what direct light with shadows is off by, as far as it is known."""
        return self.shadowed_errors()(self.halves.samples)

    def shadowed_errors(self) -> Callable[[int], Estimate]:
        """Return a function that says the same as so many samples of a half show it."""
        expected, have = self._expected_by_rays(), self.halves.samples
        if self.shadowed is None:
            # the uncertainty of the picture is taken for that of direct light, of which a half
            # alone has twice as much
            measured = Estimate(expected.error, 2 * self.now.standard_error)
        else:
            measured = self.shadowed.measure(self.halves.traced_direct_pictures())
        known = closed_form.combine_with_expectation(measured, expected)

        def at(samples: int) -> Estimate:
            return closed_form.error_with_more_samples(known, expected, have, samples)

        return at

    def _expected_by_rays(self) -> Estimate:
        """Return the same before samples have measured it."""
        return shadow_rays.expected_error(self.expected, self.is_sampled)

    @property
    def is_sampled(self) -> bool:
        """Whether direct light is known to have lobes so narrow that they are sampled."""
        return self.direct is not None and self.direct.sampled

    def direct_light_error(self, samples: int) -> Estimate:
        """Return the closed form's error in direct light as so many samples of a half show it."""
        halves = self.halves
        if self.closed_direct is None:
            # the uncertainty of the picture is taken for that of direct light, of which a half
            # alone has twice as much
            uncertain = 2 * self.now.standard_error * halves.samples / samples
            return closed_form.combine_with_expectation(
                Estimate(self.expected.error, uncertain), self.expected
            )
        tried = halves.unblocked_samples
        return closed_form.error_with_more_samples(
            self.closed_direct, self.expected, tried, samples
        )

    def run(self, plan: Plan) -> Picture | None:
        """Render a plan's samples, and return the picture if it keeps the error."""
        halves, name = self.halves, plan.estimator
        self.tries[name] = self.tries.get(name, 0) + 1
        if plan.samples:
            halves.grow(min(plan.samples, (GROWTH - 1) * halves.samples))
        if name not in (path_tracing.NAME, closed_form.NAME):
            pairs = (
                self._by_shadow_rays()
                if name == shadow_rays.NAME
                else self._pairs(with_ratio=name == ratio.NAME)
            )
            for each in pairs:
                if made := self._judge(each):
                    return made
        self.now = halves.estimate()
        return None

    def _pairs(self, with_ratio: bool) -> list[_Candidate]:
        """Return the samples' denoised pictures, and before them those by the ratio."""
        halves = self.halves
        smooth = halves.denoised_pictures()
        noise = self.pilot.noise * PILOT / halves.samples
        by_law = denoised.predict_error(noise, self.scale, halves.samples, self.error)
        by_denoiser = _Candidate(denoised.NAME, smooth, by_law, halves.pictures)
        if not with_ratio:
            return [by_denoiser]
        assert self.direct is not None
        radiance, unblocked = self.direct.radiance, halves.unblocked_pictures()
        self.closed_direct = self._error_in_direct_light(unblocked)
        pairs = zip(smooth, halves.denoised_unblocked_pictures(), strict=True)
        self.measure_noise_left(smooth)
        by_ratio = _Candidate(
            ratio.NAME,
            [ratio.multiply_by_ratio(radiance, *pair) for pair in pairs],
            ratio.predict_error(self.left * noise, self.ratio_scale, self.error),
            ratio.reduce_noise(radiance, halves.pictures, unblocked, halves.slope_map(smooth)),
        )
        return [by_ratio, by_denoiser]

    def _by_shadow_rays(self) -> Iterator[_Candidate]:
        """Yield pictures by shadow rays and indirect light: noisy where that may do, and denoised.

        Both are blended in the latter.
        """
        halves = self.halves
        assert self.direct is not None
        if self.shadowed is None:
            self.shadowed = shadow_rays.ShadowedLight(
                self.shown, self.direct, self.error, self._expected_by_rays()
            )
        shadowed, noise = self.shadowed.pictures, halves.noise_of_indirect_light()

        def with_indirect_light(denoised: bool) -> list[np.ndarray]:
            indirect = halves.indirect_pictures(denoised)
            return [a + b for a, b in zip(shadowed, indirect, strict=True)]

        noisy = with_indirect_light(denoised=False)
        if shadow_rays.is_little_noise(noise, self.error):
            predicted = self._expected_by_rays().error + noise.noise
            yield _Candidate(shadow_rays.NAME, noisy, predicted, noisy, smooth=False)
        predicted = shadow_rays.predict_error(
            noise.noise, self.rays_scale, halves.samples, self.error, self._expected_by_rays()
        )
        yield _Candidate(shadow_rays.NAME, with_indirect_light(denoised=True), predicted, noisy)

    def _judge(self, tried: _Candidate) -> Picture | None:
        """Return the best blend of an estimator's pictures if it keeps the error."""
        halves, name = self.halves, tried.estimator
        shares = SHARES[name] if tried.smooth else (0.0,)
        # pictures by rays need few samples, which say little of the exposure
        exposure = (
            tone.auto_exposure((tried.pair[0] + tried.pair[1]) / 2, self.shown.mask)
            if name == shadow_rays.NAME
            else None
        )
        known = self._known_error(name)
        blend = blends.choose_blend(
            halves,
            tried.pair,
            tried.unbiased,
            self.error,
            shares,
            exposure,
            known.error if known else 0.0,
            with_detail=tried.smooth,
        )
        estimate, bias = self._estimate(name, blend)
        self.tried[name] = blends.add_bias(estimate, bias), halves.samples
        if tried.smooth:
            self._measure_law(name, blend)
        if not blends.is_kept(estimate, bias, self.error):
            return None
        return Picture(
            radiance=(blend.pair[0] + blend.pair[1]) / 2,
            alpha=self.direct.alpha if name == shadow_rays.NAME and self.direct else halves.alpha,
            estimator=name,
            samples=2 * halves.samples,
            predicted=tried.predicted,
            estimated=estimate,
            traced=self.shown.tier,
        )

    def _measure_law(self, name: Estimator, blend: blends.Blend) -> None:
        """Measure the scale of the estimator's law by a blend that it has made."""
        noise, samples = self.halves.estimate().noise, self.halves.samples
        if name == denoised.NAME:
            self.scale = denoised.measure_scale(blend, noise, samples)
        elif name == shadow_rays.NAME:
            noise = self.halves.noise_of_indirect_light().noise
            self.rays_scale = shadow_rays.measure_scale(blend, noise, samples)
        else:
            self.ratio_scale = ratio.measure_scale(blend, self.left * noise)

    def _known_error(self, name: Estimator) -> Estimate | None:
        """Return the closed form's error as part of an estimator's pictures; None: it is none."""
        if name == shadow_rays.NAME:
            return self.shadowed_error()
        return self.closed_direct if name == ratio.NAME else None

    def _estimate(self, name: Estimator, blend: blends.Blend) -> tuple[Estimate, float]:
        """Return the error of pictures of both halves, and the squared bias that is part of it.

        What is compared with pictures that contain the closed form cannot show its error: that is
        added, unless the samples as rendered show beyond doubt that it is more.
        """
        bias = blends.bias_with_doubt(blend.bias, blend.estimate)
        known = self._known_error(name)
        if known is None:
            return blend.estimate, bias
        plain = self.halves.estimate_denoised(blend.pair)
        if closed_form.is_surely_above(plain, self.error):
            return plain, bias
        uncertainty = math.hypot(blend.estimate.standard_error, known.standard_error)
        error = max(blend.estimate.error, 0.0) + known.error
        return Estimate(error, uncertainty), max(bias, 0.0) + known.error
