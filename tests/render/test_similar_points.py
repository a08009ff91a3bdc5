"""Points of one pixel that share a sum: only those of similar normals do."""

import numpy as np
import pytest

pytest.importorskip("numba")

from factory.render import direct_light
from shaders import envmap, frames
from shaders.direct_light import DirectLight
from shaders.mixture import Mixture


@pytest.fixture(scope="module")
def lit():
    """Direct light of a lobe under a lamp at one side."""
    w, _ = envmap.directions(64, 128)
    camera_from_light = frames.camera_from_light()
    towards = np.array([0.9, 0.2, 0.3]) @ camera_from_light
    light = 0.1 + 30 * np.exp(20 * (w @ (towards / np.linalg.norm(towards)) - 1))
    light = (light[..., None] * [1.0, 0.9, 0.7]).astype(np.float32)
    return DirectLight(
        Mixture.constant("ashikhmin_shirley", 0.2, [0.5] * 3), light, camera_from_light
    )


def unit(vectors):
    vectors = np.asarray(vectors, np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def means(lit, n, facets):
    """The mean radiance (3,) of points of a pixel that share sums, and of those that do not."""
    one = np.zeros(len(n), np.int64)
    shared = lit.at(
        n,
        facets=facets,
        cells=direct_light.number_similar(one, n, direct_light.SIMILAR),
        patches=direct_light.number_similar(one, facets, direct_light.FACET_STEPS),
    )
    return shared.mean(0), lit.at(n, facets=facets).mean(0)


def turning(start, end, count=16):
    """Normals (count, 3) from one direction to another."""
    t = np.linspace(0, 1, count)[:, None]
    return unit((1 - t) * np.array(start) + t * np.array(end))


def test_opposite_sides_near_the_horizon_do_not_share_a_sum(lit):
    # both sides of a slat that is narrower than a pixel: one is lit, and the other is not
    n = np.concatenate([unit([[0.95, 0.3, 0.06]] * 3), unit([[-0.95, 0.3, 0.06]] * 13)])
    shared, right = means(lit, n, n)
    np.testing.assert_allclose(shared, right, rtol=1e-3)


def test_normals_that_turn_near_the_horizon_share_that_of_their_mean(lit):
    n = turning([0.95, 0.3, 0.02], [0.95, 0.3, 0.06])
    shared, right = means(lit, n, n)
    np.testing.assert_allclose(shared, right, rtol=0.08)  # by the first of them 0.32


@pytest.mark.parametrize("kind, tilt", [("ggx", 0.1), ("beckmann", 0.05)])
def test_normals_of_a_facet_that_turn_away_share_what_the_same_closures_reflect(lit, kind, tilt):
    # a closure ends where its tilted normal turns away: by the mean of these it would be there for
    # all normals, or for none
    mixture = Mixture.constant(kind, 0.4, [0.5] * 3, tilt=tilt)
    direct = DirectLight(mixture, lit.light, lit.camera_from_light)
    n = turning([0.14, 0.98, -0.13], [0.14, 0.98, -0.02])
    facets = np.tile(unit([[-0.02, 0.94, 0.35]]), (len(n), 1))
    shared, right = means(direct, n, facets)
    np.testing.assert_allclose(shared, right, rtol=0.02)
    assert 0 < (direct.at(n, facets=facets).max(1) == 0).sum() < len(n)


def test_other_normals_of_a_facet_share_what_it_takes_away(lit, monkeypatch):
    n = turning([0.6, 0.4, 0.5], [0.7, 0.3, 0.5])
    facets = np.tile(unit([[0.8, 0.4, 0.4]]), (len(n), 1))
    steps = direct_light.FACET_STEPS
    assert len(set(direct_light.number_similar(np.zeros(len(n), int), facets, steps))) == 1
    assert len(set(direct_light.number_similar(np.arange(len(n)), facets, steps))) == len(n)
