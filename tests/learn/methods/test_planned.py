"""Coarse lights are exact for what is smooth; planned radiance has the derivatives of the sum;
pixels are picked as torch would.
"""

import math
import warnings

import numpy as np
import pytest
import torch

from learn.engines import layout, pixel_selection
from learn.experiments.layer import chart_cases
from learn.layer import render
from learn.methods import (
    coarse,
    cost_model,
    directional,
    exact,
    lobe_shapes,
    planned,
    reflectance_map,
)
from shaders.envmap import directions
from shaders.frames import camera_from_light
from tests.support.card_scenes import MATERIALS, light, material, sphere

ROTATION = tuple(camera_from_light().flatten().tolist())
RANDOM = np.random.default_rng(2)


@pytest.mark.parametrize("level", [1, 2])
def test_a_coarse_lights_gradient_is_the_adjoint_of_its_energy(level):
    E, g = (RANDOM.normal(size=(3, 32 >> k, 64 >> k)).astype(np.float32) for k in (0, level))
    forward, back = (
        (coarse.energy(E, level) * g).sum(dtype=np.float64),
        (E * coarse.gradient(g, level)).sum(dtype=np.float64),
    )
    np.testing.assert_allclose(forward, back, rtol=1e-5)  # float32 sums


@pytest.mark.parametrize(
    "texel", [(0, 5), (31, 63), (12, 0), (16, 40)], ids=["zenith", "nadir", "seam", "middle"]
)
def test_a_coarse_light_keeps_energy_and_direction(texel):
    E = np.zeros((1, 32, 64), np.float32)
    E[0][texel] = 1.0
    result = coarse.energy(E, 1)[0]
    np.testing.assert_allclose(result.sum(), 1.0, rtol=1e-6)
    mean = (result[..., None] * directions(16, 32)[0]).sum((0, 1))
    # Catmull–Rom follows sines of two texels' spacing, 0.2 rad, to its third power and better
    assert np.linalg.norm(mean - directions(32, 64)[0][texel]) < 5e-3


def test_a_coarse_light_is_turned_with_the_fine_one():
    E = RANDOM.random((1, 32, 64)).astype(np.float32)
    np.testing.assert_array_equal(
        coarse.energy(np.roll(E, 20, 2), 2), np.roll(coarse.energy(E, 2), 5, 2)
    )


def test_detail_tells_a_lit_texel_from_a_smooth_sky():
    parts = {
        name: coarse.Light(L.astype(np.float32), ROTATION).detail()
        for name, L in chart_cases.computed_lights().items()
    }
    for result in parts.values():
        assert sum(result) == pytest.approx(1.0) and min(result) >= 0
    assert parts["sky"][0] < 0.01 < 0.5 < parts["sun in a texel"][0] < parts["one texel"][0] == 1.0


def one_lobe(sharpness):
    m = np.ones((3, 3, 2, 6))
    m[:, :, 0] = 0.0
    m[:, 0, 0], m[:, 0, 1] = 0.3, sharpness * -math.expm1(-0.3) / 0.3
    assert lobe_shapes.sharpness(m)[0] == pytest.approx(sharpness)
    return m


@pytest.mark.parametrize(
    "sharpness, level, limit", [(8.0, 1, 1e-3), (8.0, 2, 3e-3), (50.0, 1, 5e-3)]
)
def test_a_broad_lobe_hardly_sees_that_its_light_is_coarse(sharpness, level, limit):
    n = sphere(24)[(sphere(24) != 0).any(-1)].numpy()
    for L in chart_cases.computed_lights().values():
        scene = planned.Scene(n, one_lobe(sharpness), L.astype(np.float32), ROTATION)
        fine, seen = scene.list_lobes(n, (0,)).radiance, scene.list_lobes(n, (0,), level).radiance
        error = np.abs(seen - fine).mean() / fine.mean()
        assert error < limit
        assert error < 2 * cost_model.light_error(
            64 >> level, sharpness
        )  # what auto plans by, with room for other lobes than those it was fitted to


def leaves(name, lobes, dtype):
    return [x.to(dtype).requires_grad_() for x in (sphere(40), material(*lobes), light(name))]


@pytest.mark.parametrize("kind", MATERIALS)
def test_planned_radiance_has_the_derivatives_of_the_sum(kind):
    result = []
    for method, dtype in (("auto", torch.float32), ("exact", torch.float64)):
        given = leaves("lamps", MATERIALS[kind], dtype)
        seen = render(*given, method=method, tolerance=1e-2)
        weight = torch.linspace(0.5, 1.5, seen.numel(), dtype=dtype).reshape(seen.shape)
        result.append(torch.autograd.grad((seen * weight).sum(), given))
    for ours, truth in zip(*result, strict=True):
        # The picture may be off by 1e-2; a derivative by n is one of interpolation's weights, of
        # one order less
        assert (ours.double() - truth).abs().mean() <= 0.1 * truth.abs().mean()


def test_a_listed_sum_of_some_lobes_has_the_exact_derivatives():
    n = sphere(24)[(sphere(24) != 0).any(-1)]
    m = material(*MATERIALS["satin"]).double().reshape(3, 3, 2, 6)
    scene, lobes, E = (
        planned.Scene(n.numpy(), m.numpy(), light("sky")[0].numpy(), ROTATION),
        (0, 2),
        light("sky")[0].double(),
    )
    listing = scene.list_lobes(n.numpy(), lobes)
    w, energy = exact.texels(E, torch.tensor(ROTATION, dtype=torch.float64).reshape(3, 3))
    given = [n.double().requires_grad_(), m.requires_grad_(), energy.requires_grad_()]
    truth = exact.ExactSum.apply(
        given[0], None, lobe_shapes.keep_lobes(given[1], np.isin(range(3), lobes)), given[2], w
    )
    np.testing.assert_allclose(listing.radiance, truth.detach(), rtol=1e-4)
    g = torch.linspace(0.5, 1.5, truth.numel()).reshape(truth.shape)
    _, by_m, by_E = listing.backward(g.numpy())
    _, true_by_m, true_by_energy = torch.autograd.grad((truth * g.double()).sum(), given)
    for kind in (0, 1):  # κ and γ apart: the one is far larger
        np.testing.assert_allclose(
            by_m[:, :, kind],
            true_by_m[:, :, kind],
            rtol=1e-4,
            atol=1e-5 * true_by_m[:, :, kind].abs().max(),
        )
    order = scene.light.places(0)[1]
    np.testing.assert_allclose(
        by_E.T, true_by_energy[order], rtol=1e-4, atol=1e-5 * true_by_energy.max()
    )


def test_a_tables_cones_bound_every_light_of_a_block():
    """Also where a coarse light is negative: one lit texel makes its neighbours so."""
    L = np.zeros((32, 64, 3), np.float32)
    L[9, 21] = 1.0, 2.0, 0.5
    m = material(*MATERIALS["glossy"]).double().reshape(3, 3, 2, 6).numpy()
    scene = planned.Scene(np.float32([[0, 0, 1]]), m, L, ROTATION, light_gradient=False)
    scene.list_lobes(scene.n, (1, 2), level=1)
    tables = scene.tables[(1, 2), 1]
    assert tables.energy.min() < 0
    rows = tables.cones.transpose(1, 0, 2).reshape(len(tables.cones[0]), -1)[
        :, : tables.lights.blocks
    ]
    np.testing.assert_allclose(rows[10], np.abs(tables.energy).sum(-1).max(-1), rtol=1e-6)
    gamma, kappa = tables.lobes.transpose(3, 1, 0, 2, 4)  # of (blocks, lobes, channels, lanes)
    np.testing.assert_array_equal(rows[11:13], gamma.min((-1, -2)))
    np.testing.assert_array_equal(rows[14:16], kappa.max((-1, -2)))


def test_planned_ways_add_up_whatever_their_maps_and_lights():
    n = sphere(40)[(sphere(40) != 0).any(-1)].numpy()
    m = material(*MATERIALS["glossy"]).double().numpy().reshape(3, 3, 2, 6)
    scene = planned.Scene(n, m, light("sky")[0].numpy(), ROTATION)
    truth = scene.list_lobes(n, directional.ALL_LOBES).radiance
    for sizes, levels in (
        ((0, 0, 0), (0, 0, 0)),
        ((40, 40, 40), (1, 0, 0)),
        ((30, 40, 0), (1, 0, 0)),
        ((30, 50, 60), (1, 0, 0)),
    ):
        strategies = [
            planned.Strategy((s,), size, level, 0.0)
            for s, (size, level) in enumerate(zip(sizes, levels, strict=True))
        ]
        seen = planned.Sums(scene, strategies, {}).radiance()
        assert np.abs(seen - truth).mean() <= 5e-3 * truth.mean()


def test_planned_radiance_does_not_depend_on_the_number_of_threads():
    result, before = [], torch.get_num_threads()
    for workers in (1, 2):
        torch.set_num_threads(workers)
        given = leaves("lamps", MATERIALS["glossy"], torch.float32)
        seen = render(*given)
        result.append([seen, *torch.autograd.grad(seen.sum(), given)])
    torch.set_num_threads(before)
    for one, other in zip(*result, strict=True):
        assert torch.equal(one, other)


def test_planned_pictures_are_the_same_alone_and_in_a_batch():
    """To the last bit, values and derivatives, also with twins and with pictures of a few pixels
    beside them.
    """
    kinds = ("matte", "glossy", "satin", "satin", "glossy")
    n = torch.cat([sphere(40) for _ in kinds])
    n[4].view(-1, 3)[torch.arange(40 * 40) % 97 > 0] = 0.0  # five pixels are left
    m = torch.cat([material(*MATERIALS[kind]) for kind in kinds]).float()
    L = torch.cat([light(name) for name in ("lamps", "sky", "lamps", "lamps", "sky")]).float()

    def rendered(part):
        given = [x[part].float().clone().requires_grad_() for x in (n, m, L)]
        seen = render(*given)
        return [seen, *torch.autograd.grad((seen * seen.detach()).sum(), given)]

    together, seen = rendered(slice(0, 5)), render(n, m, L)
    for part in (slice(0, 1), slice(1, 3), slice(3, 5)):
        assert torch.equal(seen[part], render(n[part], m[part], L[part]))
        for whole, alone in zip(together, rendered(part), strict=True):
            assert torch.equal(whole[part], alone)


def test_pixels_are_scaled_and_put_back_as_torch_would():
    vectors = torch.randn(50, 3, generator=torch.Generator().manual_seed(3))
    index = torch.tensor([0, 7, 8, 30, 49])
    result = []
    for step, back in (
        (pixel_selection.unit, pixel_selection.spread),
        (
            lambda v, i: torch.nn.functional.normalize(v[i], dim=-1),
            lambda r, i, p: r.new_zeros(p, 3).index_copy(0, i, r),
        ),
    ):
        given = vectors.clone().requires_grad_()
        seen = back(step(given, index) ** 2, index, 50)
        result.append(
            [seen, *torch.autograd.grad((seen * torch.arange(150).reshape(50, 3)).sum(), given)]
        )
    for ours, torchs in zip(*result, strict=True):
        # what cancels are float32 numbers up to 300
        torch.testing.assert_close(ours, torchs, rtol=1e-4, atol=4e-5)


def test_the_state_of_a_pixel_is_that_of_its_vectors():
    n = torch.tensor(
        [
            [0, 0, 0],
            [0, 0, 1],
            [1, 0, 0],
            [0, 0, 1.02],
            [float("nan"), 0, 1],
            [0.6, 0, 0.8],
            [0, 0, 0],
        ]
    )
    mask = torch.tensor([True, True, True, True, True, False, False])
    outside, away, seen, wrong = (
        layout.OUTSIDE,
        layout.AWAY,
        layout.SEEN,
        layout.WRONG,
    )
    assert pixel_selection.states(n, None, None, 1e-2, 1e-4).tolist() == [
        outside,
        seen,
        away,
        wrong,
        wrong,
        seen,
        outside,
    ]
    assert pixel_selection.states(n, None, mask, 1e-2, 1e-4).tolist() == [
        wrong,
        seen,
        away,
        wrong,
        wrong,
        outside,
        outside,
    ]
    view = torch.tensor([[0.0, 0, 1]]).expand(7, 3).clone()
    view[1], view[5] = torch.tensor([0.0, 0, -1]), torch.tensor([0.0, 0, 2])
    assert pixel_selection.states(n, view, None, 1e-2, 1e-4).tolist() == [
        outside,
        away,
        away,
        wrong,
        wrong,
        wrong,
        outside,
    ]


@pytest.mark.parametrize("size", [12, 17, 48])
def test_a_map_can_be_read_at_all_nodes_of_a_larger_one(size):
    """Corner nodes lie so far outside the disk that no direction would be theirs."""
    normals = reflectance_map.normals(np.arange(size**2), size)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-3)
    constant = np.ones((12**2, 4), np.float32)
    values = reflectance_map.read_values(normals.astype(np.float32), constant, 12)
    assert values == pytest.approx(1, abs=1e-5)


def test_errors_too_large_to_square_break_the_tolerance_without_a_warning():
    """A line search of refinement tries materials of such radiance."""
    error = np.full((4, 3), 1e25, np.float32)
    error[0] = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not cost_model.keeps_tolerance(error, 1.0, 1e-2)
        assert cost_model.excess(error, 1.0, 1e-2) > 1e24
