"""Claims of shaders.mixture: interpolation as Cycles' colour ramps do it, exact storage, refusal of
what cannot be rendered.
"""

import numpy as np
import pytest

from shaders import closures
from shaders.mixture import MAX_STOPS, Mixture, ramp


def some_mixture(rng, stops=(0, 3, 40, 41, 200, 250)):
    stops = np.array(stops) / 255
    shape = len(stops), 3
    return Mixture(
        ("diffuse", "ggx", "sheen"),
        stops,
        rng.uniform(-3, -0.2, shape),
        rng.uniform(-0.1, 0.3, shape),
        rng.uniform(0, 2, (*shape, 3)),
    )


def test_a_lambert_mixture_is_albedo_over_pi():
    f = Mixture.lambert([0.2, 0.5, 0.9]).evaluate(np.array([0.1, 0.9]), 0.5, 0.8, 0.9)
    np.testing.assert_allclose(f, np.array([[0.2, 0.5, 0.9]] * 2) / np.pi, rtol=1e-15)


def test_stops_on_the_ramps_table_are_kept_exactly(rng):
    mixture = some_mixture(rng)
    for values, result in zip(
        (mixture.log_alpha, mixture.tilt, mixture.weights),
        mixture.at(1 - mixture.stops),
        strict=True,
    ):
        np.testing.assert_allclose(result, values, atol=1e-12)  # rounding of 1 − (1 − x) times 255


def test_between_stops_on_the_table_values_are_linear(rng):
    mixture = some_mixture(rng)
    facing = (mixture.stops[2:5:2] + mixture.stops[3:6:2]) / 2
    expected = (mixture.weights[2:5:2] + mixture.weights[3:6:2]) / 2
    np.testing.assert_allclose(ramp(mixture.stops, mixture.weights, facing), expected, rtol=1e-9)


def test_off_the_table_a_stop_is_cut_as_cycles_cuts_it():
    stops, values = np.array([0.0, 100.5 / 255, 1.0]), np.array([0.0, 1.0, 0.0])
    # Cycles sees only the entries 100 and 101, each just below the peak, and draws a line between
    # them
    left, right = 100 / 100.5, 1 - 0.5 / 154.5
    assert ramp(stops, values, np.array([100.5 / 255]))[0] == pytest.approx(
        (left + right) / 2, rel=1e-12
    )


def test_beyond_the_last_stop_the_ramp_is_constant(rng):
    mixture = some_mixture(rng)
    np.testing.assert_allclose(
        ramp(mixture.stops, mixture.tilt, np.array([1.0]))[0], mixture.tilt[-1], rtol=1e-12
    )


def test_a_mixture_is_the_weighted_sum_of_its_closures(rng):
    mixture = some_mixture(rng)
    v, c = 4, (0.6, 1 - mixture.stops[4], 0.8, 0.7)
    expected = sum(
        mixture.weights[v, k]
        * closures.evaluate(
            kind, np.exp(mixture.log_alpha[v, k]), mixture.tilt[v, k], *map(np.array, c)
        )
        for k, kind in enumerate(mixture.kinds)
    )
    np.testing.assert_allclose(mixture.evaluate(*c), expected, rtol=1e-9)


def test_json_keeps_a_mixture_to_the_digits_asked_for(rng):
    mixture = some_mixture(rng)
    exact, short = Mixture.from_json(mixture.to_json(17)), Mixture.from_json(mixture.to_json(5))
    assert exact.kinds == mixture.kinds
    for name in ("stops", "log_alpha", "tilt", "weights"):
        np.testing.assert_array_equal(getattr(exact, name), getattr(mixture, name))
        np.testing.assert_allclose(getattr(short, name), getattr(mixture, name), rtol=5e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": np.zeros((2, 1, 3))}, r"mixture.weights: expected shape \(1, 1, 3\)"),
        ({"log_alpha": [[np.nan]]}, "mixture.log_alpha: expected finite numbers, found nan"),
        ({"kinds": ("glass",)}, "mixture.kinds: expected names among diffuse, .* found .*glass"),
        ({"stops": [1.5]}, r"mixture.stops: expected 1 to 32 ascending facings in \[0, 1\]"),
        ({"weights": np.full((1, 1, 3), -0.5)}, "mixture.weights: expected values ≥ 0, found -0.5"),
    ],
)
def test_what_cycles_cannot_render_is_refused(change, message):
    parts = {
        "kinds": ("ggx",),
        "stops": [0.0],
        "log_alpha": [[-1.0]],
        "tilt": [[0.0]],
        "weights": np.ones((1, 1, 3)),
    }
    with pytest.raises(ValueError, match=message):
        Mixture(**{**parts, **change})


def test_more_stops_than_a_colour_ramp_holds_are_refused():
    stops = np.linspace(0, 1, MAX_STOPS + 1)
    n = len(stops)
    with pytest.raises(ValueError, match="a colour ramp holds no more"):
        Mixture(("diffuse",), stops, np.zeros((n, 1)), np.zeros((n, 1)), np.ones((n, 1, 3)))
