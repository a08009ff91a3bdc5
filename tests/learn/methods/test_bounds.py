"""What the planned methods guarantee: culling stays within what it may leave out, a cut keeps the
energy, maps are shared rightly.
"""

import numpy as np
import pytest
import torch

from learn import methods
from learn.layer import render
from learn.methods import directional, light_tables, median_cut, reflectance_map
from shaders.frames import camera_from_light
from tests.support.card_scenes import LIGHTS, MATERIALS, UNIT, light, material, sphere

ROTATION = torch.as_tensor(camera_from_light())
HIGH = ((9.0, 0.3, 5.0), (40.0, 3000.0, 2000.0))


@pytest.mark.parametrize("part", [1e-3, 1e-1, 1.0, 10.0])
@pytest.mark.parametrize("lobes", [*MATERIALS.values(), HIGH], ids=[*MATERIALS, "high"])
def test_culling_leaves_out_no_more_than_it_may(part, lobes):
    n = sphere(40)[(sphere(40) != 0).any(-1)]
    m = material(*lobes).reshape(3, 3, 2, 6)
    for name in LIGHTS:
        lights, E = light_tables.lights_and_energy(light(name)[0], ROTATION)
        whole = directional.radiance(n, None, m, E, lights)
        allowed = part * whole.mean().item()
        short = whole - directional.radiance(n, None, m, E, lights, allowed)
        rounding = 1e-5 * whole.max().item()
        assert short.min() >= -rounding and short.max() <= allowed + rounding


def test_a_cut_light_keeps_the_energy_and_its_number():
    for name in LIGHTS:
        L = light(name)[0].double()
        whole = light_tables.lights_and_energy(L, ROTATION)[1].sum(0)
        for count in (64, 256, 1024):
            lights, E = median_cut.cut_light(L, ROTATION, count)
            assert len(lights.w) == len(E) <= count
            torch.testing.assert_close(E.sum(0), whole, rtol=1e-12, atol=0)
            np.testing.assert_allclose(np.linalg.norm(lights.w, axis=1), 1, atol=1e-12)


def test_regions_of_a_cut_cover_each_texel_once():
    energy = np.random.default_rng(3).random((12, 24)) ** 6
    region = median_cut.regions(energy, 64)
    assert region.min() == 0 and len(np.unique(region)) == region.max() + 1 == 64
    for k in range(64):  # each is a rectangle
        rows, columns = np.nonzero(region == k)
        assert len(rows) == (np.ptp(rows) + 1) * (np.ptp(columns) + 1)


def test_a_map_reproduces_quadratics_of_the_place():
    n = UNIT(
        torch.randn(300, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(5)), dim=-1
    )
    n[:, 2] = n[:, 2].abs()

    def function(n):
        p = n[:, :2] / (1 + n[:, 2:]).sqrt()
        return torch.stack([1 + p[:, 0], p[:, 0] * p[:, 1], p[:, 1] ** 2], -1)

    for dtype, tolerance in ((torch.float64, 1e-12), (torch.float32, 3e-6)):
        result = reflectance_map.radiance_by_nodes(n.to(dtype), 20, function)
        torch.testing.assert_close(result, function(n).to(dtype), rtol=0, atol=tolerance)


def scattered(count, size, seed, dtype):
    """Unit normals (count, 3) that face the viewer, and random values at the nodes of a map that
    they need.
    """
    random = torch.Generator().manual_seed(seed)
    n = UNIT(torch.randn(count, 3, dtype=dtype, generator=random), dim=-1)
    n[:, 2] = n[:, 2].abs()
    nodes = reflectance_map.needed_nodes(n, size)
    return n, torch.rand(len(nodes), 3, dtype=dtype, generator=random), nodes


def test_a_maps_kernel_and_torch_agree_in_nodes_values_and_derivatives():
    n, values, nodes = scattered(200, 20, 6, torch.float32)
    assert torch.equal(nodes, reflectance_map.needed_nodes(n.double(), 20))
    result = []
    for dtype in (torch.float32, torch.float64):
        leaves = [x.to(dtype).requires_grad_() for x in (n, values)]
        out = reflectance_map.look_up(*leaves, nodes, 20)
        result.append([out, *torch.autograd.grad((out**2).sum(), leaves)])
    for single, double in zip(*result, strict=True):
        # float32 sums of up to some hundred pixels
        torch.testing.assert_close(single.double(), double, rtol=1e-4, atol=1e-5)


def test_the_float64_look_up_is_differentiable():
    n, values, nodes = scattered(6, 12, 8, torch.float64)
    leaves = n.requires_grad_(), values.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda n, values: reflectance_map.look_up(n, values, nodes, 12), leaves
    )


@pytest.mark.parametrize("with_gradient", [False, True])
def test_pictures_of_one_material_and_light_share_their_sum(monkeypatch, with_gradient):
    n = torch.cat([sphere(10), sphere(10).flip(2), sphere(10).flip(1)])
    m, L = material(*MATERIALS["satin"]), light("lamps")
    m.requires_grad_(with_gradient)
    monkeypatch.setattr(directional, "WHOLE", 0)  # maps although the pictures are small
    calls = []
    original = reflectance_map.radiance_by_nodes
    monkeypatch.setattr(
        reflectance_map, "radiance_by_nodes", lambda *a: calls.append(1) or original(*a)
    )
    together = render(n, m.expand(3, -1), L.expand(3, -1, -1, -1), method="reflectance_map")
    assert len(calls) == 1
    alone = torch.cat([render(n[i : i + 1], m, L, method="reflectance_map") for i in range(3)])
    # culling tells the mean from other pixels
    torch.testing.assert_close(together, alone, rtol=2e-3, atol=1e-4)
    if with_gradient:
        (shared,) = torch.autograd.grad(together.sum(), m, retain_graph=True)
        (apart,) = torch.autograd.grad(alone.sum(), m)
        torch.testing.assert_close(shared, apart, rtol=2e-3, atol=1e-3 * apart.abs().max().item())


def test_equal_materials_with_gradients_of_their_own_are_kept_apart():
    n = sphere(10).repeat(2, 1, 1, 1)
    m = material(*MATERIALS["satin"]).repeat(2, 1).requires_grad_()
    seen = render(n, m, light("sky").repeat(2, 1, 1, 1), method="reflectance_map")
    (slope,) = torch.autograd.grad(seen[0].sum(), m)
    assert slope[0].abs().sum() > 0 and slope[1].abs().sum() == 0


@pytest.mark.parametrize("tolerance", [5e-2, 1e-2, 1e-3, 1e-4])
def test_auto_keeps_its_tolerance_from_far_and_near(tolerance):
    n = sphere(40)
    for lobes in [*MATERIALS.values(), HIGH]:
        for name in LIGHTS:
            given = {"n": n, "material": material(*lobes), "light": light(name)}
            truth = render(**given, method="exact")
            assert (
                render(**given, tolerance=tolerance) - truth
            ).abs().mean() <= tolerance * truth.mean()


def test_auto_is_the_same_every_time():
    given = {"n": sphere(40), "material": material(*MATERIALS["glossy"]), "light": light("lamps")}
    assert torch.equal(render(**given), render(**given))


def test_an_unknown_method_is_refused_with_the_nearest_name():
    with pytest.raises(ValueError, match=r"did you mean median_cut"):
        methods.load("mediancut")
