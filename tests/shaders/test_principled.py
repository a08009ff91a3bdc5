"""Claims of shaders.principled: energy, reciprocity, limits that are known, ranges; and of
shaders.principled_fit: labels close to their materials, equal channels equal.
"""

import numpy as np
import pytest

from shaders import closures
from shaders.principled import PrincipledMaterial, dielectric, ggx, lambert
from tests.shaders.test_closures import cosines, directions

MATERIALS = {
    "matte": lambert((0.7, 0.3, 0.2)),
    "white": PrincipledMaterial((1.0, 1.0, 1.0), roughness=0.3, specular=1.0),
    "rough white": PrincipledMaterial((1.0, 1.0, 1.0), roughness=1.0),
    "metal": ggx((1.0, 0.8, 0.4), 0.3),
    "rough metal": ggx(1.0, 0.9),
    "coated": PrincipledMaterial((1.0, 1.0, 1.0), coat=1.0, coat_roughness=0.2),
    "coated metal": PrincipledMaterial((1.0, 1.0, 1.0), metallic=1.0, coat=1.0, coat_roughness=0.8),
    "velvet": PrincipledMaterial((1.0, 1.0, 1.0), sheen=1.0, sheen_roughness=0.3),
    "all": PrincipledMaterial(
        (1.0, 1.0, 1.0), metallic=0.5, sheen=1.0, coat=1.0, coat_roughness=0.5, specular=1.0
    ),
}


def random_lights(rng, cos_o, count=40_000):
    """Cosines of cosine-distributed lights: the mean of π f over them is the albedo."""
    azimuth, square = rng.uniform(0, 2 * np.pi, count), rng.uniform(size=count)
    radius = np.sqrt(square)
    w_i = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - square)], -1)
    w_o = np.broadcast_to([np.sqrt(1 - cos_o**2), 0.0, cos_o], w_i.shape)
    return cosines(np.array([0.0, 0.0, 1.0]), w_i, w_o)


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("theta_o", [3.0, 45.0, 70.0, 84.0])
def test_no_material_reflects_more_light_than_it_receives(name, theta_o, rng):
    values = np.pi * MATERIALS[name].evaluate(*random_lights(rng, np.cos(np.radians(theta_o))))
    albedo, error = values.mean(0), values.std(0) / np.sqrt(len(values))
    assert (albedo <= 1 + 3 * error).all() and (values >= 0).all()


@pytest.mark.parametrize("name", MATERIALS)
def test_light_and_view_may_be_exchanged(name, rng):
    cos_i, cos_o, cos_h, cos_d = cosines(*directions(rng))
    there = MATERIALS[name].evaluate(cos_i, cos_o, cos_h, cos_d)
    back = MATERIALS[name].evaluate(cos_o, cos_i, cos_h, cos_d)
    np.testing.assert_allclose(there, back, rtol=1e-12)


def test_a_matte_material_is_lamberts_and_a_metal_is_schlick_times_ggx(rng):
    each = cosines(*directions(rng))
    color = np.array([0.7, 0.3, 0.2])
    np.testing.assert_allclose(
        lambert(color).evaluate(*each), np.broadcast_to(color / np.pi, (200, 3)), rtol=1e-12
    )
    f0 = np.array([0.9, 0.6, 0.3])
    fresnel = f0 + (1 - f0) * ((1 - each[3]) ** 5)[:, None]
    np.testing.assert_allclose(
        ggx(f0, 0.4).evaluate(*each), fresnel * closures.ggx(0.16, *each)[:, None], rtol=1e-12
    )


def test_a_specular_level_of_one_half_reflects_four_percent_straight_on():
    f = PrincipledMaterial((0.0, 0.0, 0.0), roughness=0.5).evaluate(*np.ones((4, 1)))
    np.testing.assert_allclose(f, 0.04 / (4 * np.pi * 0.25**2), rtol=1e-12)  # D/4 at the peak
    np.testing.assert_allclose(dielectric(0.04, np.array([1.0, 0.0])), [0.04, 1.0])


def test_a_coat_darkens_what_lies_under_it(rng):
    each = cosines(*directions(rng))
    base = {"base_color": (0.5, 0.5, 0.5), "specular": 0.0}
    plain = PrincipledMaterial(**base).evaluate(*each)
    coated = PrincipledMaterial(**base, coat=1.0, coat_roughness=0.05).evaluate(*each)
    away = each[2] < 0.8  # far from the coat's highlight
    assert away.sum() > 10 and (coated < 0.95 * plain)[away].all()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"roughness": 1.1}, r"roughness: a number in \[0, 1\] expected, found 1.1"),
        ({"coat": -0.1}, "coat: "),
        ({"metallic": float("nan")}, "metallic: .*nan"),
        ({"base_color": (0.1, 0.2)}, "base_color: three numbers"),
        ({"base_color": (0.1, 0.2, 2.0)}, "base_color: a number"),
        ({"sheen_roughness": 0.0}, r"sheen_roughness: a number in \[0.1, 1\]"),
    ],
)
def test_numbers_out_of_range_are_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        PrincipledMaterial(**wrong)
