"""Deformed geometry: normals are those of the deformed surface, which stays in the frame."""

import itertools

import numpy as np
import pytest

from learn.data import deformations
from learn.data.deformations import deform
from shaders.frames import pixel_grid

SIZE = 128
SEEDS = range(12)


@pytest.fixture(scope="module")
def dome():
    """Normals, segments and depth of half an ellipsoid, two segments side by side."""
    x, y = pixel_grid(SIZE, SIZE)
    z = 0.49 * np.maximum(1 - (x / 0.8) ** 2 - (y / 0.6) ** 2, 0) ** 0.5 / 0.7
    mask = (x / 0.8) ** 2 + (y / 0.6) ** 2 < 0.98
    n = np.stack([x / 0.64, y / 0.36, z / 0.49], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    segments = np.where(mask, 1 + (x > 0), 0)
    return (n * mask[..., None]).astype(np.float32), segments, (-z * mask).astype(np.float32)


def inside(mask, pixels=3):
    """The mask without a rim of some pixels."""
    for _ in range(pixels):
        for axis in (0, 1):
            mask = mask & np.roll(mask, 1, axis) & np.roll(mask, -1, axis)
    return mask


@pytest.mark.parametrize("half_extent", [1.0, 1.7])
@pytest.mark.parametrize("seed", SEEDS)
def test_normals_are_those_of_the_deformed_depth(dome, seed, half_extent):
    n, segments, depth = dome
    rng = np.random.default_rng(seed)
    result = deform(rng, n, segments, depth * half_extent, half_extent)
    rows, columns = np.gradient(-result.depth, 2 * half_extent / SIZE)
    found = np.stack([-columns, rows, np.ones_like(rows)], -1)
    at = inside(result.segments > 0) & (result.n[..., 2] > 0.3)
    cosines = (found * result.n).sum(-1) / np.linalg.norm(found, axis=-1)
    angles = np.degrees(np.arccos(np.clip(cosines[at], -1, 1)))
    assert np.median(angles) < 0.3
    assert np.percentile(angles, 99) < 1.5


def test_normals_are_unit_and_face_the_viewer_where_a_segment_is_and_nowhere_else(dome):
    n, segments, depth = dome
    for seed in SEEDS:
        result = deform(np.random.default_rng(seed), n, segments, depth)
        mask = result.segments > 0
        assert np.allclose(np.linalg.norm(result.n[mask], axis=-1), 1, atol=1e-5)
        assert (result.n[..., 2] >= 0).all()
        assert not result.n[~mask].any() and not result.depth[~mask].any()
        assert set(np.unique(result.segments)) == {0, 1, 2}


def test_deformed_objects_stay_in_the_frame_and_large(dome):
    n, segments, _ = dome
    for seed in SEEDS:
        mask = deform(np.random.default_rng(seed), n, segments).segments > 0
        assert 0.1 < mask.mean() < 0.8
        assert mask[2:-2, 2:-2].sum() > 0.95 * mask.sum()


def test_a_deformation_changes_the_shape_and_not_only_its_place(dome):
    n, segments, _ = dome
    changed = [deform(np.random.default_rng(seed), n, segments).n for seed in SEEDS]
    tops = [each[each[..., 2] > 0].mean(0) for each in changed]
    assert np.std([top[2] for top in tops]) > 0.02  # flatter and steeper
    assert all(np.abs(a - b).max() > 0.1 for a, b in itertools.pairwise(changed))


def test_an_empty_view_and_a_map_that_always_folds_stay_as_they_are(dome, monkeypatch):
    n, segments, depth = dome
    empty = deform(np.random.default_rng(0), n * 0, segments * 0, depth * 0)
    assert not empty.segments.any() and not empty.n.any()
    monkeypatch.setattr(deformations, "LEAST_AREA", 1e9)
    same = deform(np.random.default_rng(0), n, segments, depth)
    assert same.n is n and same.segments is segments and same.depth is depth
