"""The CPU engine against float64: values and every gradient, for both cameras, where sums of lobes
are easy and where they break.
"""

import numpy as np
import pytest

from manifests import materials as catalogue
from shaders.dsbrdf import half_angles
from shaders.envmap import directions
from tests.support.engine_scenes import (
    ROTATION,
    TOLERANCE,
    errors,
    make_scene,
    material,
    random_material,
    unit,
)

CAMERAS = pytest.mark.parametrize(
    "perspective", [False, True], ids=["orthographic", "view per pixel"]
)


def require_accurate(scene, **tolerances):
    result = errors(scene)
    wrong = {
        name: f"{error:.1e}"
        for name, error in result.items()
        if not error <= tolerances.get(name, TOLERANCE)
    }
    assert not wrong, wrong


@CAMERAS
@pytest.mark.parametrize("size", [(64, 128), (32, 64), (6, 10), (5, 7), (1, 1)])
def test_any_size_of_map(rng, perspective, size):
    require_accurate(
        make_scene(rng, random_material(rng), pixels=70, size=size, perspective=perspective)
    )


@CAMERAS
@pytest.mark.parametrize(
    "name", ["beige-fabric", "black-phenolic", "chrome", "alumina-oxide", "green-metallic-paint"]
)
def test_measured_materials(rng, perspective, name):
    require_accurate(make_scene(rng, catalogue.find(name).m, perspective=perspective))


@CAMERAS
@pytest.mark.parametrize("gamma", [1e-3, 0.3, 2.0, 100.0, 1e4, 1e5])
@pytest.mark.parametrize("kappa", [0.0, 1e-5, 0.1, 30.0])
def test_every_height_and_width_of_a_lobe(rng, perspective, kappa, gamma):
    require_accurate(
        make_scene(rng, material(kappa, gamma), pixels=48, size=(16, 32), perspective=perspective)
    )


@CAMERAS
def test_control_values_eight_decades_apart(rng, perspective):
    """A basis function that leaves a trace of 1e-6 where it is 0 would turn γ = 1e-3 into 0.1.

    ∂θ_d/∂v: the only lights that matter stand where the curve falls by its last 1e-5, so θ_d's own
    rounding of 1e-7 shows 300-fold.
    """
    gamma = np.where(np.arange(6) == 0, 1e5, 1e-3)
    require_accurate(
        make_scene(rng, material(np.linspace(1e-4, 1, 6), gamma), perspective=perspective),
        view=5e-5,
    )


@CAMERAS
@pytest.mark.parametrize("gamma", [1.0, 100.0, 1e5])
def test_normals_at_the_peak_of_a_lobe(rng, perspective, gamma):
    """h·n → 1: 1 − c has no digits left in float32 unless it comes from ‖h − n‖²."""
    w = directions(16, 32)[0].reshape(-1, 3) @ ROTATION.T
    h = half_angles(w[w[:, 2] > -0.5], np.array([0.0, 0.0, 1.0]))[0]
    offsets = rng.normal(size=h.shape) * 10.0 ** rng.uniform(-7, -1.5, (len(h), 1))
    scene = make_scene(rng, material(5.0, gamma), size=(16, 32), normals=unit(h + offsets)[::4])
    if perspective:
        scene.view = np.broadcast_to(np.float32([0, 0, 1]), scene.n.shape).copy()
    require_accurate(scene)


@CAMERAS
@pytest.mark.parametrize("gamma", [1e-3, 0.5, 5.0])
def test_normals_at_the_silhouette(rng, perspective, gamma):
    """n·v → 0 down to the layer's horizon, with some facing normals that set the scale."""
    angle = rng.uniform(0, 2 * np.pi, 64)
    z = 10.0 ** rng.uniform(-3.9, -0.1, 64)
    n = np.stack([np.cos(angle) * np.sqrt(1 - z * z), np.sin(angle) * np.sqrt(1 - z * z), z], -1)
    scene = make_scene(rng, material(0.4, gamma), size=(16, 32), normals=n)
    if perspective:
        scene.view = np.broadcast_to(np.float32([0, 0, 1]), scene.n.shape).copy()
    require_accurate(scene)


@CAMERAS
@pytest.mark.parametrize(
    "texel",
    [(0, 0), (15, 31), (7, 0), (7, 31), (3, 9)],
    ids=["pole", "other pole", "seam", "seam's end", "inside"],
)
@pytest.mark.parametrize("level", [1.0, 1e6])
def test_one_lit_texel(rng, perspective, texel, level):
    light = np.zeros((16, 32, 3))
    light[texel] = level
    require_accurate(
        make_scene(rng, random_material(rng), size=(16, 32), perspective=perspective, light=light)
    )


@CAMERAS
@pytest.mark.parametrize("kappa, gamma", [(0.2, 1.0), (5.0, 1e4)])
def test_a_sun_in_one_texel_does_not_hide_the_sky(rng, perspective, kappa, gamma):
    """What a lobe's cutoff drops stays small against the mean of the picture, not against the sun's
    reflection.
    """
    light = rng.random((32, 64, 3)) + 0.1
    light[8, 20] = 1e6
    require_accurate(make_scene(rng, material(kappa, gamma), perspective=perspective, light=light))


@CAMERAS
def test_black_light(rng, perspective):
    require_accurate(
        make_scene(rng, random_material(rng), perspective=perspective, light=np.zeros((8, 16, 3)))
    )


def test_light_from_behind_along_the_view(rng):
    """w → −v, where h vanishes: lit only at the silhouette.

    3e-3 away, because −w is a texel too: there θ_d has its corner, and the direction of t = w − v
    fewer digits than 1e-5.
    """
    w = directions(16, 32)[0].reshape(-1, 3) @ ROTATION.T
    opposite = -w + 3e-3 * rng.normal(size=w.shape)
    n = unit(np.cross(opposite, rng.normal(size=w.shape)) + 0.01 * opposite)
    scene = make_scene(rng, random_material(rng), size=(16, 32), normals=n[::4])
    scene.view = unit(opposite).astype(np.float32)[::4].copy()
    require_accurate(scene)


def test_view_along_the_light(rng):
    """w → v, where θ_d has its corner: near it, not on it."""
    w = directions(16, 32)[0].reshape(-1, 3) @ ROTATION.T
    near = unit(w + 1e-3 * rng.normal(size=w.shape))
    n = unit(near + 0.3 * rng.normal(size=w.shape))
    scene = make_scene(rng, random_material(rng), size=(16, 32), normals=n[::4])
    scene.view = near.astype(np.float32)[::4].copy()
    require_accurate(scene)
