"""The experiment nearest-shapes: its thirds and its rank correlation, on figures that are known."""

import numpy as np
import pytest

from learn.experiments.training import nearest_shapes


def rows(distances, errors):
    return [
        {"data": "d", "shape": f"s{k}", "distance": distance, "angle": error + turn}
        for k, (distance, error) in enumerate(zip(distances, errors, strict=True))
        for turn in (-1, 1)
    ]


def test_errors_that_rise_with_distance_have_rank_correlation_1_whatever_their_scale():
    pairs = np.array(nearest_shapes.shapes_of(rows([1, 2, 30, 4, 50], [1, 2, 90, 3, 100])))
    assert nearest_shapes.rank_correlation(pairs) == pytest.approx((1, 1, 1))
    falling = pairs * [1, -1]
    assert nearest_shapes.rank_correlation(falling)[0] == pytest.approx(-1)


def test_unrelated_errors_have_an_interval_about_0(rng):
    pairs = rng.random((60, 2))
    mean, low, high = nearest_shapes.rank_correlation(pairs)
    assert low < mean < high and low < 0 < high and high - low < 0.8


def test_few_or_equal_shapes_have_no_rank_correlation():
    assert nearest_shapes.rank_correlation(np.array([[1.0, 2], [2, 3], [3, 4]])) is None
    assert nearest_shapes.rank_correlation(np.array([[1.0, 2], [1, 3], [1, 4], [1, 5]])) is None


def test_thirds_have_equally_many_shapes_in_the_order_of_their_distance():
    thirds = nearest_shapes.thirds_of(rows([9, 1, 5, 3, 7, 2], range(6)))
    names = [{row["shape"] for row in third} for third in thirds.values()]
    assert names == [{"s1", "s5"}, {"s3", "s2"}, {"s4", "s0"}]
    assert all(len(third) == 4 for third in thirds.values())
