"""What the checks after each shot find. No Blender: pixels are made here."""

from types import SimpleNamespace

import numpy as np
import pytest

checks = pytest.importorskip("factory.render.checks")


@pytest.fixture
def picture(rng):
    return rng.random((32, 32, 3), dtype=np.float32)


@pytest.fixture
def geometry():
    mask = np.zeros((32, 32), bool)
    mask[8:24, 8:24] = True
    normals = np.zeros((32, 32, 3), np.float32)
    normals[mask] = [0.0, 0.6, 0.8]
    return SimpleNamespace(
        normals=normals,
        mask=mask,
        depth=np.zeros((32, 32), np.float32),
        segments=mask.astype(np.uint8),
    )


def test_a_good_shot_passes(picture, geometry):
    assert checks.picture_faults(picture, 0.25, geometry.mask.astype(np.float32)) == []
    assert checks.geometry_faults(geometry, 1) == []


def test_a_black_picture_passes():
    assert checks.picture_faults(np.zeros((8, 8, 3), np.float32)) == []


@pytest.mark.parametrize(
    ("value", "found"),
    [(np.nan, "1 other values"), (np.inf, "1 other values"), (-0.1, "found -0.1")],
)
def test_values_that_no_light_has_are_found(picture, value, found):
    picture[3, 4, 1] = value
    (line,) = checks.picture_faults(picture)
    assert found in line


def test_magenta_on_any_material_is_found_and_a_red_picture_is_not(picture):
    shading = picture[..., :1]
    assert "magenta" in checks.picture_faults(shading * np.float32([1, 0, 1]))[0]
    assert "magenta" in checks.picture_faults(shading * np.float32([0.2, 0, 0.7]))[0]
    assert checks.picture_faults(shading * np.float32([1, 0, 0])) == []


def test_a_picture_that_covers_less_than_its_geometry_is_found(picture, geometry):
    (line,) = checks.picture_faults(picture, 0.25, np.zeros((32, 32)))
    assert "expected coverage 0.2500" in line


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (lambda g: g.mask.fill(False), "empty mask"),
        (lambda g: g.normals.__imul__(0.99), "found lengths 0.9900"),
        (lambda g: g.segments.__imul__(3), "expected segments 1 to 1, found 3"),
        (lambda g: g.segments.fill(1), "segment 0 outside the mask"),
        (lambda g: g.depth.fill(np.nan), "finite normals and depth"),
    ],
)
def test_each_fault_of_geometry_is_found(geometry, spoil, found):
    spoil(geometry)
    assert any(found in line for line in checks.geometry_faults(geometry, 1))
