"""Shading that a photograph shows beyond its re-rendering, and how much of it is left for edits."""

import numpy as np
import pytest

from learn.editing import residual_shading
from learn.editing.residual_shading import (
    COLOURED,
    LARGEST,
    coarse_share,
    complete_residual,
    log_ratio,
    weaken,
)

SIZE = 64
INSIDE = np.zeros((SIZE, SIZE), bool)
INSIDE[8:56, 8:56] = True
AGAIN = np.where(INSIDE[..., None], np.float32([0.4, 0.2, 0.1]), 1).astype(np.float32)
WHOLE = INSIDE.astype(np.float32)
REGIONS = INSIDE.astype(int)


def shaded(spread: float) -> np.ndarray:
    """A photograph that is darker in its right half by a factor e^spread."""
    right = np.arange(SIZE)[None, :, None] >= SIZE // 2
    return AGAIN * np.where(right, np.exp(-spread), 1).astype(np.float32)


def coloured(spread: float) -> np.ndarray:
    """A photograph whose colours differ from its re-rendering's, with a standard deviation."""
    rng = np.random.default_rng(0)
    return AGAIN * np.exp(rng.normal(0, spread, AGAIN.shape)).astype(np.float32)


def test_a_shadow_is_in_the_residual_as_it_is_in_the_photograph():
    result = complete_residual(shaded(0.7), AGAIN, REGIONS, WHOLE)
    np.testing.assert_allclose(result[20:40, 10:30], 0.35, atol=1e-5)
    np.testing.assert_allclose(result[20:40, 34:54], -0.35, atol=1e-5)


def test_the_residual_of_each_region_has_no_mean():
    """Its brightness and colour are those of light and material, which were estimated."""
    seen, regions = shaded(0.7), REGIONS.copy()
    seen[:, 48:] *= np.float32([3, 1, 0.5])
    regions[:, 48:] *= 2
    result = complete_residual(seen * np.float32([2, 1, 1]), AGAIN, regions, WHOLE)
    for number in (1, 2):
        np.testing.assert_allclose(result[regions == number].mean(0), 0, atol=1e-5)
    np.testing.assert_allclose(result[20:40, 50:54], 0, atol=1e-5)


def test_beyond_the_object_the_residual_is_that_of_its_nearest_pixel():
    seen = shaded(0.7)
    seen[~INSIDE] = 30
    result = complete_residual(seen, AGAIN, REGIONS, WHOLE)
    np.testing.assert_allclose(result[20:40, 56:], -0.35, atol=1e-5)
    np.testing.assert_allclose(result[20:40, :8], 0.35, atol=1e-5)


def test_the_residual_is_limited_in_both_directions():
    result = np.exp(complete_residual(shaded(6), AGAIN, REGIONS, WHOLE))[INSIDE]
    assert result.max() == pytest.approx(LARGEST) and result.min() == pytest.approx(1 / LARGEST)


def test_behind_a_label_is_the_mean_of_what_surrounds_it():
    seen, weights = shaded(0.7), WHOLE.copy()
    label = (slice(28, 36), slice(42, 50))
    seen[label], weights[label] = (0.9, 0.9, 0.9), 0
    result = complete_residual(seen, AGAIN, REGIONS, weights)
    assert np.abs(result[label] - result[20, 46]).max() < 0.02
    assert result[20, 46, 0] - result[20, 20, 0] == pytest.approx(-0.7, abs=1e-5)


def test_an_object_without_a_pixel_of_its_own_has_no_residual():
    assert not complete_residual(shaded(0.7), AGAIN, 0 * REGIONS, WHOLE).any()
    assert coarse_share(shaded(0.7), AGAIN, 0 * REGIONS, WHOLE) == 0


def test_dark_pixels_count_as_equally_dark():
    seen = AGAIN.copy()
    seen[20:24, 20:24] = 0
    again = AGAIN.copy()
    again[20:24, 20:24] = 1e-9
    assert np.abs(log_ratio(seen, again, INSIDE)[20:24, 20:24]).max() == 0


@pytest.mark.parametrize("spread", [0.1, 0.7])
def test_shading_without_colour_is_kept_whole(spread):
    share = coarse_share(shaded(spread), AGAIN, INSIDE.astype(int), WHOLE)
    assert share == pytest.approx(1, rel=1e-3)


def test_the_more_colours_the_residual_has_the_less_is_left():
    regions = INSIDE.astype(int)
    shares = [coarse_share(coloured(s), AGAIN, regions, WHOLE) for s in (0.02, 0.15, 0.2, 0.5)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.99 and shares[-1] < 0.05


def test_half_is_left_at_the_spread_that_the_constant_names():
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 0.2, AGAIN.shape)
    for _ in range(20):  # to a spread of COLOURED, by the definition of the residual's colour
        seen = AGAIN * np.exp(noise).astype(np.float32)
        full = log_ratio(seen, AGAIN, INSIDE, residual_shading.FLOOR_OF_COLOURS)[INSIDE]
        luminance = [x @ residual_shading.LUMINANCE for x in (seen, AGAIN)]
        grey = log_ratio(*luminance, INSIDE, residual_shading.FLOOR_OF_COLOURS)[INSIDE]
        colour = full - grey[:, None]
        noise *= COLOURED / np.sqrt(((colour - colour.mean(0)) ** 2).mean())
    share = coarse_share(seen, AGAIN, INSIDE.astype(int), WHOLE)
    assert share == pytest.approx(0.5, rel=1e-3)


def test_parts_in_two_colours_are_no_print_if_each_is_a_region():
    seen = AGAIN.copy()
    seen[:, 32:] *= np.float32([0.5, 1.0, 2.0])
    regions = INSIDE.astype(int)
    as_one = coarse_share(seen, AGAIN, regions, WHOLE)
    regions[:, 32:] *= 2
    assert as_one < 0.2 < 0.99 < coarse_share(seen, AGAIN, regions, WHOLE)


def test_labels_do_not_count_as_colours():
    seen, weights = AGAIN.copy(), WHOLE.copy()
    seen[20:40, 20:40] = (0.05, 0.05, 0.9)
    weights[20:40, 20:40] = 0
    regions = INSIDE.astype(int)
    assert coarse_share(seen, AGAIN, regions, WHOLE) < 0.2
    assert coarse_share(seen, AGAIN, regions, weights) == pytest.approx(1, rel=1e-3)


def test_of_a_residual_with_colours_half_the_fine_part_is_left():
    """A step across the object is coarse, stripes of one pixel are fine."""
    step = np.where(np.arange(SIZE)[None, :] >= SIZE // 2, -0.7, 0.0)
    stripes = np.where(np.arange(SIZE)[:, None] % 2 == 0, 0.1, -0.1)
    residual = np.repeat((step + stripes)[..., None], 3, 2).astype(np.float32)
    np.testing.assert_array_equal(weaken(residual, INSIDE, 1.0, 2.0), residual)
    strong = np.exp(weaken(20 * residual, INSIDE, 0.0, 2.0) / residual_shading.LEAST_FINE)
    assert strong[24:40].max() == pytest.approx(residual_shading.LARGEST_FINE, rel=1e-3)
    for share, fine in ((0.0, 0.5), (0.4, 0.5), (0.8, 0.8)):
        result = weaken(residual, INSIDE, share, 2.0)
        for columns, level in ((slice(12, 20), 0.0), (slice(44, 52), -0.7)):
            part = result[24:40, columns]
            assert part.mean() == pytest.approx(share * level, abs=0.01)
            assert np.abs(np.diff(part, axis=0)).mean() == pytest.approx(0.2 * fine, abs=0.01)


def test_a_weakened_residual_does_not_bleed_in_from_beyond_the_object():
    residual = np.where(INSIDE[..., None], -0.7, 3.0).astype(np.float32).repeat(3, -1)[..., :3]
    np.testing.assert_allclose(weaken(residual, INSIDE, 0.2, 2.0)[INSIDE], -0.14, atol=1e-5)
