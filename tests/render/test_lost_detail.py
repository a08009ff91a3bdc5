"""Detail that a denoiser took away, put back: on pictures of known truth, and in choices."""

import argparse

import numpy as np
import pytest

from factory.render.estimators import blends, choice, denoised, lost_detail, rules
from factory.render.estimators.attempt import Attempt
from factory.render.estimators.halves import Estimate, Halves
from factory.render.estimators.lost_detail import Effect
from factory.render.estimators.shadow_rays import ShadowedLight
from factory.render.estimators.similar_pixels import average_similar
from factory.render.validation import detail_put_back
from tests.support.known_pictures import MASK, Known, Rays, shown

SIZE = len(MASK)
SLOPE = np.full((SIZE, SIZE, 3), 200, np.float32)  # grey levels per unit of radiance
FACING = np.broadcast_to(np.float32([0, 0, 1]), (SIZE, SIZE, 3))


def put_back(smooth, noisy, normals=FACING):
    return lost_detail.put_back(smooth, noisy, normals, SLOPE, MASK)


def lit_and_shaded():
    """A picture with an edge of light from column to column, and the same as it is smoothed."""
    truth = np.full((SIZE, SIZE, 3), 0.3, np.float32)
    truth[:, SIZE // 2 :] = 0.7
    smooth = truth.copy()
    smooth[:, SIZE // 2 - 4 : SIZE // 2] += 0.05
    smooth[:, SIZE // 2 : SIZE // 2 + 4] -= 0.05
    return truth, smooth


def test_means_are_over_similar_pixels_as_the_formula_has_them():
    rng = np.random.default_rng(3)
    values, features = rng.normal(size=(2, 9, 8, 3)).astype(np.float32)
    mask = rng.random((9, 8)) < 0.7
    near, power = np.float32([1.0, 0.6, 0.2]), 3
    means = average_similar(values, features, mask, near, power)
    for row, column in np.argwhere(mask):
        total, weights = np.zeros(3), 0.0
        for y, x in np.argwhere(mask):
            if max(abs(y - row), abs(x - column)) >= len(near):
                continue
            square = float(((features[y, x] - features[row, column]) ** 2).sum())
            weight = near[abs(y - row)] * near[abs(x - column)]
            weight *= max(1 - square / (2 * power), 0) ** power
            total, weights = total + weight * values[y, x], weights + weight
        np.testing.assert_allclose(means[row, column], total / weights, rtol=1e-4, atol=1e-6)
    assert not means[~mask].any()


def test_bias_at_an_edge_is_taken_away_and_little_noise_added():
    truth, smooth = lit_and_shaded()
    rng = np.random.default_rng(1)
    noise = (0.1 * rng.normal(size=truth.shape)).astype(np.float32)
    without_noise = put_back(smooth, truth)
    left = np.square(without_noise - truth)[MASK].mean() / np.square(smooth - truth)[MASK].mean()
    assert left < 0.5
    added = put_back(smooth, truth + noise) - without_noise
    assert np.square(added)[MASK].mean() < 0.1 * np.square(noise)[MASK].mean()
    np.testing.assert_array_equal(without_noise[~MASK], smooth[~MASK])


def test_nothing_is_put_back_across_a_crease():
    even = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    lacking = even.copy()
    lacking[:, : SIZE // 2] -= 0.05
    creased = FACING.copy()
    creased[:, SIZE // 2 :] = [1, 0, 0]
    restored = put_back(even, lacking, creased)
    np.testing.assert_allclose(restored[MASK], lacking[MASK], atol=1e-6)
    # where normals are alike, the step is smoothed
    assert np.abs(put_back(even, lacking) - lacking)[MASK].max() > 0.01


def test_what_is_far_from_the_smoothed_picture_is_not_put_back():
    """There, the display curve's slope at the smoothed picture does not show the error."""
    smooth, noisy = np.full((SIZE, SIZE, 3), 0.4, np.float32), np.zeros((SIZE, SIZE, 3), np.float32)
    restored = put_back(smooth, noisy)
    np.testing.assert_allclose(restored[MASK], 0.2)
    np.testing.assert_allclose(put_back(smooth, 9 * smooth)[MASK], 0.8)
    overexposed = np.zeros_like(MASK)
    overexposed[SIZE // 2] = True
    slope = np.where(overexposed[..., None], np.float32(0), SLOPE)
    kept = lost_detail.put_back(smooth, noisy, FACING, slope, MASK)
    np.testing.assert_array_equal(kept[overexposed], smooth[overexposed])
    np.testing.assert_array_equal(kept[MASK & ~overexposed], restored[MASK & ~overexposed])


class Edges(Known):
    """A renderer whose denoiser blurs an edge of light."""

    def __init__(self, noise):
        super().__init__(noise)
        self.truth, self.smoothed = lit_and_shaded()

    def denoise(self, portion, effort):
        return (self.smoothed + 0.2 * (portion.noisy - self.truth)).astype(np.float32)


def test_detail_is_put_back_where_it_leaves_less_error():
    for noise, expected in ((0.3, True), (3.0, False)):
        halves = Halves(shown(Edges(noise)))
        halves.grow(32)
        smooth = halves.denoised_pictures()
        blend = blends.choose_blend(halves, smooth, halves.pictures, 1e3, (0.0,), with_detail=True)
        assert blend.has_detail == expected
        without = blends.choose_blend(halves, smooth, halves.pictures, 1e3, (0.0,))
        assert not without.has_detail
        assert blend.bias_alone == without.bias
        assert (blend.estimate.bound < without.estimate.bound) == expected


def test_a_denoised_picture_needs_fewer_samples_with_detail_put_back(monkeypatch):
    def samples():
        made = choice.render_within_error(shown(Edges(1.0)), 30.0, ("path-tracing", "denoised"))
        return made.samples

    fewer = samples()
    monkeypatch.setattr(blends, "_put_back_detail", lambda halves, smooth, *_: smooth)
    assert fewer < samples()


def test_blends_are_expected_as_their_parts_say():
    """By drawing noise: smooth pictures of bias b have own noise, an average, and the noise."""
    rng = np.random.default_rng(0)
    noise, own = rng.normal(size=(2, 400_000))
    bias, detail, with_noise = 0.8, Effect(0.25, 0.16), 1.5
    average = np.sqrt(detail.noise) * (
        np.sqrt(detail.noise) * noise + np.sqrt(1 - detail.noise) * rng.normal(size=noise.shape)
    )
    for number, share in enumerate((0.0, 0.3, 1.0)):
        rest = 1 - share
        smooth = np.sqrt(bias * (with_noise - 1)) * own
        expected = blends.predict_blends(bias, 1.0, with_noise, detail, (0.0, 0.3, 1.0))
        plain = rest * (np.sqrt(bias) + smooth) + share * noise
        restored = rest * (np.sqrt(detail.bias * bias) + smooth + average) + share * noise
        assert expected[2 * number][0] == pytest.approx((plain**2).mean(), rel=0.02)
        assert expected[2 * number + 1][0] == pytest.approx((restored**2).mean(), rel=0.02)
        assert expected[2 * number + 1][1] == pytest.approx(rest**2 * detail.bias * bias)


def test_rules_name_what_puts_detail_back(monkeypatch):
    before = rules.identity()
    for module, name in ((lost_detail, "VALUES"), (lost_detail, "POWER"), (denoised, "DETAIL")):
        with monkeypatch.context() as patch:
            value = getattr(module, name)
            patch.setattr(module, name, Effect(0.9, 0.9) if name == "DETAIL" else 2 * value)
            assert rules.identity() != before


def test_a_vague_measurement_of_direct_light_does_not_rule_shadow_rays_out(monkeypatch):
    """What few samples show is far above what is expected: the best guess stays between them."""
    attempt = Attempt(shown(Rays()), 2.0, ("path-tracing", "shadow-rays"))
    attempt.direct = attempt.shown.renderer.direct_light(16)
    attempt.shadowed = ShadowedLight(attempt.shown, attempt.direct, 2.0)
    attempt.expected = Estimate(0.1, 0.2)
    monkeypatch.setattr(ShadowedLight, "measure", lambda *_: Estimate(0.9, 0.5))
    now, later = (attempt.shadowed_errors()(attempt.halves.samples * n) for n in (1, 100))
    assert now == attempt.shadowed_error()
    assert later.error == pytest.approx(now.error)
    assert later.error < 0.3 < 0.9 and later.standard_error < 0.1 * now.standard_error


def test_the_measurement_finds_what_detail_is_worth():
    known = Edges(0.6)
    rows = detail_put_back.measure_shot(shown(known), 4096)
    by_samples = {row["samples"]: row for row in rows if row["estimator"] == "denoised"}
    assert set(by_samples) == set(detail_put_back.SAMPLES)
    many = by_samples[128]
    assert many["with"]["squared_bias"] < 0.6 * many["without"]["squared_bias"]
    assert many["with"]["least_limit"] < 0.9 * many["without"]["least_limit"]
    seeds = {seed for _, _, seed in known.requested}
    assert len(seeds) == 4  # the reference has none of the picture's samples
    # what is left of the noise by the denoiser is a fifth of its amplitude
    own = many["without"]["error"] - many["without"]["squared_bias"]
    assert own == pytest.approx(0.04 * many["noise"], rel=0.1)


def test_the_page_of_the_measurement_has_a_line_for_each_estimator():
    options = argparse.Namespace(size=24, shots=1, seed=5, meshes=None, reference=16)
    rows = detail_put_back.measure(options)
    assert {row["estimator"] for row in rows} >= {"denoised"}
    about = {"command": "command", "commit": "1", "date": "today", "machine": "one"}
    page = detail_put_back.report({**about, "size": 24, "reference": 16, "rows": rows})
    for samples in detail_put_back.SAMPLES:
        assert f"| denoised | {samples} | 1 |" in page
