"""What every test of the engines needs."""

import pytest

from learn.engines import machine_code


@pytest.fixture(autouse=True)
def needs_numba():
    if not machine_code.is_available():
        pytest.skip("numba is not installed: no CPU engine to test")
