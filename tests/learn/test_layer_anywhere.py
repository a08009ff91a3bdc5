"""The layer inside other people's programs, and on unlikely inputs."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learn.layer import RenderLayer, render


class Painter(torch.nn.Module):
    """A small network that ends in the layer: normals and a material from a picture, under a given
    light.
    """

    def __init__(self):
        super().__init__()
        self.normals = torch.nn.Conv2d(3, 3, 3, padding=1)
        self.material = torch.nn.Linear(3, 108)
        self.layer = RenderLayer(method="exact")

    def forward(self, picture, light):
        x, y, z = self.normals(picture).unbind(1)
        n = torch.nn.functional.normalize(torch.stack([x, y, 1 + z * z], -1), dim=-1)
        return self.layer(
            n, torch.nn.functional.softplus(self.material(picture.mean((2, 3)))), light
        )


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the compiler's own parts
@pytest.mark.filterwarnings("ignore::FutureWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_compiled_network_with_the_layer_gives_the_same_picture_and_gradients():
    torch.manual_seed(0)
    model, picture, light = Painter(), torch.rand(2, 3, 6, 5), torch.rand(2, 8, 16, 3)
    plain = model(picture, light)
    plain.sum().backward()
    expected = model.material.weight.grad.clone()
    model.zero_grad()
    # the graph's capture is what could fail; no C++ compiler is asked for
    compiled = torch.compile(model, backend="aot_eager")
    seen = compiled(picture, light)
    seen.sum().backward()
    torch.testing.assert_close(seen, plain, rtol=1e-5, atol=1e-7)
    torch.testing.assert_close(model.material.weight.grad, expected, rtol=1e-4, atol=1e-6)


def test_a_network_learns_through_the_layer():
    torch.manual_seed(0)
    model, picture, light = Painter(), torch.rand(1, 3, 6, 5), torch.rand(1, 8, 16, 3)
    expected = 1.5 * model(picture, light).detach()
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-2)
    losses = []
    for _ in range(30):
        loss = ((model(picture, light) - expected) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.2 * losses[0]


UNIT = st.floats(0, 1)
EXTREME_KAPPA = st.one_of(st.just(0.0), st.floats(-12, math.log(30)).map(math.exp))
EXTREME_GAMMA = st.floats(math.log(1e-3), math.log(1e5)).map(math.exp)


@st.composite
def adversarial(draw):
    """Scenes at the edges: grazing normals, texels at the pole, on the horizon and at the mirror
    direction, lobes of every width.
    """
    cos_o, phi = (
        draw(st.one_of(st.floats(-6, 0).map(lambda e: 10**e), UNIT)),
        draw(st.floats(0, 2 * math.pi)),
    )
    sin_o = math.sqrt(max(0.0, 1 - cos_o**2))
    n = torch.tensor([sin_o * math.cos(phi), sin_o * math.sin(phi), cos_o])
    tilt, turn = draw(st.floats(0, 1.5)), draw(st.floats(0, 2 * math.pi))
    view = torch.tensor(
        [math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), math.cos(tilt)]
    )
    values = [[draw(EXTREME_KAPPA), draw(EXTREME_GAMMA)] for _ in range(3)]
    m = torch.tensor(values)[None, :, :, None].expand(3, 3, 2, 6).reshape(1, 108).contiguous()
    if draw(st.booleans()):
        m = m * torch.linspace(draw(st.floats(0.01, 1)), 1, 108)  # control values that differ
    light = torch.zeros(8, 16, 3)
    for _ in range(draw(st.integers(0, 3))):
        light[draw(st.integers(0, 7)), draw(st.integers(0, 15))] = draw(
            st.floats(-6, 6).map(lambda e: 10**e)
        )
    return {
        "n": n.reshape(1, 1, 1, 3),
        "material": m,
        "light": light[None],
        "view": view.reshape(1, 1, 1, 3),
    }


@pytest.mark.parametrize("method", ["exact", "quadrature"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_nothing_is_ever_infinite(method, dtype):
    @settings(max_examples=60, deadline=None, derandomize=True)
    @given(adversarial(), st.booleans())
    def holds(scene, perspective):
        if not perspective:
            scene = {key: value for key, value in scene.items() if key != "view"}
        leaves = {key: torch.nn.Parameter(value.to(dtype)) for key, value in scene.items()}
        picture = render(**leaves, method=method)
        assert picture.isfinite().all() and (picture >= 0).all()
        picture.sum().backward()
        for name, leaf in leaves.items():
            assert leaf.grad is None or leaf.grad.isfinite().all(), name

    holds()


@pytest.mark.filterwarnings("ignore:The PyTorch API of nested tensors:UserWarning")
# by torch.func.jvp itself
@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
@pytest.mark.parametrize("transform", ["vmap", "grad", "jvp"])
def test_a_nested_light_is_refused_by_its_name_under_transforms_too(transform):
    n, m = torch.tensor([0.0, 0.0, 1.0]).expand(1, 2, 2, 3), torch.ones(1, 108)
    light = torch.nested.nested_tensor([torch.ones(4, 8, 3)])
    calls = {
        "vmap": lambda picture: torch.func.vmap(picture)(m[None]),
        "grad": lambda picture: torch.func.grad(lambda m: picture(m).sum())(m),
        "jvp": lambda picture: torch.func.jvp(picture, (m,), (m,)),
    }
    with pytest.raises(ValueError, match="light: expected a dense tensor, found a nested one"):
        calls[transform](lambda m: render(n, m, light))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of torch.func's own parts
@pytest.mark.parametrize("method", ["exact", "quadrature"])
def test_tensors_of_inference_mode_are_taken_under_transforms(method):
    n, light = torch.tensor([0.0, 0.0, 1.0]).expand(1, 2, 2, 3), torch.ones(1, 4, 8, 3)
    with torch.inference_mode():
        m = torch.ones(3, 1, 108)
    by_m = torch.func.vmap(torch.func.grad(lambda m: render(n, m, light, method=method).sum()))(m)
    plain = m.clone().requires_grad_()
    sum(render(n, each, light, method=method).sum() for each in plain).backward()
    assert torch.allclose(by_m, plain.grad, rtol=1e-5)


@pytest.mark.parametrize("method", ["auto", "culled", "hybrid", "quadrature"])
def test_a_tolerance_beyond_float32_is_taken_without_a_warning(method):
    n = torch.tensor([0.0, 0.0, 1.0]).expand(1, 4, 4, 3)
    picture = render(n, torch.ones(1, 108), torch.ones(1, 6, 8, 3), method=method, tolerance=1e300)
    assert picture.isfinite().all()
