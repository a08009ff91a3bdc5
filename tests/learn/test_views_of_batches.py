"""Which views training draws: how often those of each category, and how many for each process."""

import collections
import dataclasses

import numpy as np
import pytest

from learn.data import lights
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.relit import RelitDataset
from learn.data.settings import Data
from manifests.errors import InputError
from tests.support import synthetic

SIZE = 32
CATEGORIES = ("chair",) * 3 + ("car",) * 7


def with_weights(weights):
    return Data(sharing=2, photograph=False, category_weights=weights)


@pytest.fixture(scope="module")
def data_split(tmp_path_factory):
    """Ten views that all show one sphere, of which three are said to be chairs, the rest cars."""
    folder = tmp_path_factory.mktemp("dataset")
    synthetic.write_dataset(
        folder, [synthetic.matte()], np.random.default_rng(1), size=SIZE, category="chair"
    )
    geometry = Geometry(folder, progress=False)
    (view,), normals, segments = geometry.views, geometry.normals(0), geometry.segments(0)
    geometry.normals, geometry.segments = lambda i: normals, lambda i: segments
    geometry.views = [
        dataclasses.replace(view, shape=f"{category}:{i}", category=category)
        for i, category in enumerate(CATEGORIES)
    ]
    labels = {"matte": np.array(synthetic.matte().label, np.float32)}
    maps = [lights.draw_computed(np.random.default_rng(2)).astype(np.float32)]
    return DataSplit(geometry, np.arange(len(CATEGORIES)), labels, maps, "train")


def test_a_batch_that_processes_cannot_share_is_refused_in_one_line(data_split):
    with pytest.raises(InputError, match=r"schedule.batch, 3 processes: expected a multiple of 6"):
        RelitDataset(data_split, with_weights({}), 8, SIZE, 5, (0, 3))


def counted(source, batches):
    """How often each view is drawn, by its shape's name."""
    return collections.Counter(name.split()[0] for k in range(batches) for name in source[k].names)


def test_views_are_drawn_as_often_as_the_weights_say(data_split):
    drawn = counted(RelitDataset(data_split, with_weights({"chair": 6.0}), 8, SIZE, 5), 40)
    share = sum(drawn[f"chair:{i}"] for i in range(3)) / drawn.total()
    # 18 of 25 where a pair may show one view twice, which it may not; 3 of 10 without weights
    assert 0.55 < share < 0.75
    assert {f"car:{i}" for i in range(3, 10)} <= set(drawn)


def test_views_of_weight_nought_are_never_drawn_even_where_others_must_repeat(data_split):
    one = dataclasses.replace(data_split, views=data_split.views[2:])
    drawn = counted(RelitDataset(one, with_weights({"car": 0.0}), 8, SIZE, 5), 2)
    assert drawn == {"chair:2": 16}


def test_validation_draws_all_views_alike_whatever_the_weights(data_split):
    of_validation = dataclasses.replace(data_split, side="validation")
    plain, weighted = (
        RelitDataset(of_validation, data, 8, SIZE, 5)[0].names
        for data in (Data(sharing=2, photograph=False), with_weights({"car": 0.0}))
    )
    assert plain == weighted


@pytest.mark.parametrize(
    "weights, message",
    [
        ({"chairs": 2.0}, r"'chairs': expected a category .*did you mean chair"),
        ({"chair": 0.0, "car": 0.0}, "expected a weight above 0"),
    ],
)
def test_weights_that_draw_nothing_are_refused_in_one_line(data_split, weights, message):
    with pytest.raises(InputError, match=message):
        RelitDataset(data_split, with_weights(weights), 8, SIZE, 5)
