"""Methods inside a model that torch.compile takes apart: the same picture and the same
derivatives.
"""

import pytest
import torch

from learn import methods
from learn.layer import RenderLayer
from tests.support.card_scenes import MATERIALS, light, material, sphere


class Model(torch.nn.Module):
    def __init__(self, method):
        super().__init__()
        self.gain = torch.nn.Parameter(torch.tensor(1.5))
        self.layer = RenderLayer(method=method, tolerance=1e-1)

    def forward(self, n, m, L):
        return torch.tanh(self.layer(n, self.gain * m, L)).mean()


# torch's own, while it traces
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")
@pytest.mark.parametrize("name", methods.NAMES)
def test_a_compiled_model_gives_what_the_plain_one_gives(name):
    given, model = (sphere(8), material(*MATERIALS["satin"]), light("sky")), Model(name)
    plain = model(*given)
    plain.backward()
    slope, model.gain.grad = model.gain.grad.clone(), None
    torch.compiler.reset()
    compiled = torch.compile(model, backend="aot_eager")(*given)
    compiled.backward()
    torch.testing.assert_close(compiled, plain, rtol=1e-5, atol=0)
    torch.testing.assert_close(model.gain.grad, slope, rtol=1e-5, atol=0)
