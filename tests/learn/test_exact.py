"""The exact sum: against a plain loop, against closed forms, its invariants, its gradients."""

import math
import subprocess
import sys

import numpy as np
import pytest
import torch

from learn.layer import render
from shaders.dsbrdf import evaluate, half_angles
from shaders.envmap import directions

CAMERAS = pytest.mark.parametrize("perspective", [False, True], ids=["orthographic", "perspective"])


def picture(scene, perspective=True, **options):
    view = scene["view"] if perspective else None
    return render(scene["n"], scene["material"], scene["light"], view, method="exact", **options)


def flat_material(kappa, gamma, dtype=torch.float64):
    """(1, 108): one lobe with constant κ and γ in every channel, the two others switched off by κ =
    0.
    """
    m = torch.zeros(3, 3, 2, 6, dtype=dtype)
    m[:, 0, 0] = kappa
    m[:, :, 1] = gamma
    return m.reshape(1, 108)


@CAMERAS
def test_equals_a_plain_loop_over_pixels_and_texels(draw, naive_sum, perspective):
    scene = draw(1, size=(2, 3), light=(8, 16), sharpest=2000.0)
    expected = naive_sum(
        *(scene[key][0] for key in ("n", "material", "light")),
        view=scene["view"][0] if perspective else None,
    )
    # float64 sums of 128 terms in another order, and log1p(−|h − n|²/2) in place of log(h·n): 1e-16
    # times γ = 2000
    np.testing.assert_allclose(picture(scene, perspective)[0].numpy(), expected, rtol=1e-11)


@CAMERAS
def test_chunks_do_not_show(draw, naive_sum, perspective):
    # 4608 texels: three chunks of texels, two of pixels
    scene = draw(2, size=(5, 5), light=(48, 96))
    expected = naive_sum(
        *(scene[key][0] for key in ("n", "material", "light")),
        view=scene["view"][0] if perspective else None,
    )
    np.testing.assert_allclose(picture(scene, perspective)[0].numpy(), expected, rtol=1e-11)


@pytest.mark.parametrize(
    ("name", "perspective"),
    [
        ("n", False),
        ("material", False),
        ("light", False),
        ("n", True),
        ("material", True),
        ("light", True),
        ("view", True),
    ],
)
def test_hand_derived_gradient_is_that_of_finite_differences(draw, perspective, name):
    scene = draw(3, size=(2, 2))
    scene[name].requires_grad_()
    # gradcheck's own tolerances, 1e-5 absolute and 1e-3 relative, suit its float64 steps of 1e-6
    assert torch.autograd.gradcheck(
        lambda x: picture(scene | {name: x}, perspective), (scene[name],)
    )


def test_gradients_hold_for_several_materials_and_chunks(draw):
    scene = draw(4, size=(1, 20), light=(33, 64))  # 2112 texels × 20 pixels: two chunks each way
    scene["material"] = torch.stack([scene["material"], draw(5)["material"]], dim=1)
    segments = torch.tensor([1, 2] * 10).reshape(1, 1, 20)
    for name in ("n", "material"):
        scene[name].requires_grad_()
    weight = torch.linspace(0.5, 1.5, 60, dtype=torch.float64).reshape(1, 1, 20, 3)

    def loss(n, material):
        return (weight * picture(scene | {"n": n, "material": material}, segments=segments)).sum()

    assert torch.autograd.gradcheck(loss, (scene["n"], scene["material"]), fast_mode=True)


def test_constant_light_on_a_constant_brdf_is_pi_times_albedo():
    albedo, radiance = 0.5, 2.0
    n = torch.nn.functional.normalize(
        torch.tensor([[0.0, 0, 1], [0.3, 0.4, 0.8], [-0.9, 0, 0.2]], dtype=torch.float64), dim=-1
    )
    light = torch.full((1, 64, 128, 3), radiance, dtype=torch.float64)
    # c^γ = 1: f = expm1(κ) = albedo/π, whatever the angles
    m = flat_material(math.log1p(albedo / math.pi), 1e-12)
    seen = render(n.reshape(1, 1, 3, 3), m, light, method="exact")
    # midpoint rule over texels of 2.8°: the clamped cosine is right to a few (π/64)²/24 = 1e-4
    torch.testing.assert_close(seen, torch.full_like(seen, albedo * radiance), rtol=3e-4, atol=0)


def test_one_lit_texel_gives_one_term_of_the_sum(draw):
    scene = draw(6, light=(8, 16))
    row, column = 2, 5  # above the horizon, towards the viewer
    light = torch.zeros_like(scene["light"])
    light[0, row, column] = torch.tensor([1.0, 2.0, 3.0])
    w, solid_angle = directions(8, 16)
    n, v = scene["n"].numpy().reshape(-1, 3), scene["view"].numpy().reshape(-1, 3)
    h, theta_d = half_angles(np.broadcast_to(w[row, column], v.shape), v)
    f = evaluate(scene["material"][0].numpy(), (h * n).sum(-1), theta_d)
    expected = (
        f
        * np.array([1.0, 2.0, 3.0])
        * (np.maximum(n @ w[row, column], 0) * solid_angle[row, column])[:, None]
    )
    seen = picture(scene | {"light": light}, elevation=0.0).reshape(-1, 3)
    np.testing.assert_allclose(seen.numpy(), expected, rtol=1e-11)


def test_turning_the_light_by_texels_equals_turning_normals_and_views_back(draw):
    scene = draw(7, light=(8, 16))
    texels = 3
    # column j of the rolled map is column j − 3: φ grows, from x (right) to z (the viewer)
    angle = 2 * math.pi * texels / 16
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]], dtype=torch.float64)
    turned = scene | {
        "n": scene["n"] @ turn.T,
        "view": scene["view"] @ turn.T,
        "light": scene["light"].roll(texels, dims=2),
    }
    torch.testing.assert_close(
        picture(turned, elevation=0.0), picture(scene, elevation=0.0), rtol=1e-10, atol=1e-13
    )


def test_radiance_is_linear_in_the_light(draw):
    a, b = draw(8), draw(9)
    mixed = picture(a | {"light": 2 * a["light"] + 5 * b["light"]})
    torch.testing.assert_close(
        mixed, 2 * picture(a) + 5 * picture(a | {"light": b["light"]}), rtol=1e-12, atol=0
    )


def test_a_batch_equals_a_loop_over_its_images(draw):
    scene = draw(10, images=3)
    apart = [picture({key: value[i : i + 1] for key, value in scene.items()}) for i in range(3)]
    torch.testing.assert_close(picture(scene), torch.cat(apart), rtol=1e-13, atol=0)


def test_the_order_of_pixels_does_not_matter(draw):
    scene = draw(11, size=(1, 40))
    order = torch.randperm(40, generator=torch.Generator().manual_seed(0))
    shuffled = scene | {"n": scene["n"][:, :, order], "view": scene["view"][:, :, order]}
    torch.testing.assert_close(picture(shuffled), picture(scene)[:, :, order], rtol=1e-13, atol=0)


@CAMERAS
def test_float32_is_right_to_1e_5(draw, perspective):
    scene = draw(12, light=(64, 128), sharpest=1000.0)
    fine = picture(scene, perspective)
    coarse = picture({key: value.float() for key, value in scene.items()}, perspective)
    # the limit set for every engine
    torch.testing.assert_close(coarse.double(), fine, rtol=1e-5, atol=0)


MEMORY = """
import resource, torch
from learn.layer import render
torch.manual_seed(0)
torch.set_num_threads(1)
def run(side):
    n = torch.nn.functional.normalize(torch.randn(1, side, side, 3).abs() + 0.1, dim=-1)
    n.requires_grad_()
    m, L = (torch.rand(1, 108) + 0.1).requires_grad_(), torch.rand(1, 64, 128, 3).requires_grad_()
    for view in (None, n.detach().clone()):
        render(n, m, L, view, method="exact").sum().backward()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
small = run(1)
print(run(24) - small)
"""


def test_memory_stays_bounded_when_pixels_grow():
    out = subprocess.run(
        [sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True
    ).stdout
    # 576 pixels × 8192 texels × 9 lobes would take 170 MB for one float32 temporary
    assert float(out) < 64, f"grew by {out} MiB"
