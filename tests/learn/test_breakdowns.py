"""Tables by family and by distance to training, from figures that are known."""

import numpy as np
import pytest

from learn.data import seen
from learn.data.records import Records
from learn.evaluation import breakdowns, distances, tables
from learn.evaluation.methods import OURS, OURS_REFINED
from learn.evaluation.table import Rows
from manifests import measured_lights
from manifests.errors import InputError
from shaders import envmap
from tests.support import synthetic
from tests.support.synthetic import matte

FAMILIES = {"brass": "metal", "felt": "fabric"}
NO_PICTURES = Rows([], "materials")
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
    assert cells(tables.gains_table(edits, FAMILIES))["all edits"]["worse"] == 2
    assert cells(tables.gains_table(edits, FAMILIES))["shape: car"]["worse"] == 1


def test_the_worst_edit_of_each_family_is_named(edits):
    result = cells(breakdowns.worst_edits(edits, Rows([], "materials"), FAMILIES))
    assert result["into: metal"]["worst"] == 90 and result["into: fabric"]["worst"] == 310
    assert result["shape: chair"]["which"] == "wax → felt, b, hall"
    assert result["shape: car"]["l2"][0] == pytest.approx(185)


def test_edits_are_grouped_by_the_distance_of_their_input(edits):
    known = {"lights": {"city": 0.0, "hall": 0.4}, "materials": {"wax": 0.9, "clay": 0.2}}
    result = cells(breakdowns.distance_table(edits, NO_PICTURES, known))
    assert result["light: of training"]["edits"] == 3
    assert result["light: of training"]["refined"][0] == pytest.approx(190 / 3)
    assert result["light: not of training"]["distance"] == 0.4
    assert result["input material: nearer half"]["edits"] == 4
    assert result["input material: farther half"]["l2"][0] == pytest.approx(275)
    assert breakdowns.distance_table(edits, NO_PICTURES, {"lights": {}, "materials": {}}) is None


def test_the_rows_of_shapes_have_normals_and_the_difference_of_their_ends(edits):
    pictures = [
        {
            "shape": shape,
            "light": "city",
            "materials": ["wax"],
            "methods": {OURS: {"normals": {"mean_deg": degrees}, "light": {"irradiance": 0.2}}},
        }
        for shape, degrees in (("a", 10), ("a", 14), ("b", 20), ("c", 30))
    ]
    known = {"shapes": {"a": 0.0, "b": 20.0, "c": 40.0}}
    table = breakdowns.distance_table(edits, Rows(pictures, "materials"), known)
    result = cells(table)
    assert result["shape: of training"]["normals"][0] == 12
    assert result["shape: farther half"]["normals"] == [30, 30, 30]
    assert result["shape: farther half"]["distance"] == 40
    difference = result["shape: farther half − of training"]
    assert difference["normals"] == [18, 18, 18]  # a shape is drawn with both of its views
    assert difference["refined"][0] == pytest.approx((90 + 5) / 2 - (60 + 310) / 2)


def dome(centre=0.0, side=64):
    """Normals (side, side, 3) of a half sphere, 0 outside; centre: of its disc, along x."""
    y, x = np.mgrid[1 : -1 : side * 1j, -1 : 1 : side * 1j]
    x = x - centre
    z = np.sqrt(np.clip(0.6**2 - x**2 - y**2, 0, None))
    return np.where((z > 0)[..., None], np.stack([x, y, z], -1) / 0.6, 0)


def test_the_same_view_is_no_distance_and_a_turned_one_is_its_angle():
    view = distances.raster(dome())
    assert distances.mean_angles(view, view[None])[0] == pytest.approx(0, abs=1e-3)
    turn = np.radians(20)
    about_y = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )
    # a direction at the angle a to the axis moves by less than the turn
    turned = distances.raster(dome() @ about_y.T)
    (angle,) = distances.mean_angles(view, turned[None])
    assert 12 < angle < 20
    assert distances.mean_angles(view, np.zeros((1, *view.shape)))[0] == distances.ALONE
    assert (
        distances.mean_angles(np.zeros_like(view), np.zeros((1, *view.shape)))[0] == distances.ALONE
    )


def test_the_nearest_shape_is_nearest_over_all_views_and_not_by_another_for_each():
    a, b = (distances.raster(dome(centre)) for centre in (-0.3, 0.3))
    middle = distances.raster(dome())
    training = {"left": np.stack([a]), "right": np.stack([b]), "both": np.stack([middle, middle])}
    one = distances.shape_distances({"x": [a]}, training)
    assert one["x"] == pytest.approx(0, abs=1e-3)
    two = distances.shape_distances({"x": [a, b]}, training)["x"]
    each = distances.mean_angles(a, np.stack([a, b, middle]))
    assert two == pytest.approx(min(each[1] / 2, each[2]), abs=0.1)
    assert distances.shape_distances({"x": [a, b]}, training, {"x"}) == {"x": 0.0}
    assert distances.shape_distances({"x": [a]}, {}) == {}


def test_training_shapes_are_those_that_the_weights_saw(tmp_path, rng):
    entries = [matte("dark", 0.1)]
    store = synthetic.write_dataset(tmp_path, entries, rng, size=32, seeds=1, noise=0.0)
    synthetic.add_shape(store, "cube:1", "test")
    dataset = store.dataset()
    assert set(distances.training_shapes(tmp_path, None)) == {"sphere"}
    lists = seen.make_seen(
        {"shapes": [dataset.shapes["cube:1"].hash], "materials": [], "lights": []}
    )
    known = distances.training_shapes(tmp_path, lists)
    assert set(known) == {"cube:1"} and known["cube:1"].shape[1:] == (16, 16, 3)
    nothing = seen.make_seen({"shapes": [], "materials": [], "lights": []})
    with pytest.raises(InputError, match="shapes that the weights were trained on, found none"):
        distances.training_shapes(tmp_path, nothing)
    assert distances.training_shapes(None, lists) == {}
    records = Records(tmp_path)
    tested = distances.rasters(records, records.records)
    assert distances.shape_distances(tested, known)["sphere"] >= 0


def test_a_turned_training_map_is_of_training_and_others_are_farther_the_less_alike(rng):
    w, _ = envmap.directions(64, 128)

    def lamp(height):
        towards = np.array([np.sqrt(1 - height**2), height, 0.0])
        return (0.1 + np.exp(8 * (w @ towards - 1)))[..., None] * np.ones(3)

    noise = rng.random((64, 128, 3))
    maps = {"turned": envmap.roll(lamp(0.3), 37), "near": lamp(0.5), "far": lamp(-0.9)}
    result = distances.light_distances(maps, [lamp(0.3), noise])
    assert result["turned"] == 0
    assert 0 < result["near"] < result["far"]
    assert distances.light_distances(maps, []) == {}


def test_measured_maps_that_weights_saw_and_did_not_validate_on_are_training_maps(tmp_path):
    measured = measured_lights.load_all()
    names = ("blender_forest", "pmndrs_sky", "blender_courtyard")
    lists = seen.make_seen(
        {"shapes": [], "materials": [], "lights": [seen.map_hash(measured[n]) for n in names]}
    )
    run = {"run": {"data": {"validation_lights": ["blender_courtyard"]}}}
    expected = {seen.map_hash(measured[name]) for name in names[:2]}
    known = distances.training_maps(None, run, lists)
    assert {seen.map_hash(L) for L in known} == expected
    # the file of these maps has the columns of a file, and its names must not hide the true maps
    known = distances.training_maps(measured_lights.MAPS, run, lists)
    assert {seen.map_hash(L) for L in known} == expected
    assert distances.training_maps(None, run, None) == []


def test_a_training_label_has_no_distance(rng):
    label = np.log(rng.random(108) + 0.1)
    training = np.stack([label, label + 0.5])
    result = distances.material_distances({"same": label, "other": label + 0.2}, training)
    assert result["same"] == 0 and result["other"] > 0
    assert distances.material_distances({"same": label}, None) == {}
