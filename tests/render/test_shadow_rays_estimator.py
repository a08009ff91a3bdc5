"""The estimator by shadow rays: what it is chosen for, and what it may not hide."""

import numpy as np
import pytest

from factory.render.estimators import attempt, blends, closed_form, path_tracing, plans, shadow_rays
from factory.render.estimators.attempt import Attempt
from factory.render.estimators.choice import ALL, render_within_error
from factory.render.estimators.halves import Estimate
from factory.render.estimators.shadow_rays import ShadowedLight
from tests.support.known_pictures import MASK, Mirrored, Rays, error, shown

WITHOUT = tuple(each for each in ALL if each != shadow_rays.NAME)
RAYS_ALONE = (path_tracing.NAME, closed_form.NAME, shadow_rays.NAME)


def test_a_shaded_ramp_is_rendered_by_rays_from_few_samples():
    known = Rays()
    made = render_within_error(shown(known), 5.0)
    assert made.estimator == shadow_rays.NAME and made.samples <= 64
    assert error(made.radiance, known) < 5.0
    assert made.estimated.bound <= 5.0
    without = render_within_error(shown(Rays()), 5.0, WITHOUT)
    assert without.samples > 2 * made.samples


def test_indirect_light_that_the_denoiser_spoils_stays_noisy(monkeypatch):
    known = Mirrored()
    made = render_within_error(shown(known), 20.0, RAYS_ALONE)
    assert made.estimator == shadow_rays.NAME
    assert error(made.radiance, known) < 20.0
    monkeypatch.setattr(shadow_rays, "SHARES", blends.SHARES)
    monkeypatch.setitem(attempt.SHARES, shadow_rays.NAME, blends.SHARES)
    with_less = render_within_error(shown(Mirrored()), 20.0, RAYS_ALONE)
    assert with_less.estimator != shadow_rays.NAME and with_less.samples > 2 * made.samples


@pytest.mark.parametrize(("grain", "smoothed"), [(0.003, False), (0.08, True)])
def test_indirect_light_with_little_noise_is_not_denoised(grain, smoothed):
    known = Mirrored(grain=grain, spoilt=0.0)
    made = render_within_error(shown(known), 10.0, RAYS_ALONE)
    assert made.estimator == shadow_rays.NAME and made.estimated.bound <= 10.0
    assert error(made.radiance, known) < 10.0
    assert (known.smoothed > 0) == smoothed


def test_noisy_indirect_light_that_breaks_the_limit_is_denoised_after_all(monkeypatch):
    monkeypatch.setattr(shadow_rays, "LITTLE", 100.0)
    known = Mirrored(grain=0.4, spoilt=0.0)
    made = render_within_error(shown(known), 5.0, RAYS_ALONE)
    assert made.estimator == shadow_rays.NAME and known.smoothed > 0
    assert error(made.radiance, known) < 5.0


@pytest.mark.parametrize(
    ("failed", "growth"),
    [(Estimate(6.0, 0.1), 1.5), (Estimate(66.0, 34.0), 1.5), (Estimate(46.6, 1.0), 3.0)],
)
def test_a_try_far_above_the_limit_is_followed_by_many_more_samples(failed, growth):
    """But not where it may be as far above by chance."""
    assert plans.growth_after(failed, 5.0) == pytest.approx(growth, rel=0.01)


def test_rays_are_among_the_estimators_only_where_they_are_named():
    known = Rays()
    assert render_within_error(shown(known), 5.0, WITHOUT).estimator != shadow_rays.NAME
    assert not known.rays
    assert render_within_error(shown(known), 5.0).estimator == shadow_rays.NAME


def test_rays_that_are_wrong_are_seen_by_the_samples():
    kept = 0
    for seed in range(8):
        known = Rays(off=0.75, noise=0.2)
        made = render_within_error(shown(known, seed), 5.0)
        kept += error(made.radiance, known) <= 5.0
    assert kept >= 7


def test_more_rays_are_cast_where_the_halves_differ():
    known, limit = Rays(spread=0.4), 10.0
    light = ShadowedLight(shown(known), known.direct_light(), limit)
    assert light.noise.error <= limit * shadow_rays.ENOUGH
    first, other, *later = [where for rays, half, where in known.rays]
    for where in (first, other):
        np.testing.assert_array_equal(where, known.direct_light().alpha > 0)
    further = np.sum(later, axis=0)
    lit = (known.share == 1).repeat(MASK.shape[0], 0)[..., 0]
    # of the columns in light, which have no noise, only the neighbours of others get more
    assert further[MASK & lit].mean() < 0.6 * further[MASK & ~lit].mean()
    assert error(light.picture, known) == pytest.approx(light.noise.error, rel=0.3)


@pytest.mark.parametrize(
    ("left", "off", "rounds"), [(0.3, 0.0, 1), (0.4, 0.0, 2), (0.3, 5.0, 3), (0.2, 9.0, 1)]
)
def test_noise_that_rays_leave_where_they_count_is_tolerated(monkeypatch, left, off, rounds):
    """A third of the limit, of which the first rays of all pixels may leave a fifth, and half of
    what is left beside what else is expected.
    """
    known, limit = Rays(spread=0.4), 10.0
    light = ShadowedLight(shown(known), known.direct_light(), limit, Estimate(off, 0.0))
    noise = iter([0.3, left, 0.3])
    monkeypatch.setattr(light, "_parts", lambda: np.full(int(MASK.sum()), limit * next(noise)))
    numbers = set()
    real = light._round

    def cast(number, *others):
        numbers.add(number // len(shadow_rays.FURTHER))
        return real(number, *others)

    monkeypatch.setattr(light, "_round", cast)
    light._cast()
    assert numbers == set(range(rounds + 1))


def test_most_rays_are_cast_where_the_halves_differ_most():
    """By four times the noise, a pixel is worth about four times the rays."""
    known = Rays(spread=0.2)
    columns = np.arange(MASK.shape[1])
    known.share[:] = np.where(columns < 20, 0.5, 0.9)[None, :, None]
    loud = known.visible_share

    def visible_share(points, rays, seed, half, where=None, turn=0):
        share = loud(points, rays, seed, half, where)
        quiet = share.sent * known.share
        calm = (columns >= 20)[None, :, None]
        arrived = np.where(calm, quiet + 0.25 * (share.arrived - quiet), share.arrived)
        cast.append(share.sent[..., 0])
        return share._replace(arrived=arrived)

    cast: list[np.ndarray] = []
    known.visible_share = visible_share
    limit = 0.6  # so small that either side needs more
    light = ShadowedLight(shown(known), known.direct_light(), limit)
    assert light.noise.error <= limit * shadow_rays.TOLERATED
    all_rays = np.sum(cast, axis=0)
    loud_side, calm_side = (
        all_rays[MASK & side[None]].mean() for side in (columns < 20, columns >= 20)
    )
    assert 2 < loud_side / calm_side < 8


def test_what_is_left_of_a_limit_decides_how_many_samples_are_needed():
    scale, small = shadow_rays.expected_scale(128 * 128), Estimate(0.1, 0.1)
    needed = [
        shadow_rays.needed_samples(noise, 4, scale, limit, lambda _: small)
        for noise, limit in ((0.0, 5.0), (50.0, 20.0), (50.0, 5.0), (200.0, 5.0))
    ]
    assert needed == sorted(needed) and needed[0] == shadow_rays.LEAST
    assert needed[-1] <= shadow_rays.MOST_SAMPLES
    # no samples help where direct light is too uncertain, or its own error is more than the bias
    # that is allowed
    for known in (Estimate(0.1, 3.0), Estimate(2.0, 0.0)):
        assert (
            shadow_rays.needed_samples(0.0, 4, scale, 5.0, lambda _, off=known: off)
            > shadow_rays.MOST_SAMPLES
        )


def test_more_samples_are_planned_where_they_make_direct_light_certain():
    """A limit of 1 that 4 samples cannot show to be kept, because they leave doubt of 1."""
    scale = shadow_rays.expected_scale(128 * 128)
    count = shadow_rays.needed_samples(0.0, 4, scale, 1.0, lambda n: Estimate(0.2, 4.0 / n))
    assert 1.645 * 4.0 / count <= 0.8 - 0.2 < 1.645 * 4.0 / (count / 1.2)
    errors = Attempt(shown(Rays(noise=0.05)), 2.0, ALL).shadowed_errors()
    doubts = [errors(samples).standard_error for samples in (4, 64, 1024)]
    assert doubts == sorted(doubts, reverse=True) and doubts[2] < 0.7 * doubts[0]


def test_indirect_light_that_is_dim_has_no_more_bias_than_energy():
    scale, known = shadow_rays.expected_scale(128 * 128), Estimate(0.1, 0.1)
    bright, dim = (
        shadow_rays.needed_samples(20.0, 4, scale, 5.0, lambda _: known, energy)
        for energy in (1e4, 1.0)
    )
    assert dim < bright


def test_wide_limits_of_large_frames_have_fewer_points():
    few, many = shadow_rays.FEW_POINTS, shadow_rays.POINTS
    for sampled, expected in ((False, [many, few, few]), (True, [many, many, few])):
        points = [shadow_rays.points_of(limit, 64 * 64, sampled) for limit in (5.0, 20.0, 60.0)]
        assert points == expected
        assert shadow_rays.points_of(2.0, 256 * 256, sampled) == few
        assert shadow_rays.points_of(1.0, 256 * 256, sampled) == many


def test_rays_from_few_points_are_planned_for_less():
    few, many = (
        shadow_rays.cost_in_samples(1000, points)
        for points in (shadow_rays.FEW_POINTS, shadow_rays.POINTS)
    )
    assert few + 5 < many < shadow_rays.cost_in_samples(100, shadow_rays.POINTS)
