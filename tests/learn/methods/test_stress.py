"""A few of the pictures of tests/endurance/layer_stress.py for every method."""

import pytest

from learn import methods
from tests.endurance.layer_stress import not_finite
from tests.support.card_scenes import names_for_a_view_per_pixel

CASES = [
    *((name, False) for name in methods.NAMES),
    *((name, True) for name in names_for_a_view_per_pixel()),
]


@pytest.mark.parametrize(
    "name, view_per_pixel",
    CASES,
    ids=[f"{name}-{'view per pixel' if per_pixel else 'distant'}" for name, per_pixel in CASES],
)
def test_adversarial_pixels_have_finite_values_and_derivatives(name, view_per_pixel):
    tolerance = 1e-1 if name.startswith("monte_carlo") else 1e-2  # 32 samples instead of 512
    assert (
        not_finite(
            name, 800, seed=1, tolerance=tolerance, pixels=100, view_per_pixel=view_per_pixel
        )
        == 0
    )
