"""What samples of noisy pixels can save, for noise that is known."""

import numpy as np
import pytest

from factory.render.validation import sample_division
from shaders import tone

MASK = np.zeros((24, 30), bool)
MASK[3:21, 4:26] = True
PIXELS = int(MASK.sum())


def test_equal_noise_leaves_nothing_to_save():
    assert sample_division.best_gain(np.full(100, 3.0)) == pytest.approx(1)
    # one pixel in a hundred has all noise: it alone has samples
    assert sample_division.best_gain(np.r_[np.zeros(99), 3.0]) == pytest.approx(100)


def test_no_division_of_samples_saves_more_than_the_best_and_equal_errors_save_nothing():
    rng = np.random.default_rng(0)
    variance = np.exp(rng.normal(size=500))
    best = sample_division.best_gain(variance)
    assert sample_division.gain_of(np.sqrt(variance), variance) == pytest.approx(best)
    assert sample_division.gain_of(variance, variance) == pytest.approx(1)  # as Cycles divides them
    assert sample_division.gain_of(np.ones(500), variance) == pytest.approx(1)
    for _ in range(20):
        assert sample_division.gain_of(np.exp(rng.normal(size=500)), variance) < best


def test_the_variance_is_that_of_display_values_to_first_order():
    rng = np.random.default_rng(1)
    truth = rng.uniform(0.1, 0.6, (PIXELS, 3)).astype(np.float32)
    truth[0] = 5.0  # white, whatever its noise
    noise = 1e-3 * rng.normal(size=(400, PIXELS, 3))
    pictures = (truth + noise).astype(np.float32)
    whole = np.zeros((*MASK.shape, 3), np.float32)
    whole[MASK] = pictures.mean(0)
    shown = tone.display(pictures, tone.auto_exposure(whole, MASK))
    variance = sample_division.display_variance(pictures, MASK)
    assert variance[0] == 0
    below_white = (shown.mean(0) < 250).all(-1)  # at white itself noise is cut off on one side
    assert below_white.mean() > 0.5
    expected = shown.var(0, ddof=1).mean(-1)
    np.testing.assert_allclose(variance[below_white], expected[below_white], rtol=0.02)


def test_squares_of_pixels_save_what_their_means_leave():
    y, _ = np.nonzero(MASK)
    variance = np.where(y < sample_division.TILE, 1.0, 9.0)  # a square's edge lies between the two
    known = sample_division.over_tiles(variance, MASK)
    np.testing.assert_allclose(known, variance)
    mixed = np.where(y < 4, 50.0, 1.0)  # one row of a square: its mean counts
    known = sample_division.over_tiles(mixed, MASK)
    assert known.mean() == pytest.approx(mixed.mean())
    assert 1 < sample_division.best_gain(known) < sample_division.best_gain(mixed)


def test_an_uncertain_variance_is_averaged_over_neighbours_inside_the_mask():
    picture = np.zeros(MASK.shape)
    picture[10, 10], picture[3, 4] = 9.0, 4.0  # inside, and at a corner with four neighbours
    share = np.zeros(MASK.shape)
    share[MASK] = sample_division.piloted_share(picture[MASK], MASK)
    assert share[9, 11] == pytest.approx(1) and share[4, 5] == pytest.approx(np.sqrt(4 / 9))
    assert share[3, 4] == pytest.approx(1)
    assert 0 < share[15, 20] < 0.1
