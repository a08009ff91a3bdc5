"""Cycles, as the studio uses it, against formulas. Figures at full size: python -m
factory.render.validation.benchmark.
"""

import numpy as np
import pytest

pytestmark = pytest.mark.blender


def test_a_lit_texel_peaks_where_the_layer_says_for_any_view_and_rotation(studio, rng):
    from factory.render.validation import closed_forms

    figures = closed_forms.lit_texel(studio, rng, directions=64, samples=16)
    # .47° is the way from a pole texel's middle, which the layer takes, to its centre of area;
    # elsewhere it is below .16°
    assert figures["max_deg"] <= 0.5
    assert max(figures["degrees"][4:]) <= 0.2


def test_a_matte_sphere_agrees_with_the_dense_sum(studio):
    from factory.render.validation import closed_forms, reference

    figures = closed_forms.lambert(studio, reference.soft_light())
    assert abs(figures["relative_mean"]) <= 2e-3  # the limit; noise of this mean is 2e-4
    assert figures["largest_sigma"] <= 5.0  # of 9,000 values the largest is 4.0 by chance
    # 1: the difference is noise and nothing else; ± .02 by chance
    assert 0.9 < figures["rms_sigma"] < 1.1


def test_a_matte_sphere_agrees_under_a_measured_sky(studio, shared_data):
    from factory.render.validation import closed_forms
    from shaders import envmap

    sky = np.load(shared_data / "environments" / "env26_best_64x128_f16.npz")[
        "blender_city"
    ].astype(np.float32)
    figures = closed_forms.lambert(studio, envmap.unit_mean(np.maximum(sky, 0))[0])
    assert abs(figures["relative_mean"]) <= 2e-3
    assert figures["largest_sigma"] <= 5.0


@pytest.mark.parametrize(
    "name",
    ["diffuse", "sheen α .5"]
    + [
        f"{k} {a}"
        for k in ("ggx", "beckmann", "ashikhmin_shirley")
        for a in ("α 0.1", "α .15 tilt 0.3", "α .15 tilt -0.12")
    ],
)
def test_each_closure_in_cycles_is_its_closed_form(studio, name):
    from factory.render.validation import closed_forms

    _is_noise_only(
        closed_forms.closed_form(
            studio, closed_forms.SINGLE[name], samples=32, seeds=16, size=16, points=2048
        )
    )


def test_a_mixture_whose_widths_tilts_and_weights_follow_the_view_is_its_closed_form(studio):
    from factory.render.validation import closed_forms
    from shaders.mixture import Mixture

    stops = np.round(np.linspace(0, 1, 14) * 255) / 255
    log_alpha = np.log(np.stack([0 * stops + 1, 0.3 - 0.2 * stops, 0.05 + 0.1 * stops], axis=1))
    tilt = np.stack([0 * stops, 0.2 * stops, -0.1 * stops], axis=1)
    weights = np.stack(
        [
            np.outer(1 - stops, [0.3, 0.2, 0.1]),
            np.outer(0.2 + 0.5 * stops, [1, 0.5, 0.2]),
            np.outer(0.1 + 0.3 * stops, [1, 1, 1]),
        ],
        axis=1,
    )
    mixture = Mixture(("diffuse", "ggx", "beckmann"), stops, log_alpha, tilt, weights)
    _is_noise_only(
        closed_forms.closed_form(studio, mixture, samples=32, seeds=16, size=16, points=2048)
    )


@pytest.mark.parametrize("name", ["alum-bronze", "blue-rubber", "gold-paint", "chrome"])
def test_a_catalogued_material_in_cycles_is_its_closed_form(studio, name):
    from factory.render.validation import closed_forms
    from manifests.materials import load_catalogue

    _is_noise_only(
        closed_forms.closed_form(
            studio, load_catalogue()[name].mixture, samples=32, seeds=16, size=16, points=2048
        )
    )


def _is_noise_only(figures):
    # 1e-3 is the limit; at this size noise is added to it
    assert abs(figures["bias"]) <= 1e-3 + 2 * figures["bias_sigma"]
    assert abs(figures["bias"]) <= 4 * figures["bias_sigma"]  # the z-test of the mean
    # and of the residual: four standard deviations
    assert abs(figures["rms_sigma"] - 1) <= 4 * figures["rms_sigma_noise"]
    assert figures["rms_sigma_noise"] < 0.1  # the test has teeth


def test_perspective_pictures_agree_with_a_view_vector_a_pixel_and_not_with_one_for_all(studio):
    from factory.render.validation import closed_forms

    figures = closed_forms.perspective(studio, size=32)
    assert abs(figures["relative_mean"]) <= 1e-3
    assert figures["rms_sigma"] < 1.15
    assert figures["distant_rms_sigma"] > 3  # the test has teeth: view vectors matter at 40°
