"""A view per pixel under auto: sums over lists, and maps whose nodes have views of their own, have
the values and derivatives of the exact sum; places and charts have those of finite differences.
"""

import copy

import numpy as np
import pytest
import torch

from learn.experiments.layer import near_shapes
from learn.layer import render
from learn.methods import (
    auto_views,
    exact,
    lobe_shapes,
    planned_views,
    reflectance_map,
    view_places,
)
from learn.methods.planned import Strategy
from tests.support.card_scenes import MATERIALS, light, material
from tests.support.view_scenes import ROTATION, scene, seen

RANDOM = np.random.default_rng(4)
INPUTS = ("n", "view", "material", "light")


def truth(s, lobes, g):
    """The exact sum of some lobes in float64, and its derivatives by n, view, m and E."""
    w, energy = exact.texels(
        torch.as_tensor(s.light.E / s.light.solid_angle).double().permute(1, 2, 0),
        torch.tensor(ROTATION, dtype=torch.float64).reshape(3, 3),
    )
    given = [torch.as_tensor(x).double().requires_grad_() for x in (s.n, s.view, s.m)]
    energy.requires_grad_()
    kept = lobe_shapes.keep_lobes(given[2], np.isin(range(3), lobes))
    unit = [torch.nn.functional.normalize(x, dim=-1) for x in given[:2]]
    result = exact.ExactSum.apply(*unit, kept, energy, w)
    by = torch.autograd.grad((result * torch.as_tensor(g).double()).sum(), [*given, energy])
    return result.detach().numpy(), [x.numpy() for x in by]


def tangential(by, vectors):
    """A derivative without its part along unit vectors, which inputs of unit length do not have."""
    return by - (by * vectors).sum(-1, keepdims=True) * vectors


def relative(ours, right):
    return float(np.abs(ours - right).mean() / np.abs(right).mean())


@pytest.mark.parametrize(
    "apart, error, slopes", [(0.0, 1e-5, 1e-4), (0.15, 2e-3, 1e-2)], ids=["alone", "in runs"]
)
@pytest.mark.parametrize("kind, lobes", [("satin", (0, 2)), ("glossy", (0, 1, 2))])
def test_a_listed_sum_for_views_has_the_exact_derivatives(kind, lobes, apart, error, slopes):
    s = scene(kind)
    g = RANDOM.uniform(0.5, 1.5, s.n.shape).astype(np.float32)
    listing = s.list_lobes(s.n, s.view, lobes, 0, 0.0, apart)
    right, (by_n, by_view, by_m, by_energy) = truth(s, lobes, g)
    assert relative(listing.radiance, right) < error
    ours_n, ours_view, ours_m, ours_E = listing.backward(g)
    assert relative(tangential(ours_n, s.n), tangential(by_n, s.n)) < slopes
    assert relative(tangential(ours_view, s.view), tangential(by_view, s.view)) < slopes
    for which in (0, 1):  # κ and γ apart: the one is far larger
        assert relative(ours_m[:, :, which], by_m[:, :, which]) < slopes
    assert relative(ours_E.T, by_energy[s.light.places(0)[1]]) < slopes


def test_runs_of_views_are_what_is_off_and_shorter_ones_are_nearer():
    s = scene("glossy")
    right, _ = truth(s, (0, 1, 2), np.ones_like(s.n))
    errors = [
        relative(s.list_lobes(s.n, s.view, (0, 1, 2), 0, 0.0, apart).radiance, right)
        for apart in (0.0, 0.1, 0.4)
    ]
    assert errors[0] < 1e-5 < errors[1] < errors[2] < 2e-2


def test_what_a_listed_sum_leaves_out_is_within_its_bound():
    s = scene("glossy")
    whole = s.list_lobes(s.n, s.view, (1, 2)).radiance
    left_out = 0.05 * float(whole.mean())
    less = s.list_lobes(s.n, s.view, (1, 2), 0, left_out)
    assert (whole - less.radiance).max() <= left_out * 1.001
    capacity = less.lists[0].entries.size
    assert less.lists[0].lengths.sum() < 0.9 * capacity  # something is left out


def moved_along(vectors, directions, step):
    result = vectors + step * directions
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


def with_views(views, view):
    """The fit as it is, with other views."""
    result = copy.copy(views)
    a, b, depth = (view_places.component_along(view, row) for row in views.frame)
    result.depth = depth
    result.slopes = np.stack([a / depth, b / depth])
    return result


@pytest.mark.parametrize("mirrored", [False, True], ids=["in place", "mirrored"])
@pytest.mark.parametrize("fov", [30, 60])
def test_places_have_the_derivatives_of_finite_differences(mirrored, fov, monkeypatch):
    monkeypatch.setattr(view_places, "SETTLED", 1e-12)
    monkeypatch.setattr(view_places, "STEPS", 60)
    n, view = (x.astype(np.float64) for x in seen(fov))
    n, view = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (n, view))
    views = view_places.Views(n, view)
    facing = (n * view).sum(-1) > views.least_cosine + 0.02
    n, view = n[facing], view[facing]
    g, h = RANDOM.normal(size=n.shape), RANDOM.normal(size=(2, len(n)))

    def loss(n, view):
        places = view_places.Places(n, view, with_views(views, view), mirrored)
        return (g * places.n).sum(-1) + (h * places.coordinates).sum(0)

    places = view_places.Places(n, view, with_views(views, view), mirrored)
    by_n, by_view = places.backward(g, h)
    step = 1e-5
    for ours, of_n in ((by_n, True), (by_view, False)):
        directions = tangential(RANDOM.normal(size=n.shape), n if of_n else view)
        ends = [
            loss(
                *(
                    (moved_along(n, directions, sign * step), view)
                    if of_n
                    else (n, moved_along(view, directions, sign * step))
                )
            )
            for sign in (1, -1)
        ]
        right = (ends[0] - ends[1]) / (2 * step)
        # the series for V's part stops where LEFT of it remains
        assert relative((ours * directions).sum(-1), right) < 2 * view_places.LEFT


def test_a_mirrored_place_sees_the_light_that_the_pixel_sees():
    n, view = seen(40)
    views = view_places.Views(n, view)
    places = view_places.Places(n, view, views, True)
    facing = (n * view).sum(-1) > 0.4

    def reflected(n, v):
        return 2 * (n * v).sum(-1, keepdims=True) * n - v

    there = views.vectors(views.middle(places.n))
    off = np.linalg.norm(reflected(places.n, there) - reflected(n, view), axis=-1)[facing]
    before = np.linalg.norm(view - views.vectors(views.middle(n)), axis=-1)[facing]
    assert off.max() < 0.05 * before.mean()


@pytest.mark.parametrize("count", [1, 3, 6])
def test_polynomials_interpolate_what_their_degree_can(count):
    n, view = seen()
    places = view_places.Places(n, view, view_places.Views(n, view), False)
    terms, (x, y) = places.terms(count), places.coordinates
    a, b = np.array(view_places.OFFSETS[count]).T
    for i, j in view_places.POWERS[:count]:
        at_offsets = (a**i * b**j).astype(np.float32)
        held = view_places.coefficients(count) @ at_offsets
        np.testing.assert_allclose(held @ terms, x**i * y**j, atol=2e-4)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("count", [3, 6])
def test_polynomials_have_the_derivatives_of_finite_differences(count, first):
    n, view = (x.astype(np.float64) for x in seen())
    places = view_places.Places(n, view, view_places.Views(n, view), False)
    g = RANDOM.normal(size=(count - first, len(n)))
    ours, at, step = places.terms_backward(g, first), places.coordinates, 1e-3

    def loss(coordinates):
        places.coordinates = coordinates
        return (g * places.terms(count)[first:]).sum(0)

    for axis, by in enumerate(ours):
        moved = step * np.eye(2)[axis][:, None]
        right = (loss(at + moved) - loss(at - moved)) / (2 * step)
        assert relative(by, right) < 2e-3  # terms are float32


def test_on_a_sphere_the_normal_tells_the_view():
    n, view = seen(40, 0.0)
    views = view_places.Views(n, view)
    assert views.spread < 0.005 < 0.2 < np.abs(views.slopes).max()
    # where normals tell nothing, all of the views is left
    flat = view_places.Views(np.tile(np.float32([[0, 0, 1]]), (len(n), 1)), view)
    assert flat.spread > 0.15


def test_a_chart_draws_all_normals_and_finds_them_again():
    n, _ = seen(80)
    n[:40] = moved_along(n[:40], np.float32([[0, 0, -1.0]]), 2.0)  # some look away from the axis
    frame = view_places.Views(n, n).frame
    chart = view_places.Chart(n, frame)
    assert chart.scale < 1 and chart.n[:, 2].min() < -0.1 and chart.drawn[:, 2].min() > -1e-6
    np.testing.assert_allclose(np.linalg.norm(chart.drawn, axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(chart.normals(chart.drawn), n, atol=2e-3)
    g = RANDOM.normal(size=(len(n), 2))
    directions = tangential(RANDOM.normal(size=n.shape), n)

    def place(n):
        drawn = turned_and_drawn(n, frame, chart.scale)
        return drawn[:, :2] / np.sqrt(1 + drawn[:, 2:])

    ends = [
        (g * place(moved_along(n.astype(np.float64), directions, s * 1e-5))).sum(-1)
        for s in (1, -1)
    ]
    root = np.sqrt(1 + chart.drawn[:, 2:])
    by_xy = g / root  # as learn.engines.interpolation gives it
    by_z = -0.5 * (g * chart.drawn[:, :2]).sum(-1, keepdims=True) / root**3
    ours = chart.backward(np.concatenate([by_xy, by_z], -1))
    right = (ends[0] - ends[1]) / 2e-5
    assert relative((ours * directions).sum(-1), right) < 1e-3


def turned_and_drawn(n, frame, scale):
    """What Chart draws, at a given scale and in float64."""
    x, y, z = (n @ frame.T.astype(np.float64)).T
    drawn_z = 1 - float(scale) ** 2 * (1 - z)
    stretch = float(scale) * np.sqrt((1 + drawn_z) / (1 + z))
    return np.stack([x * stretch, y * stretch, drawn_z], -1)


@pytest.mark.parametrize(
    "kind, lobe, mirrored, views, limit",
    [
        ("matte", 0, False, 3, 2e-3),
        ("satin", 1, False, 3, 1e-2),
        ("satin", 1, False, 6, 3e-3),
        ("satin", 2, True, 1, 3e-2),
        ("satin", 2, True, 3, 1e-2),
    ],
)
def test_maps_of_few_views_come_near_the_sum(kind, lobe, mirrored, views, limit):
    s = scene(kind, fov=40)
    right, _ = truth(s, (lobe,), np.ones_like(s.n))
    ours = planned_views.Sum(s, Strategy((lobe,), 60, 0, 0.0, views, mirrored)).values
    assert relative(ours, right) < limit


@pytest.mark.parametrize("kind", MATERIALS)
@pytest.mark.parametrize("fov, depth", [(40, 0.0), (60, 0.15)], ids=["sphere", "dented"])
def test_auto_has_the_derivatives_of_the_sum_for_views(kind, fov, depth, monkeypatch):
    planned = []
    original = planned_views.Sum.__init__

    def noted(self, scene, strategy, known=None):
        planned.append(strategy)
        original(self, scene, strategy, known)

    monkeypatch.setattr(planned_views.Sum, "__init__", noted)
    n, view = near_shapes.near(80, np.radians(fov), depth, 1)
    result = []
    for method in ("auto", "exact"):  # whose kernels are right to 1e-5 (engines/test_accuracy.py)
        given = [n, view, material(*MATERIALS[kind]), light("lamps")]
        given = [x.clone().requires_grad_() for x in given]
        picture = render(given[0], given[2], given[3], view=given[1], method=method)
        weight = torch.linspace(0.5, 1.5, picture.numel()).reshape(picture.shape)
        result.append([picture, *torch.autograd.grad((picture * weight).sum(), given)])
    assert any(strategy.size for strategy in planned)
    errors = [
        ((ours - right).abs().mean() / right.abs().mean()).item()
        for ours, right in zip(*result, strict=True)
    ]
    assert errors[0] < 1e-2
    # as for a distant viewer: a derivative by n is one of interpolation's weights
    assert max(errors[1:]) < 0.1, dict(zip(INPUTS, errors[1:], strict=True))


def test_the_light_without_a_gradient_and_the_view_without_one_are_planned_too():
    n, view = near_shapes.near(40, np.radians(50), 0.1, 1)
    m, L = material(*MATERIALS["satin"]), light("sky")
    with torch.no_grad():
        right = render(n, m, L, view=view, method="exact")
        ours = render(n, m, L, view=view, tolerance=1e-2)
    assert 0 < (ours - right).abs().mean() < 1e-2 * right.mean()


def test_pictures_with_views_are_the_same_alone_in_a_batch_and_on_any_threads():
    n, view = near_shapes.near(40, np.radians(50), 0.1, 1)
    n, view = (x.expand(3, -1, -1, -1).clone() for x in (n, view))
    kinds = ("matte", "satin", "glossy")
    m = torch.cat([material(*MATERIALS[kind]) for kind in kinds])
    L = torch.cat([light(name) for name in ("lamps", "sky", "lamps")])

    def rendered(part):
        given = [x[part].clone().requires_grad_() for x in (n, m, L, view)]
        seen = render(*given[:3], view=given[3])
        return [seen, *torch.autograd.grad((seen * seen.detach()).sum(), given)]

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    together = rendered(slice(0, 3))
    torch.set_num_threads(1)
    for part in (slice(0, 1), slice(1, 3)):
        for whole, alone in zip(together, rendered(part), strict=True):
            assert torch.equal(whole[part], alone)
    torch.set_num_threads(before)


def test_no_map_is_larger_than_the_largest_and_views_beyond_a_cone_have_none():
    n, view = near_shapes.near(40, np.radians(150), 0.0)
    inside = (n != 0).any(-1)
    views = view_places.Views(n[inside].numpy(), view[inside].numpy())
    assert np.isinf(views.spread)
    m = material(*MATERIALS["matte"]).double().reshape(3, 3, 2, 6).numpy()
    s = planned_views.Scene(
        n[inside].numpy(), view[inside].numpy(), m, light("sky")[0].numpy(), ROTATION, 1e-2
    )
    plan = auto_views.choose_strategies(s, (0, 1, 2), 1e-2)
    assert all(strategy.size == 0 for strategy in plan)
    near = auto_views.choose_strategies(scene("matte", fov=40), (0, 1, 2), 1e-2)
    assert 0 < max(strategy.size for strategy in near) <= reflectance_map.LARGEST


@pytest.mark.parametrize("mirrored", [False, True], ids=["in place", "mirrored"])
def test_kernels_place_pixels_as_numpy_does_and_have_its_derivatives(mirrored, monkeypatch):
    # until places no longer move: numpy stops by the mean over pixels, kernels at each pixel
    monkeypatch.setattr(view_places, "SETTLED", 1e-9)
    monkeypatch.setattr(view_places, "STEPS", 40)
    n, view = seen(40)
    views = view_places.Views(n, view)
    g, h = RANDOM.normal(size=n.shape), RANDOM.normal(size=(2, len(n)))
    found = []
    for kind in (np.float32, np.float64):
        places = view_places.Places(n.astype(kind), view.astype(kind), views, mirrored)
        assert places.compiled == (kind == np.float32)
        found.append([places.n, places.coordinates, *places.backward(g, h)])
        found[-1] += places.backward(g, None)
    for ours, right in zip(*found, strict=True):
        assert np.abs(ours - right).max() < 1e-3 * np.abs(right).mean() + 1e-9
