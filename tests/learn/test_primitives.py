"""Primitives: a solid drawn from known parameters is found again from its mask and poor normals,
and an edit uses its normals, which refinement leaves as they are.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from learn.editing import decomposition
from learn.primitives import PRIMITIVES, fitting
from learn.primitives.solids import Ball, Box, Cylinder
from learn.refinement import PHOTOGRAPHS
from tests.support.known_ball import NETWORK, Knowing, label_of, lit, opened

SIDE = 96
# name: turn about y, x and z in degrees, sizes
KNOWN = {
    "box": ((35, 25, 5), (0.35, 0.5, 0.25)),
    "cylinder": ((0, 30, 10), (0.35, 0.45, 0.5)),
    "ball": ((0, 0, 30), (0.4, 0.65)),
}


def drawn(name, perspective=0.2):
    """Coverage and true normals of a known solid."""
    turns, sizes = KNOWN[name]
    R = Rotation.from_euler("zxy", turns[::-1], degrees=True).as_matrix()
    if name != "box":  # its own z, about which it is round, is upright in the picture
        R = R @ Rotation.from_euler("x", -90, degrees=True).as_matrix()
    known = fitting._Parameters(R, np.array(sizes), np.array([0.05, -0.03]), perspective)
    empty = fitting._Picture(np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE, 3)))
    coverage = fitting._coverage(fitting.SOLIDS[name], empty, known)
    return coverage, fitting._normals(fitting.SOLIDS[name], empty, known)


def angle(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


def blurred(n, coverage):
    """Normals as a network might predict them: smooth, and turned towards the viewer."""
    poor = gaussian_filter(n * (coverage >= 0.5)[..., None], (8, 8, 0))
    poor = poor + np.array([0, 0, 0.15])
    return poor / np.linalg.norm(poor, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", KNOWN)
def test_a_solid_is_found_again_from_its_mask_and_poor_normals(name):
    coverage, n = drawn(name)
    inside = coverage >= 0.5
    poor = blurred(n, coverage)
    fitted = fitting.fit_primitive(name, coverage, poor)
    before, after = (angle(each, n)[inside].mean() for each in (poor, fitted.normals))
    assert fitted.overlap > 0.97
    assert after < 0.5 * before and after < 8
    np.testing.assert_allclose(np.linalg.norm(fitted.normals[inside], axis=-1), 1, atol=1e-5)


@pytest.mark.parametrize("tilt", [30, -30])
def test_predicted_normals_decide_between_poses_of_one_outline(tilt):
    """A cylinder that leans towards a distant viewer has the outline of one that leans away."""
    solid, sizes = fitting.SOLIDS["cylinder"], np.array([0.4, 0.4, 0.5])
    R = Rotation.from_euler("x", tilt - 90, degrees=True).as_matrix()
    known = fitting._Parameters(R, sizes, np.zeros(2), 0.0)
    empty = fitting._Picture(np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE, 3)))
    coverage = fitting._coverage(solid, empty, known)
    n = fitting._normals(solid, empty, known)
    fitted = fitting.fit_primitive("cylinder", coverage, blurred(n, coverage))
    inside = coverage >= 0.5
    assert (n[inside][:, 1] * np.sign(tilt) > 0.86).mean() > 0.2  # an end is seen
    assert angle(fitted.normals, n)[inside].mean() < 8


def test_flat_is_one_direction_the_mean_of_the_predicted_normals():
    coverage, n = drawn("ball")
    tilted = n @ Rotation.from_euler("y", 20, degrees=True).as_matrix().T
    inside = coverage >= 0.5
    fitted = fitting.fit_primitive("flat", coverage, tilted)
    mean = tilted[inside].mean(0)
    np.testing.assert_allclose(
        fitted.normals[inside], fitted.normals[inside][:1].repeat(inside.sum(), 0)
    )
    assert angle(fitted.normals[inside][0], mean / np.linalg.norm(mean)) < 0.1


@pytest.mark.parametrize("name", PRIMITIVES)
def test_a_thing_of_a_few_thin_pixels_gets_normals_too(name):
    """Reduced, no pixel is covered by half."""
    coverage = np.zeros((128, 128))
    coverage[60:61, 40:90] = 0.6
    n = np.broadcast_to([0.0, 0.0, 1.0], (128, 128, 3))
    fitted = fitting.fit_primitive(name, coverage, n)
    assert np.isfinite(fitted.normals).all() and 0 <= fitted.overlap <= 1
    np.testing.assert_allclose(np.linalg.norm(fitted.normals, axis=-1), 1, atol=1e-5)


def test_an_unknown_primitive_is_refused():
    with pytest.raises(ValueError, match="teapot"):
        fitting.fit_primitive("teapot", np.ones((16, 16)), np.ones((16, 16, 3)))
    assert set(PRIMITIVES) == {"flat", *fitting.SOLIDS}


@pytest.mark.parametrize("solid", [Box(), Cylinder(), Ball()], ids=lambda s: type(s).__name__)
def test_normals_are_those_of_the_surface_where_the_ray_leaves_the_solid(solid):
    """Compared with a march along each ray through the solid's own inequality."""
    sizes = np.array([0.3, 0.5, 0.4])[: solid.count]
    R = Rotation.from_euler("xyz", (40, 20, 10), degrees=True).as_matrix()
    g = np.linspace(-0.2, 0.2, 9)
    xy = np.stack(np.meshgrid(g, g), -1).reshape(-1, 2)
    o = np.c_[xy, np.zeros(len(xy))] @ R
    d = np.broadcast_to(R[2], o.shape)
    t = np.linspace(1.5, -1.5, 30001)
    p = o[:, None] + t[:, None] * d[:, None]
    if isinstance(solid, Box):
        value = (np.abs(p) / sizes).max(-1)
    elif isinstance(solid, Ball):
        value = np.linalg.norm(p / sizes[[0, 0, 1]], axis=-1)
    else:
        low, high, half = sizes
        radius = (low + high) / 2 + (high - low) / (2 * half) * p[..., 2]
        value = np.maximum(np.hypot(p[..., 0], p[..., 1]) / radius, np.abs(p[..., 2]) / half)
    hit = p[np.arange(len(p)), (value <= 1).argmax(1)]
    n = solid.normals(o, d, sizes)
    # a surface's normal is at right angles to steps along the surface: compare with neighbours
    step = 0.4 / 8
    for axis in (0, 1):
        grid = hit.reshape(9, 9, 3)
        move = np.diff(grid, axis=axis)
        own = n.reshape(9, 9, 3)
        first, second = (own[:-1], own[1:]) if axis == 0 else (own[:, :-1], own[:, 1:])
        same = (first * second).sum(-1) > 0.98
        lift = np.abs((move * (first + second) / 2).sum(-1))
        assert same.mean() > 0.4 and lift[same].max() < 0.02 * step
    assert ((n @ R[2]) > 0).all()


def test_an_edit_has_the_shape_that_was_named():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    photo = opened(radiance, inside.astype(np.int64))
    settings = replace(PHOTOGRAPHS, levels=PHOTOGRAPHS.levels[:1])
    free = decomposition.decompose(photo, Knowing(label), NETWORK, settings)
    flat = decomposition.decompose(photo, Knowing(label), NETWORK, settings, shape="flat")
    at = flat.framed.mask
    n = flat.parts.n[0].movedim(0, -1).numpy()[at]
    assert free.shape is None and flat.shape is not None
    assert angle(n, n.mean(0) / np.linalg.norm(n.mean(0))).max() < 0.1
    assert angle(free.parts.n[0].movedim(0, -1).numpy()[at], n).mean() > 20
    assert {step["property"] for step in flat.refined.history} & {"light", "material"}
