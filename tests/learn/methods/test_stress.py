"""A few of the pictures of stress.py for every method."""

import pytest
from stress import not_finite

from learn import methods


@pytest.mark.parametrize("name", methods.NAMES)
def test_adversarial_pixels_have_finite_values_and_derivatives(name):
    assert not_finite(name, samples=1200, seed=1, pixels=100) == 0
