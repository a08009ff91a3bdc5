"""What direct light at few points misses of that at many."""

import argparse

from factory.render.estimators import closed_form
from factory.render.estimators.renderer import STANDARD
from factory.render.validation import error_of_points


def test_smaller_limits_leave_smaller_errors():
    options = argparse.Namespace(size=32, shots=2, seed=5, meshes=None, finest=0.3)
    rows = error_of_points.measure(options)
    assert len(rows) == 2
    for row in rows:
        errors = [each["error"] for each in row["limits"]]
        assert errors[0] > 2 * errors[2] and errors[0] > errors[1] >= errors[2] >= errors[3]
        # grids interleave, so that their mean is better than that of random ones
        assert errors[0] < row["limits"][0]["differences"]


def test_the_page_says_how_errors_compare_with_differences():
    def row(shape, errors, sampled=False):
        limits = [
            {"limit": limit, "error": error, "differences": 10.0, "seconds": 1.5}
            for limit, error in zip(error_of_points.LIMITS, errors, strict=True)
        ]
        named = {"shape": shape, "material": "steel", "light": "city"}
        return {**named, "pixels": 9, "sampled": sampled, "limits": limits}

    result = {"command": "command", "commit": "1", "date": "today", "machine": "one", "size": 64}
    rows = [row("cube", (2.0, 1.0, 4.0, 0.1)), row("blob", (4.0, 3.0, 0.2, 0.1))]
    page = error_of_points.report({**result, "finest": 0.3, "rows": rows})
    assert "| no | first points | 2 | 0.300 | 0.100 | 0.300 | 0.390 | 0.400 | 1.50 |" in page
    assert "| yes |" not in page
    worst = page.split("differences |\n|---|---|---|---|\n")[1].splitlines()
    assert worst[0] == "| cube, steel, city | 5 | 4.00 | 10.00 |"


def test_the_constants_are_those_of_a_small_frame():
    known = closed_form.error_per_difference(True, STANDARD)
    assert (known.error, known.standard_error) == closed_form.LEFT[True]
