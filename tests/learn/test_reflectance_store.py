"""Radiance looked up in reflectance maps beside the layer's own at each normal."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from learn.editing import drawing, targets
from learn.editing import reflectance_store as store
from learn.figures import spheres
from learn.layer import predictions
from shaders import tone

ELEVATION = np.deg2rad(20.0)


def light():
    """A dim sky with one small bright lamp."""
    L = np.full((3, 64, 128), 0.3, np.float32)
    L[:, 10:14, 40:48] = 60.0
    return torch.from_numpy(L[None])


def normals(count):
    """Normals that face the camera, (count, 3)."""
    rng = np.random.default_rng(np.random.SeedSequence(3))
    p = rng.uniform(-1, 1, (4 * count, 2))
    p = p[np.linalg.norm(p, axis=1) < 0.97][:count]
    return store.normals_at_points(p).astype(np.float32)


def label(name):
    return np.asarray(targets.resolve_labels(name, None)[0], np.float32)


def sum_of_parts(material, n):
    """The radiance of broad lobes and that of narrow ones, each at every normal."""
    scene = store.Scene(light(), ELEVATION, np.ones(3), predictions.SHOWN.tolerance, n)
    parts = store.separate_lobes(material)
    assert len(parts) == 2
    return np.sum([store.radiance(n, part, scene, method) for part, method in parts], 0)


@pytest.mark.parametrize("name", ["brass", "red-specular-plastic"])
def test_each_lobe_is_in_one_part_and_reflects_exactly_nothing_in_the_other(name):
    whole = np.exp(label(name)).reshape(3, 3, 2, 6)
    first, second = (
        np.exp(part).reshape(whole.shape) for part, _ in store.separate_lobes(label(name))
    )
    # zero, not small: a method would sum a lobe of the smallest κ over all texels
    present = np.stack([first[:, :, 0].max((0, 2)) > 0, second[:, :, 0].max((0, 2)) > 0])
    np.testing.assert_array_equal(present.sum(0), 1)
    np.testing.assert_array_equal(first[:, :, 0] + second[:, :, 0], whole[:, :, 0])


@pytest.mark.parametrize("count", [20_000, 40_000])
def test_many_normals_under_a_narrow_lobe_are_looked_up_and_doubtful_ones_rendered(
    count, monkeypatch
):
    n, material, rendered = normals(count), label("brass"), []
    own = store.radiance

    def counted(at, *rest):
        rendered.append((at, own(at, *rest)))
        return rendered[-1][1]

    monkeypatch.setattr(store, "radiance", counted)
    result = store.radiance_at_normals(material, n, light(), ELEVATION, predictions.SHOWN.tolerance)
    (doubtful, broad), (again, narrow) = rendered[-2:]
    assert doubtful is again or np.array_equal(doubtful, again)
    assert len(rendered) > 2 and 0 < len(doubtful) < count / 4
    place = {each.tobytes(): k for k, each in enumerate(n)}
    np.testing.assert_array_equal(
        result[[place[each.tobytes()] for each in doubtful]], broad + narrow
    )
    some = np.arange(0, count, 20)
    scene = store.Scene(light(), ELEVATION, np.ones(3), predictions.SHOWN.tolerance, n)
    truth = own(n[some], material, scene, "")
    exposure = tone.auto_exposure(truth[None], np.ones((1, len(some)), bool))
    error = tone.display(result[some], exposure) - tone.display(truth, exposure)
    assert np.sqrt((error**2).mean()) < 1
    assert (np.abs(error).max(-1) > 8).mean() < 0.005


def test_broad_lobes_are_rendered_at_each_normal():
    n, material = normals(24_000), label("white-fabric")
    scene = store.Scene(light(), ELEVATION, np.ones(3), predictions.SHOWN.tolerance, n)
    np.testing.assert_array_equal(
        store.radiance_at_normals(material, n, light(), ELEVATION, predictions.SHOWN.tolerance),
        store.radiance(n, material, scene, ""),
    )


def test_at_few_normals_broad_and_narrow_lobes_are_rendered_apart_to_the_same_picture():
    n, material = normals(9_999), label("brass")
    result = store.radiance_at_normals(material, n, light(), ELEVATION, predictions.SHOWN.tolerance)
    np.testing.assert_array_equal(result, sum_of_parts(material, n))
    scene = store.Scene(light(), ELEVATION, np.ones(3), predictions.SHOWN.tolerance, n)
    truth = store.radiance(n, material, scene, "")
    exposure = tone.auto_exposure(truth[None], np.ones((1, len(n)), bool))
    error = np.abs(tone.display(result, exposure) - tone.display(truth, exposure))
    assert np.sqrt((error**2).mean()) < 0.3 and error.max() < 3


def test_where_most_normals_are_doubtful_all_are_rendered(monkeypatch):
    monkeypatch.setattr(store, "MOST_RENDERED", -1.0)
    n, material = normals(20_000), label("brass")
    np.testing.assert_array_equal(
        store.radiance_at_normals(material, n, light(), ELEVATION, predictions.SHOWN.tolerance),
        sum_of_parts(material, n),
    )


@pytest.mark.parametrize("name", ["brass", "chrome", "white-fabric"])
def test_a_sheets_material_sphere_is_the_layers_picture_in_preview_lighting(name):
    decomposed = SimpleNamespace(
        parts=SimpleNamespace(light=light()), batch=SimpleNamespace(elevation=ELEVATION)
    )
    error = np.abs(
        drawing.material_sphere(label(name), decomposed)
        - spheres.preview_sphere(label(name), drawing.SPHERE, ELEVATION)
    )
    assert error.max() < 2 and np.sqrt((error**2).mean()) < 0.3
