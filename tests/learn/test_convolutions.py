"""Convolutions of the networks on the smallest pictures, where oneDNN's own have failed."""

import pytest
import torch

from learn.networks.compact import Convolution


def fill_free_memory():
    """Leave blocks of large values to whatever takes memory next and does not write it."""
    blocks = [torch.full((count,), 1e30) for count in (1_000, 100_000, 600_000, 4_000_000)]
    del blocks


@pytest.mark.parametrize("shape", [(1, 1), (4, 1), (1, 4), (5, 6)])
@pytest.mark.parametrize("stride", [1, 2])
def test_gradients_in_bfloat16_are_those_in_float32_at_any_size(shape, stride):
    torch.manual_seed(0)
    convolution, x = Convolution(256, 256, stride), torch.randn(16, 256, *shape)
    reference = torch.nn.functional.conv2d(x, convolution.weight, None, stride, 1)
    (expected,) = torch.autograd.grad(reference.square().sum(), convolution.weight)
    torch.testing.assert_close(convolution(x), reference)
    for _ in range(20):
        fill_free_memory()
        with torch.autocast("cpu", torch.bfloat16):
            y = convolution(x)
        (gradient,) = torch.autograd.grad(y.float().square().sum(), convolution.weight)
        assert (gradient - expected).norm() < 0.02 * expected.norm()
