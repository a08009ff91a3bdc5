"""Blends of smooth and noisy pictures: their bias, on pictures of known truth and noise."""

import numpy as np
import pytest

from factory.render.estimators import blends, choice, closed_form, rules
from factory.render.estimators.halves import Halves
from factory.render.estimators.renderer import Shown
from shaders import tone
from tests.support.known_pictures import MASK, Known, Shaded, error, shown


def squared_bias(pair, known):
    """Mean of (P1 − T)(P2 − T) in display values, of two independent pictures."""
    exposure = tone.auto_exposure(known.truth, MASK)
    truth = tone.display(known.truth[MASK], exposure)
    a, b = (tone.display(each[MASK], exposure) - truth for each in pair)
    return float((a * b).mean())


@pytest.mark.parametrize("bias", [0.0, 0.02, 0.04])
def test_the_bias_of_a_pair_is_what_its_spread_does_not_show(bias):
    estimates, truths = [], []
    for seed in range(20):
        known = Known(noise=0.2, bias=bias)
        halves = Halves(shown(known, seed))
        halves.grow(64)
        pair = halves.denoised_pictures()
        slope = halves.slope(pair)
        estimates.append(halves.error_and_bias(pair, halves.pictures, slope)[1])
        truths.append(squared_bias(pair, known))
    assert np.mean(estimates) == pytest.approx(np.mean(truths), rel=0.05, abs=0.3)


def test_a_blend_has_less_error_and_less_bias_than_what_it_is_made_of():
    known = Known(noise=0.6, bias=0.08)
    halves = Halves(shown(known))
    halves.grow(64)
    pair = halves.denoised_pictures()
    blend = blends.choose_blend(halves, pair, halves.pictures, 1000.0)
    errors = [error(sum(each) / 2, known) for each in (blend.pair, pair, halves.pictures)]
    assert errors[0] < 0.8 * min(errors[1:])
    assert squared_bias(blend.pair, known) < 0.6 * squared_bias(pair, known)
    assert blend.estimate.error == pytest.approx(errors[0], rel=0.15)


def test_a_small_bias_goes_before_a_small_error():
    known = Known(noise=0.9, bias=0.08)
    halves = Halves(shown(known))
    halves.grow(64)
    pair = halves.denoised_pictures()
    free = blends.choose_blend(halves, pair, halves.pictures, 1000.0)
    bound = blends.choose_blend(halves, pair, halves.pictures, 2 * free.bias)
    assert bound.bias <= 2 / 3 * free.bias
    assert bound.estimate.error >= free.estimate.error
    # where no share suffices, the least error stands
    assert blends.choose_blend(halves, pair, halves.pictures, 1e-3).bias == free.bias


def test_what_every_blend_is_off_by_besides_leaves_less_for_its_own_bias():
    known = Known(noise=0.9, bias=0.08)
    halves = Halves(shown(known))
    halves.grow(64)
    pair = halves.denoised_pictures()
    free = blends.choose_blend(halves, pair, halves.pictures, 1000.0)
    limit = 6 * free.bias
    assert blends.choose_blend(halves, pair, halves.pictures, limit).bias == free.bias
    bound = blends.choose_blend(halves, pair, halves.pictures, limit, known_bias=1.2 * free.bias)
    assert bound.bias <= 0.8 * free.bias


def test_smooth_pictures_stay_as_they_are_where_they_have_no_bias():
    known = Known(noise=0.6, left=0.1)
    halves = Halves(shown(known))
    halves.grow(16)
    pair = halves.denoised_pictures()
    blend = blends.choose_blend(halves, pair, halves.pictures, 1000.0)
    assert all(a is b for a, b in zip(blend.pair, pair, strict=True))


def test_blends_with_pictures_below_zero_are_not_negative():
    known = Known(noise=0.6, bias=0.08)
    halves = Halves(shown(known))
    halves.grow(64)
    pair = halves.denoised_pictures()
    below = [each - 5 for each in halves.pictures]
    blend = blends.choose_blend(halves, pair, below, 1000.0, shares=(0.6,))
    assert min(each.min() for each in blend.pair) == 0


def bias_of_pictures(bias, limit):
    """Mean squared bias of pairs of denoised pictures, of the limit, and their number."""
    ratios = []
    for seed in range(16):
        known = Known(noise=1.0, left=0.05, bias=bias)
        pair = [choice.render_within_error(shown(known, s), limit) for s in (seed, seed + 100)]
        if all(each.estimator == "denoised" for each in pair):
            ratios.append(squared_bias([each.radiance for each in pair], known) / limit)
        assert all(each.estimated.bound <= limit for each in pair)
    return np.mean(ratios), len(ratios)


def test_bias_is_at_most_a_third_of_the_limit(monkeypatch):
    for bias, limit in ((0.07, 60.0), (0.03, 24.0)):
        share, pairs = bias_of_pictures(bias, limit)
        assert share < 1 / 3 and pairs >= 8
    with monkeypatch.context() as patch:  # what is chosen for its estimate is worse
        patch.setattr(blends, "DOUBT", 0.0)
        assert bias_of_pictures(0.07, 60.0)[0] > 1 / 3
    monkeypatch.setattr(blends, "SHARES", (0.0,))
    monkeypatch.setattr(blends, "MOST_BIAS", 1.0)
    monkeypatch.setattr(blends, "_put_back_detail", lambda halves, smooth, *_: smooth)
    share, pairs = bias_of_pictures(0.05, 60.0)
    assert share > 0.4 and pairs >= 8  # without blends and detail it was more


def _make_vague(known):
    """Let the grids of direct light differ, so that only samples say how far it is off."""
    direct_light = known.direct_light

    def differing(points, known=None, where=None):
        direct = direct_light(points)
        return direct._replace(variance=np.full_like(direct.variance, 2e-3))

    known.direct_light = differing


def test_a_closed_form_that_is_a_little_off_is_blended_or_left():
    limit = 20.0
    for closed, alone in ((1.01, True), (1.045, False)):
        known = Shaded(noise=0.4, deepest=1.0, closed=closed)
        _make_vague(known)
        made = choice.render_within_error(Shown(known, 5, "direct", MASK), limit)
        exact = np.float32(known.unblocked * closed)
        assert error(made.radiance, known) <= limit
        assert (made.estimator == closed_form.NAME and (made.radiance == exact).all()) == alone
        assert error(exact, known) < limit  # by the limit alone both could have stood


def test_shares_are_part_of_the_fingerprint(monkeypatch):
    before = rules.identity()
    monkeypatch.setattr(blends, "SHARES", (0.0, 0.5))
    assert rules.identity() != before
