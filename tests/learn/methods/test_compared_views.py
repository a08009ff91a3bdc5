"""How auto finds what a view per pixel lacks: sums to compare with, and what errors come from."""

import numpy as np
import pytest

from learn.engines.layout import CONE_W_COS, THETA_BINS
from learn.methods import auto_views, cost_model, directional, lobe_shapes, planned_views
from learn.methods.checked_plan import Miss
from learn.methods.planned import Strategy
from learn.methods.viewed_lists import ANGLES, FINE, widest_tile
from tests.support.card_scenes import MATERIALS, material
from tests.support.view_scenes import scene

RANDOM = np.random.default_rng(4)


def sample(s, count=64):
    return directional.spread_indices(len(s.n), count)


@pytest.mark.parametrize("kind", MATERIALS)
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_what_parts_are_compared_with_is_nearly_exact(kind, tolerance):
    s = scene(kind, "lamps of 64 rows", tolerance=tolerance)
    pick, lobes = sample(s), (0, 1, 2)
    exact = s.list_lobes(s.n[pick], s.view[pick], lobes).radiance
    allowed = 0.03 * tolerance * exact.mean()
    assert np.abs(s.truth(pick, lobes) - exact).mean() < allowed
    s.budget = tolerance * float(exact.mean())
    s.truths.clear()
    assert np.abs(s.truth(pick, lobes) - exact).mean() < allowed


def test_broad_lobes_are_compared_under_larger_texels_and_sums_are_kept():
    s, made = scene("satin", "lamps of 64 rows"), []
    original = s.list_lobes
    s.list_lobes = lambda n, v, lobes, level=0, *rest: (
        made.append((lobes, level)) or original(n, v, lobes, level, *rest)
    )
    pick = sample(s)
    whole = s.truth(pick, (0, 1, 2))
    assert made == [((0, 1), 1), ((2,), 0)]
    np.testing.assert_allclose(s.truth(pick, (0, 1)) + s.truth(pick, (2,)), whole, rtol=1e-6)
    assert len(made) == 2
    strict = scene("satin", "lamps of 64 rows", tolerance=1e-5)
    assert not strict.nearly_smooth.any()  # larger texels show there


@pytest.mark.parametrize("mirrored", [False, True], ids=["in place", "mirrored"])
def test_an_error_comes_from_views_where_nodes_are_dense_and_from_nodes_where_views_are_many(
    mirrored,
):
    s = scene("satin", fov=40)
    pick, lobes = sample(s), (1,)
    s.budget = 1e-2 * float(s.truth(pick, (0, 1, 2)).mean())
    right = s.truth(pick, lobes)

    def causes(size, views):
        part = planned_views.Sum(s, Strategy(lobes, size, 0, 0.1, views, mirrored))
        return *part.causes(pick, right), part.error(pick, right)

    by_view, by_map, error = causes(80, 1)
    assert by_map < 0.2 * by_view and error == pytest.approx(by_view, rel=0.2)
    less, same, _ = causes(80, 3)
    assert less < 0.7 * by_view and same == pytest.approx(by_map)
    _, coarser, _ = causes(12, 1)
    assert coarser > 10 * by_map


def test_maps_of_slopes_have_fewer_nodes_unless_the_derivative_by_the_view_is_requested():
    strategy = Strategy((1,), 40, 0, 8.0, 3, True)
    nodes = [
        [len(part.nodes) * part.views for part in planned_views.Sum(s, strategy).maps]
        for s in (scene("satin"), scene("satin", view_gradient=True))
    ]
    assert len(nodes[0]) == 2 and nodes[0][1] < 1.2 * nodes[0][0]
    assert nodes[1] == [3 * nodes[0][0]]


def test_a_map_is_kept_where_more_views_are_added():
    s = scene("satin")
    strategy = Strategy((1,), 40, 0, 8.0, 1, True)
    known = {strategy: planned_views.Sum(s, strategy)}
    more = planned_views.Sum(s, Strategy((1,), 40, 0, 8.0, 3, True), known)
    assert more.maps[0] is known[strategy].maps[0]


def test_sums_at_nodes_have_the_same_derivatives_without_those_by_their_normals():
    s = scene("glossy")
    listing = s.list_lobes(s.n, s.view, (0, 1, 2), 0, 0.0, 0.15)
    g = RANDOM.uniform(0.5, 1.5, s.n.shape).astype(np.float32)
    by_n, by_view, by_m, by_E = listing.backward(g, False)
    assert by_n is not None and by_view is None
    none, none_either, same_m, same_E = listing.backward(g, False, False)
    assert none is None and none_either is None
    np.testing.assert_array_equal(same_m, by_m)
    np.testing.assert_array_equal(same_E, by_E)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("size, count", [(16, 2000), (4, 5)])
def test_ranges_are_the_extremes_of_curves_near_each_angle(backward, size, count):
    s = scene("glossy")
    tables = s.list_lobes(s.n[:4], s.view[:4], (0, 1, 2)).tables
    views = s.view[:count]
    blocks = tables.cones[:, CONE_W_COS].reshape(-1)[: tables.lights.blocks]
    reach = 0.5 * (np.arccos(blocks.min()) + widest_tile(views, size))
    ranges, bins = tables.ranges(views, size, backward), ANGLES[::FINE]
    assert ranges.flags.c_contiguous and ranges.shape == (3, 2, THETA_BINS)
    for k in range(THETA_BINS):
        low, high = bins[k] - reach, bins[k + 1] + reach
        gamma, kappa = (tables.curves[:, i, (low <= ANGLES) & (high >= ANGLES)] for i in (0, 1))
        assert (ranges[:, 0, k] <= gamma.min(-1) * (1 + 1e-6)).all()
        assert (ranges[:, 1, k] >= kappa.max(-1) * (1 - 1e-6)).all()
    # and are at most two bins too wide
    low, high = bins[30] - reach - 2 * bins[1], bins[31] + reach + 2 * bins[1]
    around = tables.curves[:, 0, (low <= ANGLES) & (high >= ANGLES)]
    assert (ranges[:, 0, 30] >= around.min(-1) * (1 - 1e-6)).all()


def test_the_widest_tile_is_that_of_the_angles_between_views():
    v = RANDOM.normal((0, 0, 3), np.where(np.arange(37) < 32, 0.3, 1.0)[:, None], (37, 3))
    v = (v / np.linalg.norm(v, axis=-1, keepdims=True)).astype(np.float32)
    angles = []
    for tile in (v[:16], v[16:32], v[32:]):
        axis = tile.mean(0) / np.linalg.norm(tile.mean(0))
        angles.append(np.arccos(np.clip(tile @ axis, -1, 1)).max())
    assert widest_tile(v, 16) == pytest.approx(max(angles), abs=1e-5)
    assert widest_tile(v[:1], 16) == pytest.approx(0.0, abs=1e-3)


def test_an_excess_brings_the_error_to_the_aim():
    error, level, tolerance = RANDOM.uniform(0, 0.06, (64, 3)), 2.0, 1e-2
    assert not cost_model.keeps_tolerance(error, level, tolerance)
    kept = 1 - cost_model.excess(error, level, tolerance) / error.mean()
    by_pixel = kept * error.mean(-1)
    reached = by_pixel.mean() + by_pixel.std() / np.sqrt(len(by_pixel))
    assert reached == pytest.approx(cost_model.AIM * tolerance * level)
    assert cost_model.keeps_tolerance(kept * error, level, tolerance)


def test_the_visible_sharpness_ignores_what_reflects_little():
    m = material(*MATERIALS["glossy"]).double().reshape(3, 3, 2, 6).numpy().copy()
    right = lobe_shapes.sharpness(m)
    np.testing.assert_allclose(lobe_shapes.visible_sharpness(m, 0.0), right)
    m[:, 1, 0, 5], m[:, 1, 1, 5] = 1e-7, 1e6  # a needle at grazing that reflects nothing
    assert lobe_shapes.sharpness(m)[1] > 1e4 * right[1]
    np.testing.assert_allclose(lobe_shapes.visible_sharpness(m, 1e-3)[1], right[1], rtol=0.5)


def test_maps_grow_by_how_far_their_nodes_are_off():
    s = scene("satin", fov=40)
    pick, lobes = sample(s), (1,)
    right = s.truth(pick, lobes)
    part = planned_views.Sum(s, Strategy(lobes, 20, 0, 0.1, 1, True))
    _, off = part.causes(pick, right)
    part.causes = lambda *_: (0.0, off)
    part.error = lambda *_: off
    sizes = [
        auto_views.improve_maps(part, Miss(pick, right, share * off)).size
        for share in (0.01, 0.4, 0.99)
    ]
    limits = auto_views.LEAST_GROWTH, (1 / 0.6) ** (1 / auto_views.ORDER), auto_views.MOST_GROWTH
    assert sizes == [cost_model.next_larger_map(20, len(s.n), growth) for growth in limits]
    assert len(set(sizes)) == 3


@pytest.mark.parametrize("view_gradient", [False, True], ids=["", "derivative by view"])
@pytest.mark.parametrize("mirrored", [False, True], ids=["in place", "mirrored"])
def test_better_strategies_end_at_the_pixels(mirrored, view_gradient):
    s = scene("satin", view_gradient=view_gradient)
    s.budget = 1e-3
    pick = directional.spread_indices(len(s.n), 16)
    truth = s.truth(pick, (1,))
    views = 3 if view_gradient else 1
    part = planned_views.Sum(
        s, Strategy((1,), 12, 2, auto_views.initial_culling(s)[1], views, mirrored)
    )
    met = []
    while True:
        miss = Miss(pick, truth, 0.5 * part.error(pick, truth))
        if (other := auto_views.improve_strategy(part, miss)) == part.strategy:
            break
        met.append(other)
        part = planned_views.Sum(s, other)
        assert len(met) < 40
    last = met[-1]
    assert last.size == 0 and last.level == 0 and not last.mirrored
    assert last.culled == cost_model.GUARANTEED
    if not view_gradient:
        assert {each.views for each in met} > {1}  # more views were tried
    assert len({each.size for each in met}) > 2  # and larger maps
