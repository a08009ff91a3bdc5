"""The display curve has the standard's values, and the paper's L2 has its closed forms."""

import numpy as np
import pytest

from shaders import tone


def test_srgb_curve_has_the_standards_values():
    # IEC 61966-2-1: the straight part, the join, middle grey, white
    linear = np.array([0.0, 0.001, 0.0031308, 0.18, 0.5, 1.0])
    np.testing.assert_allclose(
        tone.srgb(linear), [0.0, 0.01292, 0.0404499, 0.461356, 0.735357, 1.0], atol=1e-6
    )


def test_srgb_curve_is_undone_by_the_standards_inverse(rng):
    x = rng.uniform(0, 1, 1000)
    y = tone.srgb(x)
    # the standard's own constants leave a step of 3e-8 at the join
    np.testing.assert_allclose(tone.linear_from_srgb(y), x, atol=1e-7)
    standard = np.where(y <= 0.04045, y / 12.92, ((y + 0.055) / 1.055) ** 2.4)
    np.testing.assert_array_equal(tone.linear_from_srgb(y), standard)


def test_srgb_curve_clips_what_a_display_cannot_show():
    np.testing.assert_allclose(tone.srgb(np.array([-3.0, 1.0, 7.0])), [0, 1, 1], rtol=1e-15)


def test_srgb_slope_is_finite_at_black():
    torch = pytest.importorskip("torch")
    x = torch.tensor([0.0, 1e-9, 0.5], dtype=torch.float64, requires_grad=True)
    tone.srgb(x).sum().backward()
    np.testing.assert_allclose(x.grad[:2].numpy(), 12.92, rtol=1e-12)
    assert x.grad.isfinite().all()


def test_display_l2_of_equal_pictures_is_zero_and_of_black_and_white_is_255_squared():
    white, black = np.ones((4, 4, 3)), np.zeros((4, 4, 3))
    assert tone.display_l2(white, white, 1.0) == 0
    assert tone.display_l2(white, black, 1.0) == pytest.approx(255.0**2, rel=1e-14)


def test_display_l2_over_the_mask_ignores_the_background_and_over_the_frame_dilutes_by_coverage(
    rng,
):
    a, b = rng.uniform(0, 1, (2, 8, 8, 3))
    mask = np.zeros((8, 8), dtype=bool)
    mask[2:6, 2:6] = True
    a[~mask] = b[~mask] = 0
    assert tone.display_l2(a, b, 1.0) == pytest.approx(
        tone.display_l2(a, b, 1.0, mask) * mask.mean()
    )


def test_auto_exposure_follows_the_lights_strength_so_that_the_display_does_not_change(rng):
    picture, mask = rng.lognormal(0, 1, (16, 16, 3)), rng.uniform(size=(16, 16)) < 0.5
    exposure = tone.auto_exposure(picture, mask)
    assert tone.auto_exposure(picture * 250.0, mask) == pytest.approx(exposure / 250.0)
    level = (picture[mask] * exposure) @ [0.2126, 0.7152, 0.0722]
    assert np.percentile(level, 99) == pytest.approx(1.0)


def test_auto_exposure_of_nothing_or_of_black_is_one():
    black = np.zeros((4, 4, 3))
    assert tone.auto_exposure(black, np.ones((4, 4), bool)) == 1.0
    assert tone.auto_exposure(black + 1, np.zeros((4, 4), bool)) == 1.0
