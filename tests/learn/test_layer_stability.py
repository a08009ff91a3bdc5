"""The layer where sums of lobes break: values and gradients stay finite, and right where a value is
known.
"""

import math

import pytest
import torch

from learn.engines import machine_code
from learn.layer import render
from shaders.envmap import directions

DTYPES = pytest.mark.parametrize(
    "dtype", [torch.float32, torch.float64], ids=["float32", "float64"]
)


@pytest.fixture(autouse=True, params=["fastest", "reference"])
def engine(request, monkeypatch):
    """Every test runs with whatever engine serves it here, and with the torch reference alone."""
    if request.param == "reference":
        monkeypatch.setattr(machine_code, "is_available", lambda: False)


def with_gradients(scene, **options):
    """Picture and gradients of a scene (a dict of render's tensors), each checked to be finite."""
    leaves = {
        key: value.detach().clone().requires_grad_()
        for key, value in scene.items()
        if value is not None
    }
    seen = render(**leaves, method="exact", **options)
    seen.sum().backward()
    assert seen.isfinite().all()
    for name, leaf in leaves.items():
        assert leaf.grad.isfinite().all(), name
    return seen.detach(), {name: leaf.grad for name, leaf in leaves.items()}


def material(kappa, gamma, dtype):
    """(1, 108): κ and γ the same in all channels, lobes and angles."""
    return (
        torch.tensor([kappa, gamma], dtype=dtype)[:, None]
        .expand(3, 3, 2, 6)
        .reshape(1, 108)
        .contiguous()
    )


def plain(dtype, n=((0.0, 0.0, 1.0),), kappa=0.3, gamma=2.0, size=(16, 32), level=1.0):
    n = (
        torch.nn.functional.normalize(torch.tensor(n, dtype=torch.float64), dim=-1)
        .to(dtype)
        .reshape(1, 1, -1, 3)
    )
    return {
        "n": n,
        "material": material(kappa, gamma, dtype),
        "light": torch.full((1, *size, 3), level, dtype=dtype),
    }


@DTYPES
@pytest.mark.parametrize("gamma", [1e-3, 0.5, 2.0])
def test_background_gives_black_and_no_gradient(dtype, gamma):
    scene = plain(dtype, gamma=gamma)
    scene["n"] = torch.cat([scene["n"], torch.zeros(1, 1, 5, 3, dtype=dtype)], dim=2)
    seen, gradients = with_gradients(scene)
    assert (seen[:, :, 1:] == 0).all() and (seen[:, :, 0] > 0).all()
    assert (gradients["n"][:, :, 1:] == 0).all()


@DTYPES
@pytest.mark.parametrize("cosine", [1e-2, 1e-3, 2e-4])
@pytest.mark.parametrize("gamma", [1e-3, 0.3, 1.0])
def test_grazing_view_stays_finite_for_slow_lobes(dtype, cosine, gamma):
    seen, _ = with_gradients(
        plain(dtype, n=((math.sqrt(1 - cosine**2), 0.0, cosine),), gamma=gamma)
    )
    assert (seen > 0).all()


@DTYPES
def test_normals_that_face_away_come_out_black(dtype):
    seen, gradients = with_gradients(
        plain(dtype, n=((1.0, 0.0, 0.0), (0.6, 0.0, -0.8), (0.0, 0.0, 1.0)))
    )
    assert (seen[0, 0, :2] == 0).all() and (gradients["n"][0, 0, :2] == 0).all()
    assert (seen[0, 0, 2] > 0).all()


@DTYPES
def test_texels_on_the_horizon_stay_finite(dtype):
    w, _ = directions(16, 32)
    across = torch.tensor(w.reshape(-1, 3), dtype=torch.float64)
    # n·w = 0 up to rounding
    n = torch.linalg.cross(
        across, torch.tensor([[0.3, -0.7, 0.2]], dtype=torch.float64).expand_as(across)
    )
    n = torch.nn.functional.normalize(n * torch.where(n[:, 2:] < 0, -1.0, 1.0), dim=-1)
    with_gradients(plain(dtype, n=n[n[:, 2] > 1e-3].tolist(), gamma=0.01), elevation=0.0)


@pytest.mark.parametrize("gamma", [1e3, 1e5])
@pytest.mark.parametrize("angle", [0.0, 1e-4, 1e-3, 5e-3])
def test_sharp_peaks_keep_their_digits_in_float32(gamma, angle):
    w = torch.tensor(directions(8, 16)[0][3, 4], dtype=torch.float64)
    h = torch.nn.functional.normalize(w + torch.tensor([0.0, 0.0, 1.0]), dim=0)
    across = torch.nn.functional.normalize(
        torch.linalg.cross(h, torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)), dim=0
    )
    scene = plain(
        torch.float64,
        n=((h * math.cos(angle) + across * math.sin(angle)).tolist(),),
        kappa=1.0,
        gamma=gamma,
        size=(8, 16),
    )
    scene["light"] = torch.zeros_like(scene["light"])
    scene["light"][0, 3, 4] = 1.0
    fine, _ = with_gradients(scene, elevation=0.0)
    coarse, _ = with_gradients({key: value.float() for key, value in scene.items()}, elevation=0.0)
    # float32 normals are 4e-8 rad off: γ · angle · 4e-8 = 2e-5 in the exponent; log(h·n) itself
    # would lose 1e5 · 6e-8 = 6e-3
    torch.testing.assert_close(coarse.double(), fine, rtol=1e-4, atol=1e-12)


@DTYPES
@pytest.mark.parametrize("kappa", [0.0, 1e-8, 1.0, 30.0])
def test_lobe_heights_from_nothing_to_e30(dtype, kappa):
    scene = plain(dtype, kappa=kappa, gamma=1e-9)
    seen, _ = with_gradients(scene)
    irradiance, _ = with_gradients(plain(torch.float64, kappa=math.log(2), gamma=1e-9))
    # f = 3 expm1(κ) in each channel against 3 · 1
    expected = irradiance.to(dtype) * math.expm1(kappa)
    # 30 · 6e-8, and c^1e-9
    torch.testing.assert_close(
        seen, expected, rtol=3e-5 if dtype == torch.float32 else 1e-7, atol=0
    )


@DTYPES
def test_lobes_beyond_the_exponents_bound_are_finite(dtype):
    with_gradients(plain(dtype, kappa=1000.0, gamma=3.0))


@DTYPES
def test_a_texel_opposite_to_the_view_is_harmless(dtype):
    w = torch.tensor(directions(8, 16)[0].reshape(-1, 3), dtype=torch.float64)
    n = torch.nn.functional.normalize(-w + 0.3 * w.roll(1, 1), dim=-1)
    scene = plain(dtype, size=(8, 16)) | {
        "n": n.to(dtype).reshape(1, 8, 16, 3),
        "view": -w.to(dtype).reshape(1, 8, 16, 3),
    }
    seen, _ = with_gradients(scene, elevation=0.0)
    assert (seen > 0).all()


@DTYPES
def test_a_texel_along_the_view_is_harmless(dtype):
    """w = v: the direction of w − v is undefined, and θ_d has its corner."""
    w = torch.tensor(directions(8, 16)[0].reshape(-1, 3), dtype=torch.float64)
    n = torch.nn.functional.normalize(w + 0.3 * w.roll(1, 1), dim=-1)
    with_gradients(
        plain(dtype, size=(8, 16))
        | {
            "n": n.to(dtype).reshape(1, 8, 16, 3),
            "view": w.to(dtype).reshape(1, 8, 16, 3),
        },
        elevation=0.0,
    )


@DTYPES
def test_an_empty_mask_gives_a_black_picture_and_zero_gradients(dtype):
    scene = plain(dtype) | {"n": torch.zeros(1, 2, 2, 3, dtype=dtype)}
    seen, gradients = with_gradients(scene)
    assert (seen == 0).all() and all((g == 0).all() for g in gradients.values())


@DTYPES
@pytest.mark.parametrize("level", [0.0, 1e6])
def test_no_light_and_much_light(dtype, level):
    with_gradients(plain(dtype, level=level))


@DTYPES
def test_a_one_texel_light(dtype):
    with_gradients(plain(dtype, size=(1, 1)))


def test_what_lies_outside_the_mask_is_never_read():
    scene = plain(torch.float64, n=((0.0, 0.0, 1.0), (1.0, 0.0, 1.0)))
    scene["n"][0, 0, 1] = math.nan
    mask = torch.tensor([[[True, False]]])
    seen, _ = with_gradients(scene, mask=mask)
    assert (seen[0, 0, 1] == 0).all() and (seen[0, 0, 0] > 0).all()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_inputs_are_summed_in_float32(dtype):
    scene = plain(torch.float32, n=((0.1, 0.2, 1.0), (0.5, -0.4, 0.6)))
    seen, _ = with_gradients({key: value.to(dtype) for key, value in scene.items()})
    assert seen.dtype == dtype
    rounded = render(
        **{key: value.to(dtype).float() for key, value in scene.items()}, method="exact"
    )
    torch.testing.assert_close(seen, rounded.to(dtype), rtol=0, atol=0)


def test_strided_inputs_give_the_same_picture(draw):
    scene = draw(20)
    strided = {
        key: value.transpose(0, -1).contiguous().transpose(0, -1) for key, value in scene.items()
    }
    assert not strided["light"].is_contiguous()
    torch.testing.assert_close(
        render(**strided, method="exact"), render(**scene, method="exact"), rtol=0, atol=0
    )


def test_the_layer_may_be_used_twice_in_one_graph(draw):
    scene = draw(21)
    m = scene["material"].requires_grad_()
    once = render(**scene, method="exact")
    (grad_once,) = torch.autograd.grad(once.sum(), m)
    twice = render(**scene, method="exact") + 2 * render(**scene, method="exact")
    (grad_twice,) = torch.autograd.grad(twice.sum(), m)
    torch.testing.assert_close(grad_twice, 3 * grad_once, rtol=1e-12, atol=0)
