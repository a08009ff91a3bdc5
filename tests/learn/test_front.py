"""The chart: which setting keeps an error in the least time over all cases; shapes and rivals."""

import json

import numpy as np
import pytest

from learn.experiments.__main__ import COMMANDS
from learn.experiments.layer import (
    chart_cases,
    chart_drawing,
    chart_measurement,
    chart_shapes,
    eager_sum,
    pareto_front,
    torch_rival,
    work_precision,
)
from manifests import cli
from manifests import materials as catalogue


def rows():
    """auto: 2 s, right everywhere; quick: 1 s, right in most cases; rough: 0.1 s, never right."""
    result = []
    for case, error in enumerate((1e-4, 2e-4, 0.5)):
        for method, seconds, wrong in (
            ("auto", 2.0, 1e-4),
            ("quick", 1.0, error),
            ("rough", 0.1, 0.3),
        ):
            # one case of three takes auto five times as long, and quick twenty times
            slow = {"auto": 5.0, "quick": 20.0}.get(method, 1.0) if case == 0 else 1.0
            times = {"seconds": slow * seconds, "forward": 0.3 * seconds}
            errors = {"error": wrong, "integral": wrong, "forward_error": wrong}
            result.append(
                {
                    "material": str(case),
                    "light": "sky",
                    "camera": "near",
                    "method": method,
                    "knob": "1",
                    "pixels": 9,
                }
                | times
                | errors
            )
    return result


def test_the_median_forgives_a_failure_and_the_worst_case_does_not():
    settings = pareto_front.summary(rows())
    by_median = pareto_front.front(settings, "near", "error", "median")
    by_worst = pareto_front.front(settings, "near", "error", "worst")
    assert by_median[1e-3] == ("quick", 1.0, 2.0)
    assert by_worst[1e-3] == ("auto", 2.0, 2.0)


def test_a_limit_on_times_counts_the_slowest_cases():
    settings = pareto_front.summary(rows())
    by_median = pareto_front.front(settings, "near", "error", "median")
    by_worst = pareto_front.front(settings, "near", "error", "median", time="worst")
    assert by_median[1e-3].method == "quick"
    assert by_worst[1e-3] == ("auto", 10.0, 10.0)
    by_ninety = pareto_front.points(settings, "near", "error", "worst", time="90th percentile")
    assert 2.0 < by_ninety["auto"][0].seconds < 10.0


def test_levels_that_nothing_reaches_are_left_out():
    settings = pareto_front.summary(rows())
    assert min(pareto_front.front(settings, "near", "error", "worst")) == 1e-4


def test_the_page_says_where_auto_is_not_the_fastest():
    settings = pareto_front.summary(rows())
    report = {"measured": {"cases": 3}, "settings": settings, "further": {"cube, 9²": settings}}
    page = chart_drawing.page(report)
    assert "| 0.001 | quick | 1000.0 | 2000.0 | auto | 8400.0 | **8400.0** |" in page
    assert "## cube, 9²" in page
    figure = chart_drawing.chart(report)
    drawn = [axis for axis in figure.axes if axis.axison]
    assert len(drawn) == 2 * len(pareto_front.PAIRS) + 1
    titles = [axis.get_title() for axis in drawn]
    assert "near: worst error against the converged integral" in titles


@pytest.mark.parametrize("shape", chart_shapes.SHAPES)
def test_shapes_have_unit_normals_that_face_the_viewer_over_two_fifths_of_the_picture(shape):
    n = chart_shapes.SHAPES[shape](96)
    inside = (n != 0).any(-1)
    np.testing.assert_allclose(np.linalg.norm(n[inside], axis=-1), 1, atol=1e-12)
    assert n[inside][:, 2].min() > 0
    assert abs(inside.mean() - 0.4) < 0.01


def test_a_cube_shows_three_normals_and_a_cylinder_as_many_as_columns_and_its_lid():
    def distinct(shape):
        n = chart_shapes.SHAPES[shape](96)
        return len(np.unique(n[(n != 0).any(-1)].round(9), axis=0))

    assert distinct("cube") == 3
    columns = (chart_shapes.cylinder(96) != 0).any((0, 2)).sum()
    assert distinct("cylinder") == columns + 1


def test_plain_torch_is_compared_with_the_sum_and_its_time_is_scaled_to_all_pixels(monkeypatch):
    case = chart_measurement.Case(
        "pink-fabric",
        catalogue.find("pink-fabric").label,
        "sky",
        chart_cases.computed_lights()["sky"],
        "perspective",
        24,
    )
    batch, _ = case.batch()
    monkeypatch.setattr(torch_rival, "_time_once", lambda work: (1.0, work()))
    timed = torch_rival.time_formula(eager_sum.tune, batch)
    assert timed.seconds == timed.forward == len(batch.n) / len(timed.pick)
    errors = chart_measurement.truth_at(batch, timed.pick).errors(timed.radiance.numpy())
    assert errors["error"] < 1e-5 < errors["integral"]


def test_a_renewed_report_has_the_new_rows_of_the_methods_and_the_old_ones_of_all_others(
    tmp_path, capsys, monkeypatch
):
    """Without measuring: every setting takes as many seconds as the run is given."""
    taking = {"seconds": 77.0}

    def measured(cases, folder, with_torch, with_mitsuba, methods):
        errors = {"error": 0.1, "integral": 0.2, "forward_error": 0.1, "pixels": 25}
        return [
            case.names()
            | {"method": each.method, "knob": each.knob, "forward": 1.0}
            | taking
            | errors
            for case in cases
            for each in (chart_cases.leading_settings() if case.leading else chart_cases.settings())
            if methods is None or each.method in methods
        ]

    monkeypatch.setattr(chart_measurement, "measure_rows", measured)
    monkeypatch.setattr(chart_drawing, "chart", lambda report: None)  # which takes seconds
    words = ["--size", "8", "--material", "chrome", "--light", "sky", "--further", "cube"]

    def run(name, *further):
        command = ["work-precision", *words, *further, "--out", str(tmp_path / name)]
        return cli.main("learn.experiments", "", COMMANDS, command)

    def report(name):
        return json.loads((tmp_path / name / "report.json").read_text())

    path = tmp_path / "first" / "report.json"
    assert run("first") == 0
    taking["seconds"] = 5.0
    chosen = ("--renew", str(path), "--method", "quadrature", "exact")
    assert run("second", *chosen) == 0
    assert run("third", *chosen, "--camera", "orthographic") == 1
    assert run("fourth", "--method", "exact") == 1
    assert run("fifth", "--renew", str(path)) == 1
    errors = capsys.readouterr().err
    assert "a report of the same materials" in errors
    assert "--renew: expected it beside --method" in errors
    assert "--method: expected it beside --renew" in errors
    first, second = report("first"), report("second")
    assert second["renewed"]["kept"] == first["made_by"]
    for before, after in (
        (first["settings"], second["settings"]),
        *((first["further"][name], rows) for name, rows in second["further"].items()),
    ):
        assert [row["knob"] for row in before] == [row["knob"] for row in after]
        for row in after:
            is_new = row["method"] in ("exact", "quadrature")
            assert row["seconds"]["median"] == (5.0 if is_new else 77.0)
    page = (tmp_path / "second" / "report.md").read_text()
    assert "The rows of `exact` and `quadrature`" in page and first["made_by"]["commit"] in page
    # what both took before and take now, of both cameras
    assert page.count(" | 77000.0 | 5000.0 | 77000.0 | 5000.0 | ") == 4


def test_the_methods_that_can_be_renewed_are_those_of_the_chart():
    names = list(dict.fromkeys(each.method for each in chart_cases.settings()))
    assert list(work_precision.METHODS) == names
