"""Claims of shaders.principled: energy, reciprocity, limits that are known, ranges; and of
shaders.principled_fit: labels close to their materials, equal channels equal.
"""

import numpy as np
import pytest

from shaders import closures, dsbrdf, principled, principled_fit
from shaders.principled import PrincipledMaterial, dielectric, ggx, lambert
from tests.support.bsdf_directions import cosines, directions

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
    # 1 %: the tables of the layers' albedos
    assert (albedo <= 1.01 + 3 * error).all() and (values >= 0).all()


@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.9])
@pytest.mark.parametrize("kind", ["ggx", "sheen"])
def test_the_tables_of_albedos_are_integrals(kind, alpha, rng):
    for theta_o in (10.0, 50.0, 80.0):
        each = random_lights(rng, np.cos(np.radians(theta_o)), 400_000)
        values = np.pi * principled.LOBES[kind](alpha, *each)
        error = values.std() / np.sqrt(len(values))
        table = sum(principled.albedos(kind, alpha, np.cos(np.radians(theta_o))))
        # light that arrives below the least cosine of the samples, and linear interpolation: 1 %
        assert table == pytest.approx(values.mean(), abs=4 * error + 0.01)


@pytest.mark.parametrize(
    "material",
    [
        MATERIALS["matte"],
        MATERIALS["metal"],
        MATERIALS["rough metal"],
        PrincipledMaterial((0.0, 0.0, 0.0), roughness=0.3, specular=1.0),
        PrincipledMaterial((0.0, 0.0, 0.0), specular=0.0, coat=1.0, coat_roughness=0.3),
        PrincipledMaterial((0.0, 0.0, 0.0), specular=0.0, sheen=1.0),
    ],
)
def test_light_and_view_may_be_exchanged_in_every_lobe(material, rng):
    cos_i, cos_o, cos_h, cos_d = cosines(*directions(rng))
    there = material.evaluate(cos_i, cos_o, cos_h, cos_d)
    back = material.evaluate(cos_o, cos_i, cos_h, cos_d)
    assert there.min() > 0
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
    assert away.sum() > 10 and (coated < 0.97 * plain)[away].all()


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


# What three lobes reach: a matte material is one of them; beside diffuse light, two follow a
# highlight; a metal's long tail needs all three. About a third above what was measured.
LIMITS = {
    "matte": (lambert((0.5, 0.5, 0.5)), 0.005),
    "plastic": (PrincipledMaterial((0.6, 0.03, 0.01), roughness=0.5), 0.045),
    "metal": (ggx((0.9, 0.6, 0.3), 0.3), 0.037),
    "smooth metal": (ggx(0.8, 0.1), 0.033),
    "rough metal": (ggx(0.8, 0.8), 0.05),
    "coat": (PrincipledMaterial((0.5, 0.1, 0.1), coat=1.0, coat_roughness=0.3), 0.06),
    "sheen": (PrincipledMaterial((0.3, 0.1, 0.1), roughness=0.9, specular=0.2, sheen=0.8), 0.03),
}


@pytest.mark.parametrize("name", LIMITS)
def test_a_label_is_as_close_as_three_lobes_allow(name):
    material, limit = LIMITS[name]
    result = principled_fit.fit(material)
    assert result.error < limit, result.views
    assert result.label.shape == dsbrdf.SHAPE
    assert (np.diff(result.label[:, :, 1].mean((0, 2))) >= 0).all()  # canonical order


def test_the_error_of_a_fit_is_that_of_its_label():
    material, _ = LIMITS["plastic"]
    result, samples = principled_fit.fit(material), principled_fit.held_out_samples()
    theta_d = np.arccos(samples.cos_d)
    f = np.stack(
        [
            dsbrdf.evaluate(np.exp(result.label), c, t)
            for c, t in zip(samples.cos_h, theta_d, strict=True)
        ]
    )
    reference = material.evaluate(*samples.cosines)
    weight = samples.measure[..., None]
    expected = (weight * abs(f - reference)).sum((1, 2)) / (weight * reference).sum((1, 2))
    np.testing.assert_allclose(result.views, expected, rtol=1e-9)


def test_equal_channels_have_equal_curves():
    label = principled_fit.label_of(PrincipledMaterial((0.2, 0.7, 0.2)))
    np.testing.assert_array_equal(label[0], label[2])
    assert (label[0] != label[1]).any()


def test_no_iteration_makes_a_channel_worse():
    material = PrincipledMaterial((0.7, 0.3, 0.1), roughness=0.4)
    samples = principled_fit.Samples(np.radians(principled_fit.VIEWS_DEG), 24, 4, 0.08)
    problem = principled_fit._Problem(samples, material.evaluate(*samples.cosines))
    state = problem.best(list(principled_fit.initial_labels(material)))
    for _ in range(6):
        after = problem.improved(state)
        assert (after.cost <= state.cost).all()
        state = after


@pytest.mark.parametrize("narrowest", [1e-3, 0.1, 1.0])
def test_samples_of_a_narrow_lobe_integrate_the_cosine_too(narrowest):
    samples = principled_fit.Samples(np.radians([5, 40, 70]), 120, 24, narrowest)
    np.testing.assert_allclose(samples.measure.sum(1), np.pi, rtol=1e-2)
