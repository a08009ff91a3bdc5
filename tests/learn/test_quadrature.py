"""The converged integral: against the exact sum over texels split until it no longer changes,
values and gradients.
"""

import math

import numpy as np
import pytest
import torch

from learn.engines import machine_code
from learn.layer import render
from learn.methods import half_vectors, quadrature, sampled_sum
from manifests.materials import load_catalogue
from shaders.envmap import texel

# rows and columns of a texel's parts in the reference: .12° at 64 rows; a lobe of γ = 1e5 is .36°
# wide in w
SPLIT = 24
NORMALS = [[0.0, 0.0, 1.0], [0.3, 0.4, 0.85], [-0.6, 0.1, 0.8], [0.2, -0.7, 0.5], [0.85, 0.3, 0.3]]


def scene(gamma, seed=0, kappa=1.0, dtype=torch.float32, rows=64, matte=0.0):
    """One lobe of exponent γ, over a matte one if wanted; five normals, a light of independent
    texels.
    """
    m = torch.full((3, 3, 2, 6), 1e-9, dtype=dtype)
    m[:, 0, 0], m[:, 1, 0], m[:, 1, 1] = matte, kappa, gamma
    n = torch.nn.functional.normalize(torch.tensor(NORMALS, dtype=torch.float64), dim=-1).to(dtype)
    L = (
        torch.rand(
            1, rows, 2 * rows, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)
        ).to(dtype)
        ** 4
    )
    return {"n": n.reshape(1, 1, -1, 3), "material": m.reshape(1, 108), "light": L}


def split(light, parts):
    return light.repeat_interleave(parts, 1).repeat_interleave(parts, 2)


def relative(a, b):
    return ((a - b).abs().mean() / b.abs().mean()).item()


@pytest.mark.parametrize("gamma", [1.0, 290.0, 310.0, 1190.0, 1210.0, 4700.0])
def test_integral_of_lobes_up_to_the_taps_is_that_of_split_texels(gamma):
    # half the rows: each limit comes at a quarter of its exponent
    one = scene(gamma / 4, rows=32, matte=0.01)
    fine = render(**(one | {"light": split(one["light"], 12)}), method="exact")
    assert relative(render(**one, method="quadrature"), fine) < 3e-3  # what BROAD claims


@pytest.mark.parametrize(
    "name",
    [
        "white-diffuse-bball",
        "green-metallic-paint",
        "black-oxidized-steel",
        "neoprene-rubber",
        "chrome",
    ],
)
def test_measured_materials_keep_the_tolerance_under_a_lamp_of_one_texel(name):
    """Their lobes are narrow at some θ_d and broad at others."""
    x, y = (np.indices((12, 12)) + 0.5) / 6 - 1
    inside = x**2 + y**2 < 0.98
    n = np.where(
        inside[..., None], np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1), 0
    )
    light = torch.rand(1, 64, 128, 3, generator=torch.Generator().manual_seed(0))
    light[0, 20, 30] = 3000.0  # half of all the light
    one = {"n": torch.tensor(n[None], dtype=torch.float32), "light": light}
    one["material"] = torch.tensor(load_catalogue()[name].m, dtype=torch.float32).reshape(1, 108)
    fine = render(**one, method="quadrature", tolerance=2e-4)
    for tolerance in (5e-3, 1e-2, 2e-2, 5e-2):
        assert relative(render(**one, method="quadrature", tolerance=tolerance), fine) < tolerance


@pytest.mark.parametrize("gamma", [5e3, 3e4, 1e5])
def test_integral_of_lobes_narrower_than_a_texel(gamma):
    one = scene(gamma)
    fine = render(**(one | {"light": split(one["light"], SPLIT)}), method="exact")
    assert relative(render(**one, method="quadrature", tolerance=1e-2), fine) < 1e-2
    for tolerance in (2e-2, 5e-2):  # at which there are fewer samples
        assert relative(render(**one, method="quadrature", tolerance=tolerance), fine) < tolerance
    # the reference's own step is a third of a lobe
    assert relative(render(**one, method="quadrature", tolerance=1e-3), fine) < 4e-3
    # the paper's sum, on the same scene
    assert relative(render(**one, method="exact"), fine) > 0.05


def test_a_sun_in_one_texel_seen_in_a_mirror_like_lobe():
    """Closed form: a lobe far narrower than the sun's texel, aimed at its middle, sees the sun's
    radiance times the lobe's albedo.
    """
    n = torch.tensor([0.3, 0.4, 0.85], dtype=torch.float64)
    n = n / n.norm()
    mirror = 2 * n[2] * n - torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    row, column = texel(mirror.numpy(), 64, 128)
    theta, phi = (row + 0.5) * math.pi / 64, (column + 0.5) * 2 * math.pi / 128
    w = torch.tensor(
        [math.cos(phi) * math.sin(theta), math.cos(theta), math.sin(phi) * math.sin(theta)],
        dtype=torch.float64,
    )
    n = torch.nn.functional.normalize(w + torch.tensor([0.0, 0.0, 1.0]), dim=0).reshape(1, 1, 1, 3)
    one = scene(3e5, dtype=torch.float64) | {"n": n}
    sun, sky = torch.zeros_like(one["light"]), torch.ones_like(one["light"])
    sun[0, row, column] = 1e5
    lobe = render(**(one | {"light": sky}), method="quadrature", elevation=0.0)
    seen = render(**(one | {"light": sun}), method="quadrature", elevation=0.0)
    # half a texel is 0.7° in half angle: e^(−γ (0.7°)²/2) = 2e-10
    torch.testing.assert_close(seen, 1e5 * lobe, rtol=1e-4, atol=0)


@pytest.mark.parametrize("name", ["material", "light", "n"])
@pytest.mark.parametrize("gamma", [250.0, 2e3])
def test_gradients_are_those_of_the_integral(name, gamma):
    one = scene(gamma, rows=16)
    weight = torch.linspace(0.5, 1.5, 15).reshape(1, 1, 5, 3)
    result = {}
    for method, parts in (("quadrature", 1), ("exact", 20)):
        leaf = one[name].clone().requires_grad_()
        full = one | {name: leaf}
        full["light"] = split(full["light"], parts)
        picture = render(**full, method=method, tolerance=1e-4)
        (result[method],) = torch.autograd.grad((weight * picture).sum(), leaf)
    scale = result["exact"].abs().mean()
    # taps see each texel's edge at random: N^−¾ of the contrast, and a derivative in n weighs the
    # lobe's flanks
    assert (result["quadrature"] - result["exact"]).abs().mean() < (
        0.05 if name != "n" else 0.1
    ) * scale


@pytest.mark.skipif(
    not machine_code.is_available(),
    reason="numba is not installed: there is one form of the taps only",
)
@pytest.mark.parametrize("perspective", [False, True])
def test_the_engine_takes_the_same_taps_as_torch(draw, perspective):
    one = draw(40, size=(6, 9), light=(32, 64), sharpest=3e4, dtype=torch.float32)
    one["material"] = scene(3e4)["material"]  # narrow lobes alone, which nothing but taps renders
    if not perspective:
        one["view"] = None
    fast = render(**one, method="quadrature")
    slow = render(
        **(one | {"material": one["material"].requires_grad_()}), method="quadrature"
    ).detach()
    # float32 sums of 2048 taps; a tap within 1e-6 of a texel's border may fall on either side
    assert relative(fast, slow) < 2e-5


# the poles of the frame about n and of the map, and normals that lean to the horizon
HARD_NORMALS = [
    [0, 0, 1],
    [1e-4, 0, 1],
    [0, 0.7, 0.7],
    [0, -0.7, 0.7],
    [0.995, 0, 0.1],
    [0, 1, 0.02],
]


def derivatives(given, names):
    """The picture and its derivatives by the named inputs; those by the material as (lobe, channel,
    (κ, γ), 6).
    """
    leaves = given | {name: given[name].clone().requires_grad_() for name in names}
    picture = render(**leaves, method="quadrature")
    weight = torch.linspace(-1, 1.5, picture.numel(), dtype=picture.dtype).reshape(picture.shape)
    found = torch.autograd.grad((weight * picture).sum(), [leaves[name] for name in names])
    return {"picture": picture.detach(), **dict(zip(names, found, strict=True))}


@pytest.mark.skipif(not machine_code.is_available(), reason="numba is not installed")
@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("gamma", [5e3, 3e4, 1e5])
def test_kernels_have_the_derivatives_of_torch_in_float64(gamma, perspective):
    given = scene(gamma, rows=32)
    n = torch.tensor([*NORMALS, *HARD_NORMALS])
    given["n"] = torch.nn.functional.normalize(n, dim=-1).reshape(1, 1, -1, 3)
    names = ["n", "material", "light"]
    if perspective:
        tilt = torch.randn(given["n"].shape, generator=torch.Generator().manual_seed(1))
        view = given["n"] + 0.3 * tilt + torch.tensor([0.0, 0.0, 0.3])
        given["view"] = torch.nn.functional.normalize(view, dim=-1)
        given["n"][0, 0, 0] = torch.tensor([0.0, 0.6, -0.8])  # behind the image plane
        given["view"][0, 0, 0] = torch.tensor([0.0, 0.8, -0.6])
        names.append("view")
    assert sampled_sum.has_kernels(given["n"], given["material"])
    fast = derivatives(given, names)
    slow = derivatives({name: x.double() for name, x in given.items()}, names)
    for found in (fast, slow):  # the narrow lobe's κ and γ by themselves
        by_m = found.pop("material").reshape(3, 3, 2, 6)[:, 1]
        found |= {"κ": by_m[:, 0], "γ": by_m[:, 1]}
    for name, expected in slow.items():
        error = (fast[name] - expected).abs().max() / expected.abs().max()
        # float32 samples; one that lies on a texel's border may see it at a slightly other place
        assert expected.abs().max() > 0 and error < 2e-5, name


@pytest.mark.skipif(not machine_code.is_available(), reason="numba is not installed")
def test_derivatives_by_kernels_have_the_same_bits_for_any_number_of_threads():
    given = scene(2e4, rows=16)
    n = torch.randn(1, 40, 10, 3, generator=torch.Generator().manual_seed(0)) * 0.3
    given["n"] = torch.nn.functional.normalize(n + torch.tensor([0.0, 0.0, 1.0]), dim=-1)
    before, results = torch.get_num_threads(), []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            results.append(derivatives(given, ["n", "material", "light"]))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(results[0][name], results[1][name]) for name in results[0])


def test_an_empty_mask_has_derivatives_of_zero():
    given = scene(2e4, rows=8) | {"mask": torch.zeros(1, 1, 5, dtype=torch.bool)}
    for value in derivatives(given, ["n", "material", "light"]).values():
        assert (value == 0).all()


@pytest.mark.skipif(not machine_code.is_available(), reason="numba is not installed")
@pytest.mark.parametrize("perspective", [False, True])
def test_split_texels_without_faint_ones_keep_the_tolerance(perspective):
    """Derivatives too: enough pixels that texels are left out."""
    given = scene(200.0, rows=32, matte=0.01)  # 32 rows need twice as many for it
    n = torch.randn(1, 20, 10, 3, generator=torch.Generator().manual_seed(0)) * 0.3
    given["n"] = torch.nn.functional.normalize(n + torch.tensor([0.0, 0.0, 1.0]), dim=-1)
    if perspective:
        given["view"] = torch.tensor([0.1, 0.0, 1.0]).div(1.01**0.5).expand_as(given["n"])
    names = ["n", "material", "light"]
    fast = derivatives(given, names)
    leaves = given | {name: given[name].clone().requires_grad_() for name in names}
    full = render(**(leaves | {"light": split(leaves["light"], 2)}), method="exact")
    weight = torch.linspace(-1, 1.5, full.numel()).reshape(full.shape)
    exact = torch.autograd.grad((weight * full).sum(), [leaves[name] for name in names])
    assert relative(fast["picture"], full.detach()) < 5e-3
    for name, expected in zip(names, exact, strict=True):
        assert relative(fast[name], expected) < 1e-2, name


@pytest.mark.parametrize("gamma", [5e3, 3e6])
def test_few_rings_have_the_energy_of_a_lobe(gamma):
    """The ring at its foot, too, of which nearly all lies outside."""
    m = scene(gamma)["material"].reshape(3, 3, 2, 6)
    edges = np.geomspace(1e-7, np.pi / 2, 100_000)
    theta, areas = (edges[1:] + edges[:-1]) / 2, -2 * np.pi * np.diff(np.cos(edges))
    right = np.expm1(np.cos(theta) ** gamma) @ areas
    for samples in range(60, 140, 7):
        middle, solid_angle = half_vectors.sample_radii(m, samples)
        energy = (np.expm1(np.cos(middle) ** gamma) * solid_angle).sum()
        assert energy == pytest.approx(right, rel=2e-3), samples  # sixty midpoints leave 9e-4


def test_taps_cover_the_hemisphere_and_follow_the_lobes():
    m = scene(1e4, matte=0.01)["material"].reshape(3, 3, 2, 6)
    theta, solid_angle = half_vectors.sample_radii(m, 512)
    assert (np.diff(theta) > 0).all() and theta[-1] > 1.2
    np.testing.assert_allclose(solid_angle.sum(), 2 * np.pi, rtol=1e-12)
    # one of three lobes, taps as its root: e^(−1e4 θ²/4) is nothing beyond .06
    assert 0.3 < (theta < 0.06).mean() < 0.35


def test_lobes_without_reflection_cost_nothing_and_change_nothing():
    m = scene(1e4)["material"].reshape(1, 3, 3, 2, 6)
    kept = quadrature.keep_lobes(m, torch.zeros(1, 3, 3, dtype=torch.bool))
    assert (kept[..., 0, :] == 0).all()
    one = scene(1e4)
    torch.testing.assert_close(
        render(**(one | {"material": kept.reshape(1, 108)}), method="quadrature"),
        torch.zeros_like(one["n"]),
    )


@pytest.mark.parametrize("kappa", [1e12, 1e30, 1e38, 3e38])
def test_heights_at_the_end_of_float32_give_finite_pictures(kappa):
    one = scene(54.0, rows=8, matte=0.01)
    # between small control values: the spline's steps are as large
    one["material"].reshape(3, 3, 2, 6)[0, 0, 0, 4] = kappa
    assert render(**one, method="quadrature").isfinite().all()
