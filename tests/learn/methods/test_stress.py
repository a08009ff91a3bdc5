"""A few of the pictures of tests/endurance/layer_stress.py for every method."""

import pytest

from learn import methods
from tests.endurance.layer_stress import not_finite


@pytest.mark.parametrize("view_per_pixel", [False, True], ids=["distant", "view per pixel"])
@pytest.mark.parametrize("name", methods.NAMES)
def test_adversarial_pixels_have_finite_values_and_derivatives(name, view_per_pixel):
    if view_per_pixel and "orthographic" in methods.load(name).CARD.needs:
        pytest.skip("needs an orthographic camera")
    tolerance = 1e-1 if name.startswith("monte_carlo") else 1e-2  # 32 samples instead of 512
    assert (
        not_finite(
            name, 800, seed=1, tolerance=tolerance, pixels=100, view_per_pixel=view_per_pixel
        )
        == 0
    )
