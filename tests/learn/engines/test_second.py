"""The CPU engine's second derivatives against the reference's in float64, where sums of lobes are
easy and where they break.

Error as in tests/support/engine_scenes.py, for the derivative by each argument on its own. The
direction n', view', m', light' is random, each of the size of what it belongs to, n' and view'
tangential, as what comes through the scaling to unit length is.
"""

import numpy as np
import pytest
import torch

from learn.engines import second
from learn.methods import HORIZON, exact_second
from manifests import materials as catalogue
from shaders.dsbrdf import half_angles
from shaders.envmap import directions
from tests.support import awkward_scenes
from tests.support.engine_scenes import (
    ROTATION,
    make_scene,
    material,
    random_material,
    tangential,
    unit,
)

CAMERAS = pytest.mark.parametrize(
    "perspective", [False, True], ids=["orthographic", "view per pixel"]
)
NAMES = "g", "n", "view", "m", "light"
TOLERANCE = 1e-5  # as of the first derivatives


def direction(rng, scene):
    """n', view' (or None), m', light'."""
    n, view = (
        None if x is None else tangential(rng.normal(size=x.shape), x).astype(np.float32)
        for x in (scene.n, scene.view)
    )
    m, light = ((rng.normal(size=x.shape) * x).astype(np.float32) for x in (scene.m, scene.light))
    return n, view, m[None], light[None]


def reference(along, scene):
    """{name: derivative} in float64, those by n and view tangential."""
    n, view = (None if x is None else unit(x.astype(np.float64)) for x in (scene.n, scene.view))
    given = scene.g, n, view, scene.m[None], scene.light[None]
    tensors = [
        [None if x is None else torch.tensor(x, dtype=torch.float64) for x in group]
        for group in (along, given)
    ]
    result = exact_second.of_groups(
        tensors[0], *tensors[1], ROTATION.flatten().tolist(), [len(n)], [0]
    )
    return in_tangents(result, n, view)


def engine(along, scene, workers=1):
    result = second.gradients(along, scene.g, *scene.arguments(), workers)
    n, view = (None if x is None else unit(x.astype(np.float64)) for x in (scene.n, scene.view))
    return in_tangents(result, n, view)


def in_tangents(result, n, view):
    by = {
        name: np.asarray(x, dtype=np.float64)
        for name, x in zip(NAMES, result, strict=True)
        if x is not None
    }
    by["n"] = tangential(by["n"], n)
    return by | ({} if view is None else {"view": tangential(by["view"], view)})


def errors(rng, scene):
    along = direction(rng, scene)
    right, result = reference(along, scene), engine(along, scene)
    return {
        name: float(np.abs(result[name] - x).max() / max(np.abs(x).max(), 1e-30))
        for name, x in right.items()
    }


def require_accurate(rng, scene, **tolerances):
    wrong = {
        name: f"{error:.1e}"
        for name, error in errors(rng, scene).items()
        if not error <= tolerances.get(name, TOLERANCE)
    }
    assert not wrong, wrong


@CAMERAS
@pytest.mark.parametrize("size", [(32, 64), (6, 10), (5, 7), (1, 1)])
def test_any_size_of_map(rng, perspective, size):
    require_accurate(
        rng, make_scene(rng, random_material(rng), pixels=36, size=size, perspective=perspective)
    )


@CAMERAS
@pytest.mark.parametrize("name", ["beige-fabric", "chrome", "alumina-oxide"])
def test_measured_materials(rng, perspective, name):
    require_accurate(
        rng,
        make_scene(rng, catalogue.find(name).m, pixels=36, size=(16, 32), perspective=perspective),
    )


@CAMERAS
@pytest.mark.parametrize("gamma", [1e-3, 2.0, 100.0, 1e5])
@pytest.mark.parametrize("kappa", [0.0, 1e-5, 30.0])
def test_every_height_and_width_of_a_lobe(rng, perspective, kappa, gamma):
    """Some normals at peaks: a picture that sees a sharp lobe's last 2^-40 alone is all rounding,
    and γ² of it here.
    """
    w = directions(8, 16)[0].reshape(-1, 3) @ ROTATION.T
    h = half_angles(w[w[:, 2] > -0.5], np.array([0.0, 0.0, 1.0]))[0]
    normals = unit(h + rng.normal(size=h.shape) * 10.0 ** rng.uniform(-7, 0, (len(h), 1)))
    normals = normals[normals[:, 2] > 0.02][::3]
    scene = make_scene(rng, material(kappa, gamma), size=(8, 16), normals=normals)
    if perspective:
        tilt = np.array([0.0, 0.0, 1.0]) + rng.normal(size=normals.shape) * 10.0 ** rng.uniform(
            -7, -1, (len(normals), 1)
        )
        scene.view = unit(tilt).astype(np.float32)
    require_accurate(rng, scene)


@CAMERAS
def test_control_values_eight_decades_apart(rng, perspective):
    """As in the first derivatives, θ_d's own rounding of 1e-7 shows 300-fold where the curve falls
    by its last 1e-5, here in all of them, and 3,000-fold where that is differentiated once more.
    """
    gamma = np.where(np.arange(6) == 0, 1e5, 1e-3)
    scene = make_scene(
        rng,
        material(np.linspace(1e-4, 1, 6), gamma),
        pixels=48,
        size=(16, 32),
        perspective=perspective,
    )
    require_accurate(rng, scene, **dict.fromkeys(NAMES, 5e-5) | {"view": 5e-4})


@CAMERAS
@pytest.mark.parametrize("gamma", [1e-3, 0.5, 5.0])
def test_normals_at_the_silhouette(rng, perspective, gamma):
    angle, z = rng.uniform(0, 2 * np.pi, 48), 10.0 ** rng.uniform(-3.9, -0.1, 48)
    n = np.stack([np.cos(angle) * np.sqrt(1 - z * z), np.sin(angle) * np.sqrt(1 - z * z), z], -1)
    scene = make_scene(rng, material(0.4, gamma), size=(16, 32), normals=n)
    if perspective:
        scene.view = np.broadcast_to(np.float32([0, 0, 1]), scene.n.shape).copy()
    # a light's part grows as 1/c², and c, down to 1e-2 here, is right to 6e-8
    require_accurate(rng, scene, n=3e-5, view=3e-5)


@CAMERAS
def test_a_sun_in_one_texel(rng, perspective):
    """Pixels beside the sun's highlight see its flank, where γ ln c, down to −28, is right to 1e-7
    of itself and stands in an exponent.
    """
    light = rng.random((16, 32, 3)) + 0.1
    light[4, 10] = 1e6
    scene = make_scene(
        rng, material(5.0, 1e4), pixels=48, size=(16, 32), perspective=perspective, light=light
    )
    require_accurate(rng, scene, **dict.fromkeys(NAMES, 3e-5))


@CAMERAS
def test_passes_of_pixels_and_slabs_of_lights_add_up(rng, perspective, monkeypatch):
    from learn.engines import lights

    scene = make_scene(
        rng, random_material(rng), pixels=100, size=(16, 32), perspective=perspective
    )
    along = direction(rng, scene)
    whole = engine(along, scene)
    monkeypatch.setattr(second, "PASS", 33)
    monkeypatch.setattr(lights, "SLAB", 200)
    lights.slabs.cache_clear()
    try:
        parts = engine(along, scene)
    finally:
        lights.slabs.cache_clear()
    for name, x in whole.items():
        # sums in another order
        np.testing.assert_allclose(
            parts[name], x, rtol=0, atol=1e-6 * np.abs(x).max(), err_msg=name
        )


@pytest.mark.parametrize("apart", [1e-2, 1e-3])
def test_views_near_a_light_and_near_its_opposite(rng, apart):
    """Where w → v the second derivative by the view grows as 1/‖w − v‖, whose digits float32 loses
    at the same pace.
    """
    w = directions(16, 32)[0].reshape(-1, 3) @ ROTATION.T
    for sign, tolerance in ((1.0, 2e-7 / apart + TOLERANCE), (-1.0, 3 * TOLERANCE)):
        view = unit(sign * w + apart * rng.normal(size=w.shape))
        n = (
            unit(view + 0.3 * rng.normal(size=w.shape))
            if sign > 0
            else unit(np.cross(view, rng.normal(size=w.shape)) + 0.01 * view)
        )
        scene = make_scene(rng, random_material(rng), size=(16, 32), normals=n[::8])
        scene.view = view.astype(np.float32)[::8].copy()
        require_accurate(rng, scene, view=tolerance)


@CAMERAS
def test_threads_do_not_show(rng, perspective):
    scene = make_scene(rng, random_material(rng), pixels=80, size=(16, 32), perspective=perspective)
    along = direction(rng, scene)
    one, three = engine(along, scene, 1), engine(along, scene, 3)
    assert all(np.array_equal(one[name], three[name]) for name in one)


@CAMERAS
def test_groups_and_images_keep_to_themselves(rng, perspective):
    """Three groups of two images together, and each alone: the same bits; and the reference, which
    CUDA takes, in the same order.
    """
    scenes = [
        make_scene(rng, random_material(rng), pixels=20, size=(8, 16), perspective=perspective)
        for _ in range(3)
    ]
    scenes[1].light = scenes[0].light
    along = [direction(rng, scene) for scene in scenes]
    along[1] = (*along[1][:3], along[0][3])

    def join(parts):
        return None if parts[0] is None else np.concatenate(parts)

    given = [join([getattr(scene, name) for scene in scenes]) for name in ("g", "n", "view")]
    m, lights = (
        np.stack([scene.m for scene in scenes]),
        np.stack([scenes[0].light, scenes[2].light]),
    )
    directions_ = (
        *(join([a[i] for a in along]) for i in range(3)),
        np.concatenate([along[0][3], along[2][3]]),
    )
    counts, rotation = [len(scene.n) for scene in scenes], tuple(ROTATION.flatten().tolist())
    result = second.gradients(directions_, *given, m, lights, rotation, counts, [0, 0, 1], 1)
    alone = [
        second.gradients(a, scene.g, *scene.arguments(), 1)
        for a, scene in zip(along, scenes, strict=True)
    ]
    for i in range(4):
        if result[i] is not None:
            assert np.array_equal(result[i], join([by[i] for by in alone])), NAMES[i]
    np.testing.assert_allclose(
        result[4][0],
        alone[0][4][0] + alone[1][4][0],
        rtol=1e-6,
        atol=1e-6 * np.abs(result[4][0]).max(),
    )
    assert np.array_equal(result[4][1], alone[2][4][0])
    tensors = [
        [None if x is None else torch.as_tensor(x) for x in group]
        for group in (directions_, (*given, m, lights))
    ]
    right = exact_second.of_groups(tensors[0], *tensors[1], rotation, counts, [0, 0, 1])
    for i in (0, 3, 4):  # those by n and view differ in their radial parts
        np.testing.assert_allclose(
            result[i], right[i], rtol=0, atol=TOLERANCE * np.abs(result[i]).max(), err_msg=NAMES[i]
        )


@CAMERAS
def test_adversarial_samples_stay_finite(rng, perspective, monkeypatch):
    """The first derivatives' own, a tenth of them: κ to 30, γ from 1e-3 to 1e5, lights to 1e6,
    silhouettes, horizons, peaks, corners.
    """
    monkeypatch.setattr(awkward_scenes, "GROUPS", 50)
    w, drawn = directions(*awkward_scenes.SIZE)[0].reshape(-1, 3) @ ROTATION.T, 100_000
    v = (
        awkward_scenes.awkward_views(rng, w, drawn)
        if perspective
        else np.broadcast_to([0.0, 0.0, 1.0], (drawn, 3))
    )
    n, v = (x.astype(np.float32) for x in (awkward_scenes.awkward_normals(rng, w, v), v))
    above = (n * v).sum(1) > HORIZON
    group = np.sort(rng.integers(50, size=drawn))[above]
    n, v = n[above].copy(), v[above].copy() if perspective else None
    m, light = awkward_scenes.awkward_materials(rng), awkward_scenes.awkward_lights(rng)
    along = [
        None if x is None else tangential(rng.normal(size=x.shape), x).astype(np.float32)
        for x in (n, v)
    ]
    along += [(rng.normal(size=x.shape) * x).astype(np.float32) for x in (m, light)]
    g = rng.normal(size=n.shape).astype(np.float32)
    counts = np.bincount(group, minlength=50).tolist()
    result = second.gradients(
        along, g, n, v, m, light, tuple(ROTATION.flatten().tolist()), counts, list(range(50)), 1
    )
    for name, by in zip(NAMES, result, strict=True):
        assert by is None or (np.isfinite(by).all() and by.any()), name
