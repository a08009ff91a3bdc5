"""Estimates of errors, and the choice of an estimator, on pictures of known truth and noise."""

import numpy as np
import pytest

from factory.render.estimators import attempt as attempts
from factory.render.estimators import (
    blends,
    blocked_light,
    choice,
    closed_form,
    denoised,
    halves,
    path_tracing,
    plans,
    ratio,
    rules,
    shadow_rays,
)
from factory.render.estimators.halves import Estimate, Halves, half_seed, mean_over
from factory.render.estimators.renderer import EFFORTS, DirectWork, Portion, Shown
from shaders import tone
from tests.support.known_pictures import MASK, NO_GUIDES, Known, Rays, Shaded, error, shown

WITHOUT_RAYS = tuple(each for each in choice.ALL if each != shadow_rays.NAME)


def mean_ratio(known, samples, denoise):
    """Mean over 20 seeds of estimated over achieved error."""
    ratios = []
    for seed in range(20):
        halves = Halves(shown(known, seed))
        halves.grow(samples)
        pair = halves.denoised_pictures() if denoise else []
        estimate = halves.estimate_denoised(pair) if denoise else halves.estimate()
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
    assert halves.exposure == pytest.approx(truth, rel=0.03)
    assert tone.auto_exposure(halves.picture, MASK) < 0.95 * truth


def test_a_picture_is_made_of_all_samples_and_of_none_twice():
    known = Known()
    halves = Halves(shown(known))
    halves.grow(4)
    halves.grow(12)
    seeds = half_seed(5, 0), half_seed(5, 1)
    assert seeds[0] == 5 != seeds[1]
    assert known.requested == [
        (first, count, seed) for first, count in ((0, 4), (4, 12)) for seed in seeds
    ]
    portions = [
        known.portion(*requested, "full").noisy * requested[1] for requested in known.requested[:4]
    ]
    np.testing.assert_allclose(halves.picture, sum(portions) / 32, rtol=1e-5)


@pytest.mark.parametrize("estimators", [("path-tracing",), ("path-tracing", "denoised")])
@pytest.mark.parametrize("requested", [4.0, 40.0, 400.0])
def test_the_error_is_kept_and_no_more_samples_are_taken_than_that_needs(requested, estimators):
    known = Known(noise=0.6)
    made = choice.render_within_error(shown(known), requested, estimators)
    assert made.estimated.bound <= requested
    assert error(made.radiance, known) <= requested
    if made.estimator == path_tracing.NAME and made.samples > 2 * attempts.PILOT:
        assert error(made.radiance, known) > 0.6 * requested
    assert made.samples == sum(count for _, count, _ in known.requested)


def test_every_try_denoises_all_samples_so_far():
    known, seen = Shaded(), []
    denoise = known.denoise
    known.denoise = lambda portion, effort: (
        seen.append((portion, effort)) or denoise(portion, effort)
    )
    halves = Halves(shown(known))
    halves.grow(4)
    halves.unblocked_pictures()
    halves.grow(60)
    for _ in range(2):  # the second time nothing is rendered or denoised again
        halves.denoised_pictures()
        halves.denoised_unblocked_pictures()
    assert len(seen) == 4 and {effort for _, effort in seen} == {EFFORTS[40]}
    np.testing.assert_array_equal(seen[0][0].noisy, halves.pictures[0])
    counts = [count for _, count, _ in known.requested]
    assert counts == [4, 4, 4, 4, 60, 60, 60, 60]
    errors = [error(portion.noisy, known) for portion, _ in seen[:2]]
    first = Halves(shown(known))
    first.grow(4)
    assert max(errors) < error(first.pictures[0], known) / 4


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_guides_are_denoised_first_where_they_are_noisy(noise):
    known, seen = Known(), []
    portion, denoise = known.portion, known.denoise

    def with_noisy_guides(*requested):
        rng = np.random.default_rng(requested[2])
        guides = NO_GUIDES + np.float32(noise) * rng.normal(size=NO_GUIDES.shape)
        return portion(*requested)._replace(guides=guides)

    known.portion = with_noisy_guides
    known.denoise = lambda at, effort: seen.append(effort.prefilter) or denoise(at, effort)
    halves = Halves(shown(known))
    halves.grow(4)
    halves.denoised_pictures()
    halves.denoised_unblocked_pictures()
    assert seen == 4 * [noise > 0]


def test_more_samples_are_denoised_more_thoroughly():
    costs = [denoised.cost_in_samples(samples, "full") for samples in (4, 39, 40, 127, 128, 2048)]
    assert costs[0] == costs[1] < costs[2] == costs[3] < costs[4] == costs[5]
    assert denoised.cost_in_samples(4, "direct") > denoised.cost_in_samples(4, "full")


def test_the_denoiser_is_taken_where_it_saves_samples_and_left_where_its_bias_is_too_large():
    noisy = {"noise": 1.5}
    plain_alone = choice.render_within_error(shown(Known(**noisy)), 20.0, ("path-tracing",))
    saved = choice.render_within_error(shown(Known(**noisy, left=0.05)), 20.0)
    assert saved.estimator == "denoised" and saved.samples < plain_alone.samples / 2
    biased = Known(**noisy, bias=0.2)
    kept = choice.render_within_error(shown(biased), 20.0)
    assert kept.estimator == "path-tracing" and error(kept.radiance, biased) <= 20
    assert 2 <= biased.tries <= 2 * denoised.MOST_TRIES


def test_the_same_seed_chooses_the_same_estimator_and_another_seed_other_noise():
    first, again, other = (choice.render_within_error(shown(Known(), s), 15.0) for s in (5, 5, 6))
    np.testing.assert_array_equal(first.radiance, again.radiance)
    assert (first.estimator, first.samples) == (again.estimator, again.samples)
    assert not np.array_equal(first.radiance, other.radiance)


def test_an_error_that_the_most_samples_do_not_reach_is_said(monkeypatch):
    monkeypatch.setattr(attempts, "MOST_SAMPLES", 32)
    made = choice.render_within_error(shown(Known()), 1e-3)
    assert made.samples == 64 and made.estimated.bound > 1e-3


def test_a_limit_is_compared_with_the_error_that_19_of_20_pictures_keep():
    assert Estimate(4.0, 1.0).bound == pytest.approx(5.645)
    assert Estimate(-1.0, 1.0).bound == pytest.approx(1.645)  # no error is below 0


def test_a_mean_over_few_bright_pixels_is_less_certain():
    even = mean_over(np.full(1000, 2.0))
    sparse = mean_over(np.r_[np.zeros(998), 1000.0, 1000.0])
    assert even.error == sparse.error == pytest.approx(2)
    assert sparse.standard_error > 20 * even.standard_error


def test_the_models_ask_for_the_samples_that_they_say_suffice():
    pilot = Estimate(100.0, 0.0)
    assert path_tracing.predict_error(pilot, 4, 40) == pytest.approx(10)
    assert path_tracing.needed_samples(pilot, 4, 10.0) == 42
    scale = denoised.expected_scale(64 * 64)
    m = denoised.needed_samples(pilot.noise, 4, scale, 10.0)
    error = [denoised.predict_error(100.0 * 4 / n, scale, m, 10.0) for n in (m, m / 1.2)]
    assert m < 40 and error[0] <= 10 < error[1]


def test_the_denoisers_law_counts_the_bias_that_a_limit_allows(monkeypatch):
    scale = denoised.expected_scale(64 * 64)
    m = denoised.needed_samples(100.0, 4, scale, 10.0)
    bias = scale * (100.0 * 4 / m) ** denoised.POWER
    left = denoised.DETAIL.bias * bias
    assert left * (1 - max(blends.SHARES)) ** 2 <= blends.MOST_BIAS * 10
    # noise that the largest share would allow, with a bias that it does not
    noisy, biased = 20.0, 100.0
    monkeypatch.setattr(blends, "MOST_BIAS", 1 / 6)
    assert denoised.predict_error(noisy, biased / noisy**denoised.POWER, 4, 25.0) <= 25
    assert denoised.needed_samples(noisy, 4, biased / noisy**denoised.POWER, 25.0) > 4


def test_the_denoiser_is_expected_to_leave_less_where_the_frame_has_more_pixels():
    counts = [
        denoised.needed_samples(400.0, 4, denoised.expected_scale(n * n), 10.0)
        for n in (64, 128, 256)
    ]
    assert counts[0] > counts[1] > counts[2]


def test_a_try_of_the_denoiser_says_what_the_next_one_needs():
    scales, samples = [], []
    for bias in (0.2, 0.001):
        attempt = attempts.Attempt(shown(Known(noise=0.8, bias=bias)), 20.0, choice.ALL)
        scales.append(attempt.scale)
        attempt.error = 1e-6  # no try is kept
        assert attempt.run(plans.Plan(0.0, denoised.NAME, 8)) is None
        attempt.error, attempt.now = 20.0, attempt.halves.estimate()
        scales.append(attempt.scale)
        samples.append(
            next(p.samples for p in plans.plans_of(attempt) if p.estimator == denoised.NAME)
        )
    assert scales[1] > scales[0] == scales[2] > scales[3]
    assert samples[0] > 1.5 * samples[1]


@pytest.mark.parametrize("estimator", choice.ALL)
def test_a_few_samples_are_not_trusted_to_plan_many(estimator):
    known = Rays(noise=1.5, deepest=0.8)
    attempt = attempts.Attempt(shown(known), 20.0, choice.ALL)
    attempt.direct = known.direct_light()
    attempt.run(plans.Plan(0.0, estimator, 2000))
    assert attempt.halves.samples == attempts.GROWTH * attempts.PILOT


def test_no_closed_form_is_computed_where_light_is_blocked_and_its_noise_explains_nothing():
    dark, lit = (Shaded(noise=0.8, deepest=deepest) for deepest in (0.01, 0.95))
    portion = dark.portion
    dark.portion = lambda first, count, seed, tier: portion(
        first, count, seed + (tier == "direct"), tier
    )
    for known in (dark, lit):
        choice.render_within_error(shown(known), 40.0, WITHOUT_RAYS)
    assert (dark.closed_forms, lit.closed_forms) == (0, 1)


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_blocked_light_shows_what_the_noise_of_few_samples_hides(share):
    attempt = attempts.Attempt(shown(Shaded()), 20.0, choice.ALL)
    pair = list(attempt.halves.pictures)
    lucky = blends.Blend(pair, Estimate(-5.0, 9.0), bias=-7.0, bias_alone=-7.0, share=share)
    assert blocked_light.raise_error(lucky, attempt.blocked) is lucky
    attempt.blocked = Estimate(50.0, 1.0)
    seen = blocked_light.raise_error(lucky, attempt.blocked)
    assert seen.estimate.error == seen.bias == pytest.approx(50 * (1 - share) ** 2)
    assert seen.estimate.standard_error == 9
    attempt.tried[closed_form.NAME] = Estimate(15.0, 9.0), 4
    assert closed_form.NAME not in {plan.estimator for plan in _plans_with_direct_light(attempt)}
    attempt.blocked = Estimate(0.0, 1.0)
    assert blocked_light.raise_error(lucky, attempt.blocked).bias == 0
    assert closed_form.NAME in {plan.estimator for plan in _plans_with_direct_light(attempt)}


def _plans_with_direct_light(attempt):
    attempt.direct = Shaded().direct_light()
    return plans.plans_of(attempt)


def test_direct_lights_error_as_the_picture_is_estimated_from_few_samples():
    known = Shaded(noise=0.3, deepest=0.5)
    exposure = tone.auto_exposure(known.truth, MASK)
    values = [tone.display(each[MASK], exposure) for each in (known.truth, known.unblocked)]
    truth = float(tone.squared_difference(*values).mean())
    estimates = []
    for seed in range(10):
        halves = Halves(shown(known, seed))
        halves.grow(16)
        estimates.append(halves.error_of_direct_light().error)
    assert np.mean(estimates) == pytest.approx(truth, rel=0.1)


class OtherNoise(Shaded):
    """The same with nothing blocked, and with direct light of other noise than the tier `full`."""

    def portion(self, first, count, seed, tier):
        return super().portion(first, count, seed + 1000 * (tier == "direct"), tier)


def test_noise_is_not_counted_as_blocked_light():
    known = OtherNoise(noise=0.3, deepest=1.0)
    estimates, noises = [], []
    for seed in range(10):
        halves = Halves(shown(known, seed))
        halves.grow(16)
        estimates.append(halves.error_of_direct_light().error)
        noises.append(halves.estimate().error)
    assert abs(np.mean(estimates)) < 0.2 * np.mean(noises)


def test_the_closed_form_alone_is_taken_where_nothing_is_blocked():
    known = Shaded(deepest=1.0)
    at = Shown(known, 5, "direct", MASK)
    made = choice.render_within_error(at, 20.0)
    assert made.estimator == closed_form.NAME and made.estimated.bound <= 20
    np.testing.assert_array_equal(made.radiance, known.unblocked)
    plain = choice.render_within_error(at, 20.0, ("path-tracing",))
    assert made.samples < plain.samples


@pytest.mark.parametrize("closed", [0.8, 1.25])
def test_a_closed_form_that_is_off_is_seen(closed):
    known = Rays(deepest=1.0, closed=closed)
    made = choice.render_within_error(shown(known), 20.0)
    assert made.estimator not in (closed_form.NAME, ratio.NAME, shadow_rays.NAME)
    assert error(made.radiance, known) <= 20


def test_the_ratio_is_taken_where_the_denoiser_errs_in_both_pictures_alike():
    known = Shaded(noise=0.8, deepest=0.8)
    made = choice.render_within_error(shown(known), 20.0, WITHOUT_RAYS)
    assert made.estimator == ratio.NAME and error(made.radiance, known) <= 20
    plain = choice.render_within_error(shown(known), 20.0, ("path-tracing", "denoised"))
    assert plain.estimator == path_tracing.NAME and made.samples < plain.samples / 2


def test_the_ratio_stands_where_there_is_light_and_the_denoised_picture_elsewhere():
    direct = np.full((1, 3, 3), 2.0)
    shown_, unblocked = (
        np.array(values)[None, :, None] * np.ones(3)
        for values in ([0.5, 0.3, 9.0], [1.0, 0.0, 1.0])
    )
    picture = ratio.multiply_by_ratio(direct, shown_, unblocked)
    np.testing.assert_allclose(picture[0, :, 0], [1.0, 0.3, 2 * ratio.MOST])


def test_an_unbiased_picture_has_only_the_noise_that_is_not_common():
    known = Shaded(deepest=1.0)
    halves = Halves(shown(known))
    halves.grow(4)
    slope = halves.slope_map(halves.pictures)
    unbiased = ratio.reduce_noise(
        known.unblocked, halves.pictures, halves.unblocked_pictures(), slope
    )
    for picture in unbiased:
        np.testing.assert_allclose(picture[MASK], known.truth[MASK], atol=1e-5)


def test_noise_of_light_that_is_blocked_is_not_brought_in():
    known, errors = Shaded(), []
    known.share = (np.arange(MASK.shape[1]) < 20).astype(np.float32)[
        None, :, None
    ]  # the rest is dark
    known.truth = known.unblocked * known.share
    for seed in range(20):
        halves = Halves(shown(known, seed))
        halves.grow(16)
        slope, unblocked = halves.slope_map(halves.pictures), halves.unblocked_pictures()
        direct = known.unblocked
        regressed = ratio.reduce_noise(direct, halves.pictures, unblocked, slope)
        whole = [s - (u - direct) for s, u in zip(halves.pictures, unblocked, strict=True)]
        off = [(np.mean(e, 0) - known.truth)[MASK] for e in (regressed, whole, halves.pictures)]
        errors.append([(each**2).mean() for each in off])
        assert abs(off[0].mean()) < 0.01
    regressed, whole, noisy = np.mean(errors, axis=0)
    assert regressed < 0.5 * min(whole, noisy)


def test_the_sum_around_a_pixel_leaves_it_out():
    values = np.random.default_rng(1).normal(size=(7, 9))
    sums = ratio._sums_around(values, 2)
    assert sums[3, 4] == pytest.approx(values[1:6, 2:7].sum() - values[3, 4])
    assert sums[0, 8] == pytest.approx(values[:3, 6:].sum() - values[0, 8])


def test_the_ratio_asks_for_enough_samples_to_show_that_its_error_is_kept():
    expected = Estimate(0.5, 0.3)

    def direct(samples):
        return closed_form.combine_with_expectation(Estimate(0.5, 24 / samples), expected)

    scale = ratio.expected_scale(4096)
    few, many = (ratio.needed_samples(200.0, 4, scale, limit, direct) for limit in (40.0, 6.0))
    assert ratio.LEAST <= few < many

    def bound(samples):
        known = direct(samples)
        return min(
            known.error + error + 1.645 * np.hypot(ratio.UNCERTAINTY * error, known.standard_error)
            for error, bias in ratio._blends(800 / samples, scale)
            if known.error + bias <= 2.0
        )

    assert bound(many) <= 6
    assert ratio.needed_samples(200.0, 4, ratio.expected_scale(65536), 6.0, direct) < many
    # the same noise by twice the samples is twice as much for one
    assert ratio.needed_samples(200.0, 8, scale, 6.0, direct) > 1.8 * many
    # less than the closed form's own error is never reached
    assert ratio.needed_samples(200.0, 4, scale, 0.45, direct) > plans.MOST_SAMPLES
    # without bias the noise decides
    alone = ratio.needed_samples(200.0, 4, 0.0, 6.0, lambda samples: Estimate(0.0, 0.0))
    assert alone == ratio.LEAST


def test_unbiased_pictures_alone_are_the_last_resort_where_the_denoiser_errs():
    none = Estimate(0.0, 0.0)
    needed = ratio.needed_samples(100.0, 4, 1e3, 10.0, lambda samples: none)
    assert needed == pytest.approx(400 * (1 + 1.645 * ratio.UNCERTAINTY) / 10, rel=0.11)


def test_what_was_expected_of_the_closed_form_is_no_less_certain_with_few_samples():
    expected = Estimate(2.0, 1.0)
    direct = closed_form.combine_with_expectation(Estimate(4.0, 0.8), expected)
    again, more = (
        closed_form.error_with_more_samples(direct, expected, 8, count) for count in (8, 32)
    )
    assert again == Estimate(direct.error, pytest.approx(direct.standard_error))
    assert more.standard_error == pytest.approx(
        closed_form.combine_with_expectation(Estimate(4.0, 0.2), expected).standard_error
    )
    vague = Estimate(2.0, 1e6)
    assert closed_form.error_with_more_samples(
        Estimate(4.0, 0.8), vague, 8, 32
    ).standard_error == pytest.approx(0.2)


def test_the_share_of_noise_that_is_left_is_that_of_the_unbiased_pictures():
    for deepest, least, most in ((1.0, 0.0, 1e-3), (0.5, 0.1, 0.6)):
        known = Shaded(deepest=deepest)
        halves = Halves(shown(known))
        halves.grow(16)
        slope = halves.slope_map(halves.pictures)
        left = ratio.share_of_noise_left(halves.pictures, halves.unblocked_pictures(), slope)
        pair = ratio.reduce_noise(
            known.unblocked, halves.pictures, halves.unblocked_pictures(), slope
        )
        a, b = ((each - known.truth) * slope for each in (pair[0], halves.pictures[0]))
        assert left == pytest.approx((a**2).sum() / (b**2).sum(), rel=0.2, abs=1e-6)
        assert least <= left <= most


def test_the_ratios_law_goes_by_what_a_try_has_shown():
    known = Shaded(noise=0.8, deepest=0.8)
    attempt = attempts.Attempt(shown(known), 0.3, choice.ALL)
    attempt.direct, attempt.blocked = known.direct_light(), Estimate(50.0, 1.0)
    before = attempt.ratio_scale
    attempt.halves.unblocked_pictures()  # by the same portions, so that the noise is common
    assert attempt.run(plans.Plan(0.0, ratio.NAME, 8)) is None
    assert attempt.ratio_scale != before and attempt.left < 1
    attempt.error, attempt.now = 20.0, attempt.halves.estimate()
    plan = plans._ratio_plan(attempt)
    assert plan.samples >= 0.2 * attempt.halves.samples  # no try is repeated


def test_doubt_about_the_closed_forms_own_error_does_not_count_as_bias():
    attempt = attempts.Attempt(shown(Shaded()), 20.0, choice.ALL)
    attempt.closed_direct, attempt.error = Estimate(2.0, 3.0), 1e6
    pair = list(attempt.halves.pictures)
    blend = blends.Blend(pair, Estimate(1.0, 0.4), bias=0.5, bias_alone=0.5, share=0.0)
    assert attempt._estimate(denoised.NAME, blend)[1] == pytest.approx(0.5 + blends.DOUBT * 0.4)
    assert attempt._estimate(ratio.NAME, blend)[1] == pytest.approx(2.5 + blends.DOUBT * 0.4)


def test_the_closed_form_is_out_only_beyond_doubt():
    assert closed_form.is_surely_above(Estimate(30.0, 5.0), 20.0)
    assert not closed_form.is_surely_above(Estimate(25.0, 5.0), 20.0)
    assert closed_form.needed_samples(Estimate(30.0, 5.0), 4, 20.0) is None
    assert closed_form.needed_samples(Estimate(21.0, 20.0), 4, 20.0) is None
    assert closed_form.needed_samples(Estimate(10.0, 20.0), 4, 20.0) == 14
    few = closed_form.cost_in_samples(10_000, DirectWork(16, 0.0, 400.0))
    assert closed_form.cost_in_samples(1000, DirectWork(16, 0.0, 400.0)) > few
    assert closed_form.cost_in_samples(10_000, DirectWork(16, 0.0, 800.0)) > few
    assert closed_form.cost_in_samples(10_000, DirectWork(16, 0.5, 400.0)) > few
    assert closed_form.cost_in_samples(10_000, DirectWork(64, 0.0, 400.0)) > few


EACH = np.full(int(MASK.sum()), 16)  # points per pixel


def _left(direct, points, finer):
    """The differences that remain by the law, of grids that lie where `finer` says."""
    counts = np.full(MASK.shape, points)
    for each in finer:
        counts[each.where] = each.points
    fewer = direct.variance * (points / counts)[..., None]
    return closed_form.error_by_differences(direct._replace(variance=fewer), MASK), counts[
        MASK
    ].mean()


def test_small_limits_and_grids_that_differ_take_more_points():
    same = Shaded().direct_light()
    off = same._replace(variance=np.full_like(same.radiance, 2e-4))
    assert closed_form.error_by_differences(off, MASK) > 4
    assert closed_form.plan_more_points(same, MASK, EACH, 2.0) == []
    assert closed_form.plan_more_points(off, MASK, EACH, 60.0) == []
    left, points = zip(
        *(
            _left(off, 16, closed_form.plan_more_points(off, MASK, EACH, limit))
            for limit in (2.0, 0.5)
        ),
        strict=True,
    )
    assert left[1] < left[0] and 16 < points[0] < points[1] <= closed_form.MOST_PER_PIXEL
    sampled = off._replace(sampled=True)  # whose differences say more
    assert _left(sampled, 16, closed_form.plan_more_points(sampled, MASK, EACH, 2.0))[1] > points[0]


def test_pixels_whose_grids_differ_are_given_more_points_and_their_neighbours_too():
    off = Shaded().direct_light()
    row, column = (side // 2 for side in MASK.shape)
    off.variance[row, column] = 1.0
    finer = closed_form.plan_more_points(off, MASK, EACH, 3.5)
    counts = np.full(MASK.shape, 16)
    for each in finer:
        counts[each.where] = each.points
    assert counts[row, column] == counts.max() == 256
    assert (counts[row - 1 : row + 2, column - 1 : column + 2] > 16).all()
    assert (counts[MASK] == 16).mean() > 0.8


def test_no_more_points_are_asked_for_than_memory_holds(monkeypatch):
    off = Shaded().direct_light()
    off.variance[:] = 1.0
    most = 64 * int(MASK.sum()) // 2
    monkeypatch.setattr(closed_form, "MOST_POINTS", most)
    finer = closed_form.plan_more_points(off, MASK, EACH, 0.5)
    assert finer and sum(each.points * int(each.where.sum()) for each in finer) <= most
    monkeypatch.setattr(closed_form, "MOST_PER_PIXEL", 16)
    assert closed_form.plan_more_points(off, MASK, EACH, 0.5) == []


def test_no_pixel_is_given_fewer_points_than_it_has():
    off = Shaded().direct_light()
    off.variance[:] = 2e-4
    columns = np.arange(MASK.shape[1]) < MASK.shape[1] // 2
    counts = np.where(columns, 64, 16) * np.ones(MASK.shape, int)
    finer = closed_form.plan_more_points(off, MASK, counts[MASK], 5.0)
    assert finer and sum(each.where.sum() for each in finer) > 0.9 * (MASK & ~columns).sum()
    assert not any(each.where[counts >= each.points].any() for each in finer)
    # nor are those that it has left out of the error
    parts, own, levels = np.array([1.0, 1e-9]), np.array([16, 64]), np.array([16, 32])
    assert (closed_form.points_per_pixel(parts, own, levels, 1e-3) == [32, 64]).all()


@pytest.mark.parametrize("factor", [1.0, 50.0])
def test_errors_that_grids_did_not_say_give_other_pixels_more_points(monkeypatch, factor):
    """By a picture whose pixels are off by `factor` times what the rules expect of their grids."""
    off = Shaded().direct_light()
    rows = np.arange(MASK.shape[0])[:, None]
    off.variance[:] = np.where(rows < MASK.shape[0] // 2, 1e-3, 2e-5)[..., None]
    expected = closed_form.error_per_difference(False, MASK.size).error
    off_by = np.sqrt(factor * expected * off.variance)
    seen = []

    def finer(known, more):
        seen.append((more.points, int(more.where.sum())))
        inside = more.where[..., None]
        return known._replace(
            radiance=np.where(inside, off.radiance + off_by, known.radiance),
            variance=np.where(inside, off.variance * 16 / more.points, known.variance),
        )

    direct = closed_form.refine_direct_light(off, MASK, 16, 15.0, finer)
    untouched = MASK & (direct.radiance == off.radiance).all(-1)
    scale = direct.variance[untouched] / off.variance[untouched]
    if factor == 1:
        assert untouched.sum() > 0.3 * MASK.sum() and len(seen) == 1
        np.testing.assert_allclose(scale, 1, rtol=1e-5)
    else:
        assert untouched.sum() < 0.01 * MASK.sum() and len(seen) > 1
        np.testing.assert_allclose(scale, factor, rtol=0.01)
    # after a round, the pixels that were given points have their own variance
    monkeypatch.setattr(closed_form, "ROUNDS", 1)
    direct = closed_form.refine_direct_light(off, MASK, 16, 15.0, finer)
    given = MASK & (direct.radiance != off.radiance).any(-1)
    assert given.any() and (direct.variance[given] <= off.variance[given] / 4).all()


def test_small_frames_have_more_points_than_large_ones():
    """For their edges are a larger part of them."""
    off = Shaded().direct_light()
    off.variance[:] = 2e-4
    wide = np.zeros((4 * MASK.shape[0], 4 * MASK.shape[1]), bool)
    wide[: MASK.shape[0], : MASK.shape[1]] = MASK

    def frame(values):
        large = np.zeros((*wide.shape, *values.shape[2:]), values.dtype)
        large[: values.shape[0], : values.shape[1]] = values
        return large

    large = off._replace(
        radiance=frame(off.radiance), alpha=frame(off.alpha), variance=frame(off.variance)
    )
    few, many = (
        sum(
            each.points * int(each.where.sum())
            for each in closed_form.plan_more_points(direct, mask, EACH, 2.0)
        )
        for direct, mask in ((large, wide), (off, MASK))
    )
    assert few < 0.8 * many
    left = [closed_form.error_per_difference(False, side**2).error for side in (64, 256)]
    assert left == pytest.approx([0.2, 0.115], rel=0.01)


def test_a_frame_without_more_points_stays_as_it_is():
    off = Shaded().direct_light()
    off.variance[:] = 2e-4
    assert closed_form.refine_direct_light(off, MASK, 16, 2.0, lambda known, more: None) is off


def test_grids_that_differ_are_made_finer():
    known, asked = Shaded(noise=0.8, deepest=0.95), []
    direct_light = known.direct_light

    def differing(points, known=None, where=None):
        asked.append(points)
        direct = direct_light(points)
        return direct._replace(variance=np.full_like(direct.variance, 0.2 / points))

    known.direct_light = differing
    choice.render_within_error(shown(known), 40.0, WITHOUT_RAYS)
    assert len(asked) > 1 and asked == sorted(set(asked)) and asked[0] == closed_form.POINTS
    asked.clear()
    known.direct_light = lambda points, known=None, where=None: (
        differing(points) if where is None else asked.append(None)
    )
    choice.render_within_error(shown(known), 40.0, WITHOUT_RAYS)
    assert asked == [closed_form.POINTS, None]  # the frame has no more points


class Convex(Shaded):
    """The same, of an object that cannot shade itself: every tier shows the unblocked light."""

    def __init__(self):
        super().__init__(deepest=1.0)
        self.tiers = []

    def portion(self, first, count, seed, tier):
        self.tiers.append(tier)
        return super().portion(first, count, seed, tier)

    def may_shade_itself(self):
        return False


def test_direct_light_is_rendered_of_what_cannot_shade_itself():
    known, other = Convex(), Rays()
    made = choice.render_within_error(shown(known), 20.0)
    assert set(known.tiers) == {"direct"} and made.traced == "direct"
    assert error(made.radiance, known) < 20
    assert choice.render_within_error(shown(other), 20.0).traced == "full"


def test_rules_are_known_without_blender():
    """Training and planning read fingerprints, and Blender leaves files in the home folder."""
    import subprocess
    import sys

    script = (
        "import sys\nfrom factory.render.estimators import choice, rules\nrules.identity()\n"
        "assert 'bpy' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_constants_of_direct_light_are_part_of_the_fingerprint(monkeypatch):
    import json

    from shaders import direct_light, direct_light_kernels

    before = json.dumps(rules.identity())
    for module, name, value in (
        (direct_light, "SPACING", 0.4),
        (direct_light, "WITHIN", {"ggx": 5.0}),
        (direct_light, "PARTS", ((0.0, 3),)),
        (direct_light_kernels, "SHORT_TAILED", np.float32(26)),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            assert json.dumps(rules.identity()) != before, name
    assert json.dumps(rules.identity()) == before


def test_few_samples_of_direct_light_measure_the_closed_form_without_bias():
    known = Shaded(noise=0.6, closed=1.1)
    direct = known.direct_light().radiance
    exposure = tone.auto_exposure(direct, MASK)
    values = [tone.display(each[MASK], exposure) for each in (direct, known.unblocked)]
    truth = float(tone.squared_difference(*values).mean())
    measured = []
    for seed in range(40):
        pair = [known.portion(0, 4, 2 * seed + half, "direct").noisy for half in (0, 1)]
        measured.append(closed_form.measure_error(direct, pair, MASK))
    mean, spread = (f([each.error for each in measured]) for f in (np.mean, np.std))
    assert mean == pytest.approx(truth, rel=0.15)
    assert 0.5 * spread < np.mean([each.standard_error for each in measured]) < 2 * spread


def test_points_are_enough_and_do_not_depend_on_the_last_bits_of_their_parts(rng):
    levels = np.array([16, 32, 64, 256, 1024])
    for _ in range(50):
        parts = rng.lognormal(0, 2, 200)
        own = np.full(200, 16)
        most = rng.uniform(0.05, 0.5) * parts.mean()
        points = closed_form.points_per_pixel(parts, own, levels, most)
        assert (parts * 16 / points).mean() <= most
        rounded = parts * (1 + 1e-7 * rng.standard_normal(200))
        assert np.array_equal(closed_form.points_per_pixel(rounded, own, levels, most), points)


def test_a_measurement_counts_as_much_as_it_is_certain_or_beyond_doubt():
    expected = Estimate(2.0, 3.0)
    vague, sharp = (
        closed_form.combine_with_expectation(Estimate(6.0, s), expected) for s in (100.0, 0.1)
    )
    assert vague.error == pytest.approx(2, abs=0.01)
    assert vague.standard_error == pytest.approx(3, abs=0.01)
    assert (sharp.error, sharp.standard_error) == pytest.approx((6.0, 0.1), abs=0.01)
    assert closed_form.combine_with_expectation(Estimate(400.0, 100.0), expected) == Estimate(
        400.0, 100.0
    )
    # noise of few samples is above by two standard errors now and then
    assert closed_form.combine_with_expectation(Estimate(200.0, 100.0), expected).error < 3


def test_a_closed_form_whose_points_differ_is_expected_to_be_off():
    known = Shaded()
    same = known.direct_light()
    least = closed_form.expected_error(same, MASK)
    assert (least.error, least.standard_error) == (closed_form.OTHER, closed_form.OTHER_SPREAD)
    # grids that differ by noise: the variance says by how much their mean is off
    noise = np.random.default_rng(3).normal(0, 0.02, (4, *same.radiance.shape)).astype(np.float32)
    variance = np.var(noise, axis=0, ddof=1) / 4
    expected = closed_form.expected_error(same._replace(variance=variance), MASK)
    exposure = tone.auto_exposure(same.radiance, MASK)
    off = tone.display_l2(same.radiance + noise.mean(0), same.radiance, exposure, MASK)
    left = closed_form.error_per_difference(False, MASK.size).error
    assert (expected.error - closed_form.OTHER) / left == pytest.approx(off, rel=0.1)
    assert expected.standard_error > least.standard_error
    sampled = closed_form.expected_error(same._replace(variance=variance, sampled=True), MASK)
    assert sampled.bound > expected.bound
    small, large = (closed_form.expected_error_at_limit(limit, 4096) for limit in (1.0, 100.0))
    assert least.error < small.error < large.error


def test_the_error_of_a_closed_form_in_direct_light_is_part_of_the_ratios():
    estimates = []
    for closed in (1.0, 1.03):
        known = Shaded(noise=0.1, deepest=0.8, closed=closed)
        attempt = attempts.Attempt(shown(known), 60.0, choice.ALL)
        assert attempt.try_closed_form() is None or closed
        attempt.direct = known.direct_light()
        made = attempt.run(plans.Plan(0.0, ratio.NAME, 64))
        assert made is not None and made.estimator == ratio.NAME
        estimates.append(made.estimated.error)
    off = error(known.truth * np.float32(1.03), known)
    assert estimates[1] - estimates[0] == pytest.approx(off, rel=0.4)


class Sparse(Known):
    """A ramp of whose light each sample finds a tenth, and with a chance of 2 % the rest."""

    def portion(self, first, count, seed, tier):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(first, count)))
        found = rng.binomial(count, 0.02, size=(*MASK.shape, 1)) / (0.02 * count)
        noisy = np.float32(self.truth * (0.1 + 0.9 * found))
        return Portion(noisy, MASK.astype(np.float32), NO_GUIDES, np.zeros_like(noisy))


def test_the_estimate_counts_what_the_display_curve_makes_of_rare_light():
    known, ratios, without = Sparse(), [], []
    for seed in range(10):
        halves = Halves(shown(known, seed))
        halves.grow(32)
        estimate, truth = halves.estimate(), error(halves.picture, known)
        ratios.append(estimate.error / truth)
        without.append(estimate.noise / truth)
    assert np.mean(without) < 0.7
    assert np.mean(ratios) == pytest.approx(1, abs=0.15)


def test_a_limit_on_rare_light_is_kept():
    achieved = []
    for seed in range(40):
        known = Sparse()
        made = choice.render_within_error(shown(known, seed), 4000.0, ("path-tracing",))
        achieved.append(error(made.radiance, known))
    assert np.mean(np.array(achieved) <= 4000) >= 0.95


def test_path_tracing_plans_the_display_curves_part_by_the_square_of_the_samples():
    pilot = Estimate(100.0, 0.0, curve=40.0)
    assert (pilot.noise, pilot.noise_bound) == (60.0, 60.0)
    assert path_tracing.predict_error(pilot, 4, 8) == pytest.approx(30 + 10)
    needed = path_tracing.needed_samples(pilot, 4, 10.0)
    at_one = [path_tracing.predict_error(pilot, 4, n) for n in (needed, needed - 1)]
    assert at_one[0] <= 10 < 1.05 * at_one[1]
    assert needed < path_tracing.needed_samples(Estimate(100.0, 0.0), 4, 10.0)


def test_the_display_curves_part_is_of_the_fingerprint(monkeypatch):
    before = rules.identity()
    monkeypatch.setattr(halves, "CURVE", 2.0)
    assert rules.identity() != before
