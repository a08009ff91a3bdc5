"""The bootstrap over shapes and materials."""

import numpy as np
import pytest

from learn.metrics import bootstrap


def crossed(shapes, materials):
    """Groups of a full table of shapes × materials."""
    return bootstrap.groups_of(
        np.repeat(range(shapes), materials), np.tile(range(materials), shapes)
    )


def test_a_constant_has_no_interval():
    assert bootstrap.interval(np.full(12, 3.5), bootstrap.draws(crossed(4, 3))) == [3.5, 3.5, 3.5]


def test_the_mean_is_the_plain_one(rng):
    values = rng.random(20)
    assert bootstrap.interval(values, bootstrap.draws(crossed(5, 4)))[0] == pytest.approx(
        values.mean(), rel=1e-12
    )


def test_values_that_hang_on_shapes_are_as_uncertain_as_the_shapes_are_few(rng):
    """200 pictures of 5 shapes know a mean no better than 5 numbers do: the interval must not
    shrink with the pictures.
    """
    of_shape = rng.standard_normal(5)
    low, high = (
        bootstrap.interval(np.repeat(of_shape, m), bootstrap.draws(crossed(5, m)))[1:]
        for m in (4, 40)
    )
    single = bootstrap.interval(np.repeat(of_shape, 40), bootstrap.draws([np.arange(200)]))
    # 2000 draws of 5 shapes leave the ends uncertain by some 5 %
    assert np.ptp(high) == pytest.approx(np.ptp(low), rel=0.15)
    assert np.ptp(high) > 4 * np.ptp(single[1:])  # √40 ≈ 6.3 in the mean


def test_intervals_of_two_crossed_effects_cover_the_truth(rng):
    """Of 60 tables 10 × 8 drawn about 0, at least 48 intervals hold 0: 95 % promised, few groups
    make bootstraps a little narrow.
    """
    groups, held = crossed(10, 8), 0
    weights = bootstrap.draws(groups, 400)
    for _ in range(60):
        table = (
            rng.standard_normal((10, 1))
            + rng.standard_normal((1, 8))
            + 0.5 * rng.standard_normal((10, 8))
        )
        _, low, high = bootstrap.interval(table.reshape(-1), weights)
        held += low <= 0 <= high
    assert held >= 48


def test_the_ratio_of_a_multiple_is_certain(rng):
    values = rng.random((3, 12)) + 0.1
    assert bootstrap.ratio(values, 0.4 * values, crossed(4, 3), 200) == pytest.approx(
        [0.4, 0.4, 0.4], rel=1e-12
    )


def test_draws_that_keep_no_picture_are_left_out():
    """Two pictures that share neither shape nor material: half of all draws pick a shape and the
    other one's material.
    """
    weights = bootstrap.draws(bootstrap.groups_of(list("ab"), list("cd")), 400)
    # of the 16 equally likely draws, 2 keep nothing
    assert (weights.sum(1) > 0).all() and 250 < len(weights) < 400


def test_numbers_drawn_at_once_are_those_drawn_one_after_another(rng):
    """So that intervals stay to the bit what they were when published."""
    groups = crossed(4, 3)
    a, b = rng.random((2, 5, 12))
    plain = np.random.default_rng(0)
    weights, ratios = [], []
    for _ in range(100):
        shapes, materials = (np.bincount(plain.integers(n, size=n), minlength=n) for n in (4, 3))
        weight = (shapes[:, None] * materials).reshape(-1)
        runs = plain.integers(5, size=5)
        weights.append(weight)
        ratios.append((b[runs].mean(0) * weight).sum() / (a[runs].mean(0) * weight).sum())
    drawn, _ = bootstrap._drawn(groups, 5, 100)
    assert np.array_equal(drawn, weights)
    assert bootstrap.ratio(a, b, groups, 100)[1:] == list(np.percentile(ratios, bootstrap.LEVELS))


def test_draws_of_rows_are_those_of_the_groups_that_rows_name():
    rows = [{"shape": s, "light": e} for s in "abc" for e in "xy"]
    by_groups = bootstrap.draws(bootstrap.groups_of(list("aabbcc"), list("xyxyxy")), 50)
    assert np.array_equal(bootstrap.draws_of_rows(rows, ("shape", "light"), 50), by_groups)
    assert not np.array_equal(bootstrap.draws_of_rows(rows, ("light", "shape"), 50), by_groups)
