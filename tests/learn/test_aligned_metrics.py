"""Figures that forgive brightness, and lights on three spheres, against closed forms."""

import numpy as np
import pytest
import torch

from learn.metrics import light_probes
from learn.metrics.pictures import display_l2, l2_after_alignments
from shaders import envmap, frames

ELEVATION = np.radians(20)


@pytest.fixture
def truth(rng):
    return rng.random((20, 24, 3)) + 0.05


@pytest.fixture
def mask():
    inside = np.zeros((20, 24), bool)
    inside[3:17, 4:20] = True
    return inside


@pytest.mark.parametrize("factor", [0.13, 0.8, 3.7])
def test_a_picture_that_is_only_brighter_has_no_error_after_one_factor(truth, mask, factor):
    result = l2_after_alignments(factor * truth, truth, mask)
    assert result["l2_one_factor"] < 0.01 and result["l2_three_factors"] < 0.01
    assert result["l2_own_exposure"] < 1e-9
    assert display_l2(factor * truth, truth, mask) > 50


def test_a_picture_of_another_colour_needs_three_factors(truth, mask):
    result = l2_after_alignments(truth * [0.5, 1.0, 1.6], truth, mask)
    assert result["l2_three_factors"] < 0.01 < 100 < result["l2_one_factor"]
    assert result["l2_one_factor"] < display_l2(truth * [0.5, 1.0, 1.6], truth, mask)


def test_what_lies_outside_the_mask_moves_no_factor(truth, mask):
    picture = np.where(mask[..., None], 2 * truth, 7.0)
    assert l2_after_alignments(picture, truth, mask)["l2_one_factor"] < 0.01


def test_no_factor_makes_an_edit_worse(rng, truth, mask):
    for _ in range(5):
        picture = rng.random(truth.shape) ** 3
        result, l2 = l2_after_alignments(picture, truth, mask), display_l2(picture, truth, mask)
        assert result["l2_three_factors"] <= result["l2_one_factor"] <= l2


def test_a_constant_light_shows_each_spheres_own_reflectance():
    shown = light_probes.pictures(torch.ones(3, 64, 128), ELEVATION)
    np.testing.assert_allclose(shown["mirror"], 1, rtol=1e-5)
    np.testing.assert_allclose(shown["diffuse"], light_probes.DIFFUSE_ALBEDO, rtol=1e-3)
    # shadowing between facets takes a little off, more at grazing angles
    assert shown["silver"].max() < light_probes.SILVER_F0
    assert shown["silver"].min() > 0.8 * light_probes.SILVER_F0


def test_a_lamp_behind_the_camera_is_reflected_where_the_sphere_faces_the_viewer():
    view = frames.camera_from_light(ELEVATION).T @ [0.0, 0.0, 1.0]
    L = np.zeros((64, 128, 3))
    row, column = envmap.texel(view, 64, 128)
    L[row - 1 : row + 2, column - 1 : column + 2] = 1
    shown = light_probes.pictures(torch.from_numpy(L).movedim(-1, 0), ELEVATION)
    for name in light_probes.SPHERES:
        n = light_probes._normals(light_probes.SIZE)
        fine = light_probes._normals(light_probes.SIZE * light_probes.SUBPIXELS)
        whole = (
            fine[..., 2].reshape(light_probes.SIZE, light_probes.SUBPIXELS, light_probes.SIZE, -1)
            > 0
        ).all((1, 3))
        inside = n[(n[..., 2] > light_probes.RIM) & whole]
        brightest = inside[shown[name].sum(-1).argmax()]
        assert brightest[2] > np.cos(np.radians(5)), name
    # a matte surface that faces a small lamp: albedo/π times its solid angle
    _, solid_angle = envmap.directions(64, 128)
    lamp = solid_angle[row - 1 : row + 2, column - 1 : column + 2].sum()
    expected = light_probes.DIFFUSE_ALBEDO / np.pi * lamp
    assert shown["diffuse"].max() == pytest.approx(expected, rel=0.01)


def test_errors_of_scaled_and_coloured_pictures_are_those_of_the_formula(rng):
    truth = rng.random((50, 3)) + 0.1
    brighter = light_probes.errors(2 * truth, truth)
    assert brighter["rmse"] == pytest.approx(np.sqrt((truth**2).mean()))
    assert brighter["si_rmse"] == pytest.approx(0, abs=1e-12)
    assert brighter["angular_deg"] == pytest.approx(0, abs=1e-5)
    red, green = np.array([[1.0, 0.0, 0.0]]), np.array([[1.0, 1.0, 0.0]])
    coloured = light_probes.errors(red, green)
    assert coloured["angular_deg"] == pytest.approx(45)
    assert coloured["si_rmse"] == pytest.approx(np.sqrt(1 / 3))  # the green that red cannot make
    assert light_probes.errors(0 * red, green)["si_rmse"] == pytest.approx(np.sqrt(2 / 3))


def test_a_mirror_shows_a_lamp_where_its_normal_lies_between_lamp_and_viewer():
    view = frames.camera_from_light(ELEVATION).T @ [0.0, 0.0, 1.0]
    lamp = np.array([0.6, 0.8, 0.0])
    L = np.zeros((64, 128, 3))
    row, column = envmap.texel(lamp, 64, 128)
    L[row - 1 : row + 2, [column - 1, column, (column + 1) % 128]] = 1
    shown = light_probes.pictures(torch.from_numpy(L).movedim(-1, 0), ELEVATION)["mirror"].sum(-1)
    half = frames.camera_from_light(ELEVATION) @ ((lamp + view) / np.linalg.norm(lamp + view))
    size, parts = light_probes.SIZE, light_probes.SUBPIXELS
    n, fine = light_probes._normals(size), light_probes._normals(size * parts)
    whole = (fine[..., 2].reshape(size, parts, size, parts) > 0).all((1, 3))
    inside = n[(n[..., 2] > light_probes.RIM) & whole]
    assert inside[shown.argmax()] @ half > np.cos(np.radians(5))
