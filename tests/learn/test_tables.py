"""The evaluation's tables, from figures that are known: who counts, who is better, what is
judged.
"""

import numpy as np
import pytest

from learn.evaluation import layer_table, refinement_table, tables
from learn.evaluation.methods import OURS, OURS_REFINED

FAMILIES = {"brass": "metal", "chrome": "metal", "pink-felt": "fabric"}


def rows(figures, material="wanted"):
    """Rows of edits over three shapes and two materials. figures: {method: l2 of each of the
    six}.
    """
    names = [(shape, name) for shape in "abc" for name in ("brass", "felt")]
    result = []
    for i, (shape, name) in enumerate(names):
        methods = {
            method: {"l2": float(values[i])}
            for method, values in figures.items()
            if values[i] is not None
        }
        result.append({"shape": shape, "light": "city", material: [name], "methods": methods})
    return tables.Rows(result, material)


def cells(table):
    return {row["name"]: row["cells"] for row in table["rows"]}


def test_a_difference_is_decided_by_its_interval_and_not_by_its_mean():
    ours = [10, 20, 30, 40, 50, 60]
    mixed, other = (
        [l2 + by for l2, by in zip(ours, 3 * bys, strict=True)] for bys in ((9, -8), (-9, 8))
    )
    known = {
        OURS: ours,
        "worse": [2 * x for x in ours],
        "better": [0.5 * x for x in ours],
        "mixed": mixed,
        "other mixed": other,
    }
    result = cells(tables.difference_table(rows(known)))
    assert result[f"{OURS} − worse"]["verdict"] == "better"
    assert result[f"{OURS} − worse"]["ratio"] == pytest.approx([0.5] * 3)
    assert result[f"{OURS} − worse"]["won"] == 1
    assert result[f"{OURS} − better"]["verdict"] == "worse"
    assert result[f"{OURS} − better"]["difference"][0] == pytest.approx(17.5)
    assert result[f"{OURS} − mixed"]["verdict"].startswith("undecided")
    # better in the mean, and yet
    assert result[f"{OURS} − mixed"]["difference"][0] == pytest.approx(-0.5)
    assert result[f"{OURS} − mixed"]["won"] == 0.5
    assert result[f"{OURS} − other mixed"]["verdict"].startswith("undecided")


def test_a_difference_is_of_the_edits_that_both_made():
    result = cells(
        tables.difference_table(
            rows({OURS: [10, 10, 10, 10, 10, 10], "half": [20, None, 20, None, 20, 500]})
        )
    )
    assert result[f"{OURS} − half"]["won"] == 1
    assert result[f"{OURS} − half"]["ratio"][0] == pytest.approx(40 / 560)


def test_ours_is_compared_with_ours_refined_once():
    result = cells(tables.difference_table(rows({OURS: [10] * 6, OURS_REFINED: [5] * 6})))
    assert list(result) == [f"{OURS_REFINED} − {OURS}"]


def test_what_refinement_takes_off_is_told_by_light_shape_and_family():
    of = rows({OURS: [100, 10, 100, 10, 100, 1000], OURS_REFINED: [50, 5, 50, 20, 50, 10]})
    for row, light in zip(of.rows, ("city", "city", "city", "sky", "sky", "sky"), strict=True):
        row |= {
            "light": light,
            "category": "chair",
            "wanted": ["brass" if row["wanted"] == ["brass"] else "pink-felt"],
        }
    result = cells(tables.gains_table(of, FAMILIES))
    assert list(result) == [
        "all edits",
        "light: city",
        "light: sky",
        "shape: chair",
        "into: fabric",
        "into: metal",
    ]
    assert [result[name]["edits"] for name in result] == [6, 3, 3, 6, 3, 3]
    assert (
        result["into: metal"]["ratio"] == pytest.approx([0.5] * 3)
        and result["into: metal"]["won"] == 1
    )
    every = result["all edits"]
    assert (every["mean"], every["mean_after"]) == pytest.approx((220, 185 / 6))
    assert (every["median"], every["median_after"]) == pytest.approx((100, 35))
    assert (every["geometric"], every["geometric_after"]) == pytest.approx(
        (1e11 ** (1 / 6), 1.25e8 ** (1 / 6))
    )
    assert every["won"] == pytest.approx(5 / 6) and every["ratio"][0] == pytest.approx(185 / 1320)


def test_regions_of_several_families_are_one_row():
    of = rows({OURS: [100] * 6, OURS_REFINED: [50] * 6})
    for row, expected in zip(
        of.rows, 3 * (["brass", "chrome"], ["brass", "pink-felt"]), strict=True
    ):
        row |= {"light": "city", "category": "chair", "wanted": expected}
    of.rows[5]["wanted"] = ["mine"]
    result = {
        name: row["edits"]
        for name, row in cells(tables.gains_table(of, FAMILIES)).items()
        if name.startswith("into")
    }
    assert result == {"into: metal": 3, "into: several families": 2, "into: of no known family": 1}


def test_without_refined_edits_there_is_no_such_table():
    assert tables.gains_table(rows({OURS: [10] * 6}), FAMILIES) is None


def refined(before, after, started, ended, seconds, finite=True):
    return {
        "shape": "a",
        "light": "city",
        "materials": ["brass"],
        "methods": {
            OURS: {"rendered_all": {"l2": started}},
            OURS_REFINED: {
                "rendered_all": {"l2": ended},
                "refinement": {
                    "before": before,
                    "after": after,
                    "seconds": seconds,
                    "finite": finite,
                },
            },
        },
    }


def test_refinements_that_end_above_their_start_or_are_not_finite_are_counted():
    result = [
        refined(1.0, 0.5, 100.0, 40.0, 2.0),
        refined(1.0, 1.01, 300.0, 310.0, 3.0),
        refined(2.0, 2.0, 200.0, 100.0, 9.0, finite=False),
    ]
    (row,) = refinement_table.refinement_table(tables.Rows(result, "materials"))["rows"]
    report = row["cells"]
    assert (report["starts"], report["above"], report["not_finite"], report["worse_l2"]) == (
        3,
        1,
        1,
        1,
    )
    assert (report["energy"], report["energy_after"]) == (1.0, 1.01)
    assert (report["l2"], report["l2_after"], report["drop"]) == (
        200.0,
        100.0,
        0.5,
    )  # medians, not means
    assert (report["seconds"], report["slowest"]) == (3.0, 9.0)


def test_starts_of_several_methods_are_counted_together():
    first, second = refined(1.0, 0.5, 100.0, 40.0, 2.0), refined(1.0, 2.0, 50.0, 60.0, 1.0)
    other = {
        name.replace(OURS, "Baseline 2"): figures for name, figures in second["methods"].items()
    }
    result = cells(
        refinement_table.refinement_table(
            tables.Rows([first | {"methods": first["methods"] | other}], "materials")
        )
    )
    assert set(result) == {OURS_REFINED, "Baseline 2, refined", "all initialisations"}
    assert (result["all initialisations"]["starts"], result["all initialisations"]["above"]) == (
        2,
        1,
    )
    assert (result[OURS_REFINED]["above"], result["Baseline 2, refined"]["above"]) == (0, 1)
    assert (result["all initialisations"]["l2"], result["all initialisations"]["l2_after"]) == (
        75.0,
        50.0,
    )


def edit(shape, expected, net, fit, node_fit=2.0, truth=None):
    layer = {"l2": 9.0, "l2_inner": 3.0, "node_fit": node_fit}
    known = (
        {} if net is None else {"net_inner": net, "net_error": 0.3, "fit_here": fit, "rest": 0.5}
    )
    return {
        "shape": shape,
        "light": "city",
        "wanted": [expected],
        "truth": truth or shape,
        "methods": {},
        "layer": layer | known,
    }


def test_the_layer_is_judged_where_noise_is_known_against_one_and_a_half_times_the_node_fit():
    result = [
        edit("a", "brass", 2.9, 1.0),
        edit("b", "felt", 3.1, 2.1),
        edit("c", "clay", None, None),
        edit("d", "wax", 0.1, 1.0),
    ]
    report = cells(layer_table.layer_table(tables.Rows(result, "wanted")))
    assert (report["brass"]["within"], report["brass"]["within_here"]) == ("yes", "no")
    assert (report["felt"]["within"], report["felt"]["within_here"]) == ("no", "yes")
    assert "within" not in report["clay"] and "within_here" not in report["clay"]
    assert (report["all"]["truths"], report["all"]["judged"]) == (4, 3)
    assert (report["all"]["within"], report["all"]["within_here"]) == ("2 of 3", "2 of 3")
    assert report["all"]["net_inner"] == pytest.approx((2.9 + 3.1 + 0.1) / 3)
    assert (report["brass"]["l2"], report["brass"]["l2_inner"], report["brass"]["fit_here"]) == (
        9.0,
        3.0,
        1.0,
    )


def test_edits_that_share_a_truth_judge_the_layer_once():
    thrice = [
        edit("a", "brass", 1.0, 1.0, truth="x"),
        edit("a", "brass", 1.0, 1.0, truth="x"),
        edit("b", "brass", 4.0, 1.0, truth="y"),
    ]
    report = cells(layer_table.layer_table(tables.Rows(thrice, "wanted")))["brass"]
    assert (report["truths"], report["judged"]) == (2, 2)
    assert report["net_inner"] == pytest.approx(2.5)
    assert report["net_error"] == pytest.approx(0.3 / np.sqrt(2))


def test_a_mean_leaves_out_missing_figures_and_the_table_a_column_that_all_rows_lack():
    result = tables.by_method(
        rows({OURS: [10, None, 10, None, 40, None]}), "t", "n", [((), tables.PICTURE, "")]
    )
    assert [column["key"] for column in result["columns"]] == ["l2"]
    assert cells(result)[OURS]["l2"][0] == pytest.approx(20)
    assert tables.by_method(rows({}), "t", "n", [((), tables.PICTURE, "")]) is None


def test_a_row_that_only_repeats_what_it_took_from_another_is_left_out():
    figures = {
        OURS: [10] * 6,
        f"constant light, normals of {OURS}": [10] * 6,
        f"true light, normals of {OURS}": [9] * 6,
    }
    result = tables.by_method(rows(figures), "t", "n", [((), tables.PICTURE, "")])
    assert list(cells(result)) == [OURS, f"true light, normals of {OURS}"]


def test_intervals_are_over_whole_shapes_and_materials():
    one_shape_differs = rows({OURS: [0, 0, 0, 0, 90, 90]})
    mean, low, high = one_shape_differs.cell(OURS, ("l2",))
    assert mean == pytest.approx(30)
    assert low == 0 and high == 90  # draws without that shape, and of nothing else, come up
    within = one_shape_differs.values(OURS, ("l2",))
    np.testing.assert_array_equal(one_shape_differs.draws(within > 0).sum(1) > 0, True)
