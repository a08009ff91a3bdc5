"""The least error of functions of a label's two angles, and the tables of principled materials."""

import numpy as np
import pytest

from learn.experiments.editing import principled_fit as experiment
from shaders import principled_fit
from shaders.principled import PrincipledMaterial, ggx, lambert
from shaders.samples import held_out_samples

COAT = PrincipledMaterial((0.9, 0.9, 0.9), roughness=0.6, coat=1.0, coat_roughness=0.3)


def test_a_matte_material_is_a_function_of_both_angles_and_a_coated_one_is_not():
    samples = held_out_samples()
    assert experiment.least_error(lambert((0.7, 0.3, 0.1)), samples) < 1e-3
    least = experiment.least_error(COAT, samples)
    assert 2e-3 < least < principled_fit.fit(COAT).error


def test_smooth_metals_leave_error_to_the_lobes_and_hardly_any_to_the_angles():
    metal = ggx(0.8, 0.1)
    assert experiment.least_error(metal, held_out_samples()) < 0.3 * principled_fit.fit(metal).error


def test_a_quantiles_interval_holds_it_and_narrows_with_materials():
    rng = np.random.default_rng(1)
    few, many = rng.normal(size=20), rng.normal(size=2000)
    for values in (few, many):
        middle, low, high = experiment.quantile(values, 0.5)
        assert low <= middle <= high
        assert middle == pytest.approx(np.median(values))
    spans = [np.ptp(experiment.quantile(values, 0.9)[1:]) for values in (few, many)]
    assert spans[1] < 0.5 * spans[0]


def test_ranges_share_no_value_and_leave_none_out():
    for _, _, edges in experiment.RANGES.values():
        for value in (*edges, *np.linspace(edges[0], edges[-1], 7)):
            inside = [experiment._within(value, edges, k) for k in range(len(edges) - 1)]
            assert sum(inside) == 1, (edges, value)
