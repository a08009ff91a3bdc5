"""Radiance looked up in reflectance maps beside the layer's own at each normal."""

import numpy as np
import pytest
import torch

from learn.editing import reflectance_store as store
from learn.editing import targets
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
    return store.normals(p).astype(np.float32)


def label(name):
    return np.asarray(targets.resolve_labels(name, None)[0], np.float32)


@pytest.mark.parametrize("count", [10_000, 40_000])
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
    doubtful, exact = rendered[-1]
    assert len(rendered) > 1 and 0 < len(doubtful) < count / 4
    place = {each.tobytes(): k for k, each in enumerate(n)}
    np.testing.assert_array_equal(result[[place[each.tobytes()] for each in doubtful]], exact)
    some = np.arange(0, count, 20)
    scene = store.Scene(light(), ELEVATION, np.ones(3), predictions.SHOWN.tolerance, n)
    truth = own(n[some], material, scene, "")
    exposure = tone.auto_exposure(truth[None], np.ones((1, len(some)), bool))
    error = tone.display(result[some], exposure) - tone.display(truth, exposure)
    assert np.sqrt((error**2).mean()) < 1
    assert (np.abs(error).max(-1) > 8).mean() < 0.005


@pytest.mark.parametrize(("name", "count"), [("brass", 9_999), ("white-fabric", 12_000)])
def test_few_normals_and_broad_lobes_are_rendered_each(name, count):
    n = normals(count)
    scene = store.Scene(light(), ELEVATION, np.ones(3), predictions.SHOWN.tolerance, n)
    np.testing.assert_array_equal(
        store.radiance_at_normals(label(name), n, light(), ELEVATION, predictions.SHOWN.tolerance),
        store.radiance(n, label(name), scene, ""),
    )


def test_where_most_normals_are_doubtful_all_are_rendered(monkeypatch):
    monkeypatch.setattr(store, "MOST_RENDERED", -1.0)
    n = normals(10_000)
    scene = store.Scene(light(), ELEVATION, np.ones(3), predictions.SHOWN.tolerance, n)
    np.testing.assert_array_equal(
        store.radiance_at_normals(
            label("brass"), n, light(), ELEVATION, predictions.SHOWN.tolerance
        ),
        store.radiance(n, label("brass"), scene, ""),
    )
