"""Estimates of errors, and the choice of an estimator, on pictures of known truth and noise."""

import numpy as np
import pytest

from factory.render.estimators import choice, denoised, path_tracing
from factory.render.estimators.halves import Estimate, Halves, Portion, Shown, half_seed, mean_over
from shaders import tone

SIZE = 48
MASK = np.hypot(*(np.mgrid[:SIZE, :SIZE] - SIZE / 2 + 0.5)) < 0.45 * SIZE


class Known:
    """A renderer of a ramp with normal noise: `noise` at one sample, in linear radiance.

    Its denoiser leaves a share of the noise, and adds `bias` where the columns are even.
    """

    def __init__(self, noise=0.3, left=0.3, bias=0.0):
        self.noise, self.left, self.bias, self.requested = noise, left, bias, []
        ramp = np.linspace(0.25, 0.9, SIZE, dtype=np.float32)
        self.truth = np.broadcast_to(ramp[:, None, None], (SIZE, SIZE, 3)).copy()

    def portion(self, first, count, seed, tier, denoise=False):
        self.requested.append((first, count, seed, denoise))
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(first, count)))
        noise = self.noise * rng.normal(size=self.truth.shape) / np.sqrt(count)
        alpha = MASK.astype(np.float32)
        noisy = (self.truth + noise).astype(np.float32)
        if not denoise:
            return Portion(noisy, alpha)
        smooth = (self.truth + self.left * noise).astype(np.float32)
        smooth[:, ::2] += self.bias
        return Portion(noisy, alpha, smooth)


def error(picture, known):
    exposure = tone.auto_exposure(known.truth, MASK)
    return tone.display_l2(picture, known.truth, exposure, MASK)


def shown(known, seed=5):
    return Shown(known, seed, "full", MASK)


def mean_ratio(known, samples, denoise):
    """Mean over 20 seeds of estimated over achieved error."""
    ratios = []
    for seed in range(20):
        halves = Halves(shown(known, seed))
        pair = halves.grow(samples, denoise)
        estimate = halves.denoised_estimate(pair) if denoise else halves.estimate()
        picture = (pair[0] + pair[1]) / 2 if denoise else halves.picture
        ratios.append(estimate.error / error(picture, known))
    return np.mean(ratios)


def test_the_halves_difference_is_the_error_of_both_together():
    assert mean_ratio(Known(), 16, denoise=False) == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_the_estimate_of_a_denoised_picture_includes_its_bias(bias):
    assert mean_ratio(Known(bias=bias), 64, denoise=True) == pytest.approx(1, abs=0.08)


def test_noise_does_not_change_the_exposure():
    known = Known(noise=0.5)
    halves = Halves(shown(known))
    halves.grow(16)
    truth = tone.auto_exposure(known.truth, MASK)
    assert halves._exposure() == pytest.approx(truth, rel=0.03)
    assert tone.auto_exposure(halves.picture, MASK) < 0.95 * truth


def test_a_picture_is_made_of_all_samples_and_of_none_twice():
    known = Known()
    halves = Halves(shown(known))
    halves.grow(4)
    halves.grow(12)
    seeds = half_seed(5, 0), half_seed(5, 1)
    assert seeds[0] == 5 != seeds[1]
    assert known.requested == [
        (first, count, seed, False) for first, count in ((0, 4), (4, 12)) for seed in seeds
    ]
    portions = [
        known.portion(*requested[:3], "full").noisy * requested[1]
        for requested in known.requested[:4]
    ]
    np.testing.assert_allclose(halves.picture, sum(portions) / 32, rtol=1e-5)


@pytest.mark.parametrize("estimators", [("path-tracing",), ("path-tracing", "denoised")])
@pytest.mark.parametrize("requested", [4.0, 40.0, 400.0])
def test_the_error_is_kept_and_no_more_samples_are_taken_than_that_needs(requested, estimators):
    known = Known(noise=0.6)
    made = choice.picture(shown(known), requested, estimators)
    assert made.estimated.bound <= requested
    assert error(made.radiance, known) <= requested
    if made.estimator == path_tracing.NAME and made.samples > 2 * choice.PILOT:
        assert error(made.radiance, known) > 0.6 * requested
    assert made.samples == sum(count for _, count, _, _ in known.requested)


def test_the_denoiser_is_taken_where_it_saves_samples_and_left_where_its_bias_is_too_large():
    noisy = {"noise": 1.5}
    plain_alone = choice.picture(shown(Known(**noisy)), 20.0, ("path-tracing",))
    saved = choice.picture(shown(Known(**noisy, left=0.05)), 20.0)
    assert saved.estimator == "denoised" and saved.samples < plain_alone.samples / 2
    biased = Known(**noisy, bias=0.2)
    kept = choice.picture(shown(biased), 20.0)
    assert kept.estimator == "path-tracing" and error(kept.radiance, biased) <= 20
    tries = sum(denoise for *_, denoise in biased.requested)
    assert 2 <= tries <= 2 * denoised.MOST_TRIES


def test_the_same_seed_chooses_the_same_estimator_and_another_seed_other_noise():
    first, again, other = (choice.picture(shown(Known(), s), 15.0) for s in (5, 5, 6))
    np.testing.assert_array_equal(first.radiance, again.radiance)
    assert (first.estimator, first.samples) == (again.estimator, again.samples)
    assert not np.array_equal(first.radiance, other.radiance)


def test_an_error_that_the_most_samples_do_not_reach_is_said(monkeypatch):
    monkeypatch.setattr(choice, "MOST_SAMPLES", 32)
    made = choice.picture(shown(Known()), 1e-3)
    assert made.samples == 64 and made.estimated.bound > 1e-3


def test_a_limit_is_compared_with_the_error_that_19_of_20_pictures_keep():
    assert Estimate(4.0, 1.0).bound == pytest.approx(5.645)
    assert Estimate(-1.0, 1.0).bound == pytest.approx(1.645)  # no error is below 0


def test_a_mean_over_few_bright_pixels_is_less_certain():
    even = mean_over(np.full(1000, 2.0))
    sparse = mean_over(np.r_[np.zeros(998), 1000.0, 1000.0])
    assert even.error == sparse.error == pytest.approx(2)
    assert sparse.standard_error > 20 * even.standard_error


def test_the_models_take_noise_in_proportion_to_samples():
    pilot = Estimate(100.0, 0.0)
    assert path_tracing.predicted(pilot, 4, 40) == pytest.approx(10)
    assert path_tracing.needed(pilot, 4, 10.0) == 42
    m = denoised.needed(pilot, 4, 10.0)
    assert denoised.predicted(pilot, 4, m) <= 10 < denoised.predicted(pilot, 4, m - 1)
