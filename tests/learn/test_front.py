"""The chart's front: which setting keeps an error in the least time, judged over all cases."""

import statistics

from learn.experiments import chart_drawing, pareto_front


def rows():
    """auto: 2 s, right everywhere; quick: 1 s, right in most cases; rough: 0.1 s, never right."""
    result = []
    for case, error in enumerate((1e-4, 2e-4, 0.5)):
        for method, seconds, wrong in (
            ("auto", 2.0, 1e-4),
            ("quick", 1.0, error),
            ("rough", 0.1, 0.3),
        ):
            times = {"seconds": seconds, "forward": 0.3 * seconds}
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
    by_median = {
        line[0]: line[1:] for line in pareto_front.front(rows(), "near", "error", statistics.median)
    }
    by_worst = {line[0]: line[1:] for line in pareto_front.front(rows(), "near", "error", max)}
    assert by_median[1e-3] == ("quick", 1.0, 2.0)
    assert by_worst[1e-3] == ("auto", 2.0, 2.0)


def test_levels_that_nothing_reaches_are_left_out():
    assert min(line[0] for line in pareto_front.front(rows(), "near", "error", max)) == 1e-4


def test_the_page_says_where_auto_is_not_the_fastest(tmp_path):
    chart_drawing.write(
        rows(),
        {"command": "work-precision", "commit": "none", "date": "today", "machine": "one"},
        tmp_path,
    )
    page = (tmp_path / "chart.html").read_text()
    assert "<td>0.001<td>quick<td>1000.0<td>2000.0<td>auto<td>2000.0<td><b>2000.0</b>" in page
    assert (
        len((tmp_path / "chart.csv").read_text().splitlines()) == 2 + 9
        and (tmp_path / "chart.png").stat().st_size > 1000
    )
