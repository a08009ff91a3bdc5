"""Flat faces have sums of their own in direct light, and lamps are parts of no block."""

import numpy as np
import pytest

pytest.importorskip("numba")

from shaders import envmap, normal_groups
from shaders.direct_light import DirectLight
from shaders.mixture import Mixture
from tests.support.texel_sums import ROTATION, normals, summed

WIDTH = 0.3  # of a lobe for which blocks of four texels count as one light
# a face that is seen at a grazing angle: half vectors lie close there
FACE = np.array([0.0, 0.94, 0.342]) / np.linalg.norm([0.0, 0.94, 0.342])


@pytest.fixture(scope="module")
def light():
    """A dim map with a soft box of more texels than are lamps, whose edges lie inside of blocks."""
    rng = np.random.default_rng(8)
    L = rng.uniform(0.05, 0.1, (64, 128, 3)).astype(np.float32)
    L[9:24, 29:50] = 60
    return L


@pytest.fixture(scope="module")
def glossy():
    """A mixture whose width has a kink at the view of the face."""
    facing = 1 - FACE[2]
    log_alpha = np.log([[WIDTH], [1.3 * WIDTH], [WIDTH]])
    stops = np.array([facing - 0.03, facing, facing + 0.03])
    weights = np.full((3, 1, 3), 0.5)
    return Mixture(("ashikhmin_shirley",), stops, log_alpha, np.zeros((3, 1)), weights)


def errors(mixture, light, n, facets):
    """Of each normal's radiance, as shares of the converged sum."""
    direct = DirectLight(mixture, light, ROTATION, misdirected=False)
    exact = summed(mixture, light, n[:1].astype(float), 4)
    return np.abs(direct.at(n, facets=facets) / exact - 1)


def test_a_flat_face_is_summed_over_all_texels(light, glossy):
    n = np.tile(FACE, (normal_groups.FACE_POINTS, 1)).astype(np.float32)
    beside = n + np.float32([0.01, 0, 0])  # facets that the normals lean from: no face is flat
    beside /= np.linalg.norm(beside, axis=1, keepdims=True)
    assert errors(glossy, light, n, n).max() < 0.003
    assert errors(glossy, light, n, beside).min() > 0.02
    assert errors(glossy, light, n[1:], n[1:]).min() > 0.02  # too few points


def test_other_points_beside_a_face_keep_their_maps(light, glossy):
    """In any order of the points."""
    face = np.tile(FACE, (normal_groups.FACE_POINTS, 1))
    others = normals(300, 80)
    order = np.random.default_rng(2).permutation(len(face) + len(others))
    n = np.concatenate([face, others])[order].astype(np.float32)
    at = DirectLight(glossy, light, ROTATION).at(n, facets=n)[np.argsort(order)]
    by_maps = DirectLight(glossy, light, ROTATION).at(others.astype(np.float32))
    np.testing.assert_array_equal(at[len(face) :], by_maps)
    alone = np.tile(FACE, (normal_groups.FACE_POINTS, 1)).astype(np.float32)
    np.testing.assert_array_equal(at[: len(face)], DirectLight(glossy, light, ROTATION).at(alone))


def test_only_the_normals_of_most_points_have_sums_of_their_own(monkeypatch):
    monkeypatch.setattr(normal_groups, "MOST_FACES", 2)
    counts = [70, 63, 90, 200, 64]
    n = np.repeat(normals(5, 60).astype(np.float32), counts, axis=0)
    _, shared = normal_groups.by_repetition(n, n)
    faces = normal_groups.large(shared)
    assert sorted(np.bincount(faces.each)) == [90, 200]
    assert (n[faces.first][faces.each] == n[faces.points]).all()
    monkeypatch.setattr(normal_groups, "MOST_FACES", 9)
    assert sorted(np.bincount(normal_groups.large(shared).each)) == [64, 70, 90, 200]


def test_the_sum_of_a_face_is_kept(light, glossy, monkeypatch):
    n = np.tile(FACE, (100, 1)).astype(np.float32)
    direct = DirectLight(glossy, light, ROTATION)
    first = direct.at(n, facets=n)
    monkeypatch.setattr(direct, "_sum", lambda *_: pytest.fail("computed again"))
    np.testing.assert_array_equal(direct.at(n, facets=n), first)


@pytest.mark.parametrize("rows", [16, 32])
def test_lamps_are_parts_of_no_block(rows):
    """The light of a bright texel comes from where it is, and its block has that of the others."""
    L = np.full((64, 128, 3), 1.0, np.float32)
    L[20, 40] = 10
    lights = DirectLight(Mixture.lambert([0.5] * 3), L, ROTATION).blocks.lights(rows)
    w, solid_angle = envmap.directions(64, 128)
    beside = np.degrees(np.arccos(np.clip(lights[:3].T @ (ROTATION @ w[20, 40]), -1, 1)))
    nearest, block = np.argsort(beside)[:2]
    assert beside[nearest] < 0.05
    assert lights[6, nearest] == pytest.approx(10 * solid_angle[20, 40], rel=1e-4)
    own = slice(20, 20 + 64 // rows), slice(40, 40 + 64 // rows)
    assert lights[6, block] == pytest.approx(solid_angle[own].sum() - solid_angle[20, 40], rel=1e-4)
