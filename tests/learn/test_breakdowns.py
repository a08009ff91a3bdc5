"""Tables by family and by distance to training, from figures that are known."""

import numpy as np
import pytest

from learn.evaluation import breakdowns, distances, tables
from learn.evaluation.methods import OURS, OURS_REFINED
from learn.evaluation.table import Rows
from shaders import envmap

FAMILIES = {"brass": "metal", "felt": "fabric"}
FIGURES = [(100, 60), (300, 310), (50, 40), (500, 200), (80, 90), (10, 5)]


@pytest.fixture
def edits():
    rows = []
    names = [(shape, name) for shape in "abc" for name in ("brass", "felt")]
    for (shape, name), (before, after) in zip(names, FIGURES, strict=True):
        figures = {
            method: {"l2": l2, "l2_one_factor": l2 / 2, "l2_three_factors": l2 / 4}
            for method, l2 in ((OURS, before), (OURS_REFINED, after))
        }
        rows.append(
            {
                "shape": shape,
                "category": "car" if shape == "a" else "chair",
                "light": "city" if name == "brass" else "hall",
                "materials": ["wax" if shape == "b" else "clay"],
                "wanted": [name],
                "methods": figures,
            }
        )
    return Rows(rows, "wanted")


def cells(table):
    return {row["name"]: row["cells"] for row in table["rows"]}


def test_the_main_table_sets_metals_apart_and_has_medians(edits):
    table = tables.edits_by_method(edits, FAMILIES)
    row = cells(table)[OURS_REFINED]
    assert row["metals"][0] == pytest.approx((60 + 40 + 90) / 3)
    assert row["without_metals"][0] == pytest.approx((310 + 200 + 5) / 3)
    assert row["median"] == 75
    assert row["l2_one_factor"][0] == pytest.approx(row["l2"][0] / 2)
    assert len(table["columns"]) <= 6


def test_edits_that_refinement_made_worse_are_counted(edits):
    assert cells(tables.gains(edits, FAMILIES))["all edits"]["worse"] == 2
    assert cells(tables.gains(edits, FAMILIES))["shape: car"]["worse"] == 1


def test_the_worst_edit_of_each_family_is_named(edits):
    result = cells(breakdowns.worst(edits, Rows([], "materials"), FAMILIES))
    assert result["into: metal"]["worst"] == 90 and result["into: fabric"]["worst"] == 310
    assert result["shape: chair"]["which"] == "wax → felt, b, hall"
    assert result["shape: car"]["l2"][0] == pytest.approx(185)


def test_edits_are_grouped_by_the_distance_of_their_input(edits):
    known = {"lights": {"city": 0.0, "hall": 0.4}, "materials": {"wax": 0.9, "clay": 0.2}}
    result = cells(breakdowns.by_distance(edits, known))
    assert result["light: of training"]["edits"] == 3
    assert result["light: of training"]["refined"][0] == pytest.approx(190 / 3)
    assert result["light: not of training"]["distance"] == 0.4
    assert result["input material: nearer half"]["edits"] == 4
    assert result["input material: farther half"]["l2"][0] == pytest.approx(275)
    assert breakdowns.by_distance(edits, {"lights": {}, "materials": {}}) is None


def test_a_turned_training_map_is_of_training_and_others_are_farther_the_less_alike(rng):
    w, _ = envmap.directions(64, 128)

    def lamp(height):
        towards = np.array([np.sqrt(1 - height**2), height, 0.0])
        return (0.1 + np.exp(8 * (w @ towards - 1)))[..., None] * np.ones(3)

    noise = rng.random((64, 128, 3))
    maps = {"turned": envmap.roll(lamp(0.3), 37), "near": lamp(0.5), "far": lamp(-0.9)}
    result = distances.of_lights(maps, [lamp(0.3), noise])
    assert result["turned"] == 0
    assert 0 < result["near"] < result["far"]
    assert distances.of_lights(maps, []) == {}


def test_a_training_label_has_no_distance(rng):
    label = np.log(rng.random(108) + 0.1)
    training = np.stack([label, label + 0.5])
    result = distances.of_materials({"same": label, "other": label + 0.2}, training)
    assert result["same"] == 0 and result["other"] > 0
    assert distances.of_materials({"same": label}, None) == {}
