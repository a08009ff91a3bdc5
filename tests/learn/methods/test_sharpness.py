"""Sharpness of lobes: its definition, and how its uses compare on measured materials."""

import numpy as np
import pytest
import torch

from learn.layer.display_method import method_for
from learn.methods import lobe_shapes, quadrature
from manifests import materials
from shaders.dsbrdf import lobe_sharpness
from shaders.spline import basis


@pytest.fixture(scope="module")
def controls():
    """{name: (3, 3, 2, 6)} of the built-in catalogue."""
    return {
        name: np.exp(np.asarray(material.label, float).reshape(3, 3, 2, 6))
        for name, material in materials.load_catalogue().items()
    }


def along_the_curve(m):
    """Sharpness (3, 3) of each channel and lobe, the largest over θ_d."""
    kappa, gamma = np.einsum("ksjb,tb->jkst", m, basis(np.linspace(0, np.pi / 2, 257)))
    return lobe_sharpness(np.minimum(kappa, 50.0), gamma).max(-1)


@pytest.mark.parametrize("kappa, gamma", [(1e-6, 3.0), (0.3, 40.0), (1.0, 300.0), (12.0, 5e3)])
def test_sharpness_is_the_power_of_the_cosine_by_which_a_lobe_falls_at_its_peak(kappa, gamma):
    log_c = -1e-6 / gamma
    fall = np.log(np.expm1(kappa * np.exp(gamma * log_c)) / np.expm1(kappa)) / log_c
    assert lobe_sharpness(np.array(kappa), np.array(gamma)) == pytest.approx(fall, rel=1e-4)


def test_numpy_and_torch_agree_on_sharpness():
    kappa, gamma = np.geomspace(1e-8, 50, 60), np.geomspace(0.1, 1e6, 60)
    tensors = torch.from_numpy(kappa), torch.from_numpy(gamma)
    assert lobe_sharpness(*tensors).numpy() == pytest.approx(lobe_sharpness(kappa, gamma))


def test_control_values_give_the_sharpness_along_the_curve(controls):
    """To the factors that docs/engines.md names: the curve lies between its control values."""
    ratios = [lobe_shapes.sharpness(m) / along_the_curve(m).max(0) for m in controls.values()]
    assert np.min(ratios) > 0.5 and np.max(ratios) < 1.6


def test_quadrature_chooses_by_the_sharpest_angle_of_a_lobe(controls):
    """To the factors that docs/engines.md names."""
    ratios = [
        quadrature.sharpness(torch.from_numpy(m)[None])[0].numpy() / along_the_curve(m)
        for m in controls.values()
    ]
    assert np.min(ratios) > 0.63 and np.max(ratios) < 1.001


def test_visible_narrow_lobes_are_displayed_by_the_integral(controls):
    shown = {
        name: method_for(torch.from_numpy(np.log(m)).float().reshape(108))
        for name, m in controls.items()
    }
    assert list(shown.values()).count("quadrature") == 101 and len(shown) == 151
    # γ is below 300 in delrin; its lobe is narrow because κ is large
    assert shown["delrin"] == "quadrature" and controls["delrin"][:, :, 1].max() < 300
