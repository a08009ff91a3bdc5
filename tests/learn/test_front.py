"""The chart's front: which setting keeps an error in the least time, judged over all cases."""

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
    settings = pareto_front.summary(rows())
    by_median = pareto_front.front(settings, "near", "error", "median")
    by_worst = pareto_front.front(settings, "near", "error", "worst")
    assert by_median[1e-3] == ("quick", 1.0, 2.0)
    assert by_worst[1e-3] == ("auto", 2.0, 2.0)


def test_levels_that_nothing_reaches_are_left_out():
    settings = pareto_front.summary(rows())
    assert min(pareto_front.front(settings, "near", "error", "worst")) == 1e-4


def test_the_page_says_where_auto_is_not_the_fastest():
    report = {"measured": {"cases": 3}, "settings": pareto_front.summary(rows())}
    page = chart_drawing.page(report)
    assert "| 0.001 | quick | 1000.0 | 2000.0 | auto | 2000.0 | **2000.0** |" in page
    assert len(chart_drawing.chart(report).axes) == 3
