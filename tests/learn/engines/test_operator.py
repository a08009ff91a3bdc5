"""The engine inside torch: through render, autograd, torch.compile, and the batch around it."""

import numpy as np
import pytest
import torch

from learn.engines import machine_code
from learn.layer import RenderLayer, render
from learn.methods import exact_operator
from tests.support.engine_scenes import ROTATION, TOLERANCE, make_scene, random_material

CAMERAS = pytest.mark.parametrize(
    "perspective", [False, True], ids=["orthographic", "view per pixel"]
)


def picture(rng, images=2, perspective=False, size=(16, 32), dtype=torch.float32):
    """render's arguments by name: 6×8 pictures whose left column is background."""
    n = torch.as_tensor(rng.normal(size=(images, 6, 8, 3)))
    n[..., 2] = n[..., 2].abs() + 0.3
    n = torch.nn.functional.normalize(n, dim=-1)
    n[:, :, 0] = 0
    result = {
        "n": n,
        "material": torch.stack(
            [torch.as_tensor(random_material(rng)).reshape(108) for _ in range(images)]
        ),
        "light": torch.as_tensor(rng.random((images, *size, 3))),
    }
    if perspective:
        v = torch.as_tensor(rng.normal(size=n.shape) * 0.1) + torch.tensor([0.0, 0.0, 1.0])
        result["view"] = torch.nn.functional.normalize(v, dim=-1)
    return {name: value.to(dtype) for name, value in result.items()}


def with_gradients(arguments, **options):
    leaves = {name: value.detach().clone().requires_grad_() for name, value in arguments.items()}
    seen = render(**leaves, method="exact", **options)
    weight = torch.linspace(-1, 1, seen.numel(), dtype=seen.dtype).reshape(seen.shape)
    (seen * weight).sum().backward()
    return seen.detach(), {name: leaf.grad for name, leaf in leaves.items()}


def relative(a, b):
    return ((a.double() - b.double()).abs().max() / b.double().abs().max()).item()


@CAMERAS
def test_float32_through_the_layer_matches_float64(rng, perspective):
    arguments = picture(rng, perspective=perspective)
    seen, by = with_gradients(arguments)
    right, right_by = with_gradients({name: value.double() for name, value in arguments.items()})
    assert relative(seen, right) <= TOLERANCE
    for name in by:
        assert relative(by[name], right_by[name]) <= TOLERANCE, name


def test_float64_and_float32_take_different_paths(rng, monkeypatch):
    calls = []
    monkeypatch.setattr(
        exact_operator,
        "radiance",
        lambda batch: calls.append(batch.n.dtype) or torch.zeros_like(batch.n),
    )
    for dtype in (torch.float32, torch.float64):
        render(**picture(rng, dtype=dtype), method="exact")
    assert calls == [torch.float32]


@CAMERAS
def test_without_numba_the_reference_gives_the_same(rng, perspective, monkeypatch):
    arguments = picture(rng, perspective=perspective)
    seen, by = with_gradients(arguments)
    monkeypatch.setattr(machine_code, "is_available", lambda: False)
    plain, plain_by = with_gradients(arguments)
    assert not torch.equal(seen, plain)  # another path indeed
    assert relative(seen, plain) <= 2 * TOLERANCE  # both are float32
    for name in by:
        assert relative(by[name], plain_by[name]) <= 2 * TOLERANCE, name


def test_a_kappa_beyond_the_largest_exponent_goes_to_the_reference(rng):
    arguments = picture(rng)
    arguments["material"][:, :6] = 60.0
    seen, _ = with_gradients(arguments)
    right, _ = with_gradients({name: value.double() for name, value in arguments.items()})
    # the reference in float32: e^50 turns κ's rounding into 50 times as much
    assert relative(seen, right) <= 1e-4


@CAMERAS
def test_opcheck(rng, perspective):
    scene = make_scene(rng, random_material(rng), pixels=20, size=(4, 8), perspective=perspective)
    tensors = [
        None if a is None else torch.as_tensor(a).requires_grad_() for a in scene.arguments()[:4]
    ]
    arguments = *tensors, ROTATION.flatten().tolist(), [len(scene.n)], [0]
    assert set(
        torch.library.opcheck(torch.ops.brdfactory.exact_sum.default, arguments).values()
    ) == {"SUCCESS"}


@CAMERAS
def test_opcheck_of_the_backward_operator(rng, perspective):
    scene = make_scene(rng, random_material(rng), pixels=20, size=(4, 8), perspective=perspective)
    tensors = [None if a is None else torch.as_tensor(a) for a in scene.arguments()[:4]]
    arguments = (
        torch.ones_like(tensors[0]),
        *tensors,
        ROTATION.flatten().tolist(),
        [len(scene.n)],
        [0],
        perspective,
    )
    assert set(
        torch.library.opcheck(torch.ops.brdfactory.exact_sum_backward.default, arguments).values()
    ) == {"SUCCESS"}


@CAMERAS
def test_a_batch_equals_its_images_one_by_one_to_the_last_bit(rng, perspective):
    arguments = picture(rng, images=3, perspective=perspective)
    seen, by = with_gradients(arguments)
    weight = torch.linspace(-1, 1, seen.numel()).reshape(seen.shape)
    for i in range(3):
        leaves = {
            name: value[i : i + 1].clone().requires_grad_() for name, value in arguments.items()
        }
        one = render(**leaves, method="exact")
        (one * weight[i : i + 1]).sum().backward()
        assert torch.equal(one[0], seen[i])
        for name, leaf in leaves.items():
            assert torch.equal(leaf.grad[0], by[name][i]), name


@CAMERAS
def test_results_do_not_depend_on_threads_or_runs(rng, perspective):
    arguments = picture(rng, perspective=perspective)
    before = torch.get_num_threads()
    try:
        result = []
        for threads in (1, 2, 3, 1):
            torch.set_num_threads(threads)
            result.append(with_gradients(arguments))
    finally:
        torch.set_num_threads(before)
    for seen, by in result[1:]:
        assert torch.equal(seen, result[0][0])
        for name in by:
            assert torch.equal(by[name], result[0][1][name]), name


def test_segments_equal_separate_renderings(rng):
    arguments = picture(rng, images=1)
    materials = torch.stack([torch.as_tensor(random_material(rng)).reshape(108) for _ in range(2)])[
        None
    ]
    ids = torch.ones(1, 6, 8, dtype=torch.long)
    ids[:, 3:] = 2
    both = render(arguments["n"], materials, arguments["light"], segments=ids, method="exact")
    for s in (1, 2):
        alone = render(arguments["n"], materials[:, s - 1], arguments["light"], method="exact")
        assert torch.equal(both[ids == s], alone[ids == s])


def test_two_uses_in_one_graph_add_their_gradients(rng):
    arguments = picture(rng, images=1)
    m = arguments["material"].clone().requires_grad_()
    first = render(arguments["n"], m, arguments["light"], method="exact")
    second = render(
        arguments["n"].flip(1), 0.5 * m, first.mean() * arguments["light"], method="exact"
    )
    second.sum().backward()
    m64 = arguments["material"].double().requires_grad_()
    n64, light64 = arguments["n"].double(), arguments["light"].double()
    first = render(n64, m64, light64, method="exact")
    render(n64.flip(1), 0.5 * m64, first.mean() * light64, method="exact").sum().backward()
    assert relative(m.grad, m64.grad) <= TOLERANCE


def test_non_contiguous_inputs(rng):
    arguments = picture(rng, images=1, perspective=True)
    strided = {
        name: value.transpose(-1, -2).contiguous().transpose(-1, -2)
        for name, value in arguments.items()
    }
    assert not strided["n"].is_contiguous()
    seen, by = with_gradients(arguments)
    other, other_by = with_gradients(strided)
    assert torch.equal(seen, other)
    for name in by:
        assert torch.equal(by[name], other_by[name]), name


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_inputs_are_summed_in_float32(rng, dtype):
    arguments = picture(rng, dtype=dtype)
    seen, by = with_gradients(arguments)
    assert seen.dtype == dtype and all(value.dtype == dtype for value in by.values())
    right, _ = with_gradients({name: value.float() for name, value in arguments.items()})
    assert torch.equal(seen, right.to(dtype))


# torch's own, while it traces
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")
def test_a_compiled_model_with_the_layer_inside(rng):
    class Model(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.gain = torch.nn.Parameter(torch.tensor(1.5))
            self.layer = RenderLayer(method="exact")

        def forward(self, n, material, light):
            return torch.tanh(self.layer(n, self.gain * material, light)).mean()

    arguments = picture(rng, images=1)
    model = Model()
    model(**arguments).backward()
    expected, model.gain.grad = model.gain.grad.clone(), None
    torch.compile(model, backend="aot_eager")(**arguments).backward()
    torch.testing.assert_close(model.gain.grad, expected, rtol=1e-6, atol=0)


def test_an_empty_mask(rng):
    arguments = picture(rng)
    arguments["n"] = torch.zeros_like(arguments["n"])
    seen, by = with_gradients(arguments)
    assert not seen.any() and not by["material"].any() and not by["light"].any()


@CAMERAS
def test_one_pixel_is_the_same_alone_as_among_others(rng, perspective):
    arguments = picture(rng, images=1, perspective=perspective)
    whole = render(**arguments, method="exact")
    mask = torch.zeros(1, 6, 8, dtype=torch.bool)
    mask[0, 2, 5] = True
    alone = render(**arguments, mask=mask, method="exact")
    assert torch.equal(alone[0, 2, 5], whole[0, 2, 5]) and alone.count_nonzero() <= 3


@pytest.mark.parametrize("elevation", [0.0, 0.6])
def test_elevation_turns_the_light(rng, elevation):
    arguments = picture(rng, images=1)
    seen, _ = with_gradients(arguments, elevation=elevation)
    right, _ = with_gradients(
        {name: value.double() for name, value in arguments.items()}, elevation=elevation
    )
    assert relative(seen, right) <= TOLERANCE
    assert np.abs(seen.numpy() - with_gradients(arguments, elevation=0.3)[0].numpy()).max() > 1e-3
