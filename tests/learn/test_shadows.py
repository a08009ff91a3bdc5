"""Shadows of relit pictures: a convex object has none, and a wall darkens the floor beside it."""

import numpy as np
import torch

from learn.data import shadows
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.relit import RelitDataset
from learn.data.settings import Data
from manifests.schema import Camera
from tests.support import synthetic

SIZE = 64
LIGHT = np.ones((64, 128, 3), np.float32)


def matte_label(albedo):
    return np.asarray(synthetic.matte(albedo=albedo).label, np.float32)


def factor_of(n, depth, mask, radiance, label):
    position, view = shadows.positions(depth, Camera(size=mask.shape))
    return shadows.shadow_factor(
        n, position, view, mask.astype(np.int64), radiance, label[None], LIGHT, 0.3
    )


def test_a_convex_object_has_the_factor_one_exactly():
    n, mask = synthetic.sphere(Camera(size=(SIZE, SIZE)))
    radiance = np.full(n.shape, 0.4, np.float32) * mask[..., None]
    for depth in (-n[..., 2], -np.rint(n[..., 2] * 16384) / 16384):
        result = factor_of(n, depth.astype(np.float32), mask, radiance, matte_label(0.4))
        np.testing.assert_array_equal(result, 1)


def corner():
    """A floor that faces the viewer and, on the left, a step of .3 radii towards the viewer."""
    n = np.zeros((SIZE, SIZE, 3), np.float32)
    n[..., 2] = 1
    depth = np.zeros((SIZE, SIZE), np.float32)
    depth[:, : SIZE // 2] = -shadows.THICKNESS
    return n, depth, np.ones((SIZE, SIZE), bool)


def test_a_wall_takes_the_share_of_light_that_its_form_factor_says():
    n, depth, mask = corner()
    result = factor_of(n, depth, mask, np.zeros_like(n) + 1e-6, matte_label(0.4))
    pixel = 2 * Camera().half_extent / SIZE
    for beside in (4, 8):
        distance = (beside + 0.5) * pixel
        # a long wall of height h at distance d takes (1 - d / sqrt(d^2 + h^2)) / 2 of a floor's sky
        height = shadows.THICKNESS
        expected = 1 - (1 - distance / np.hypot(distance, height)) / 2
        value = result[SIZE // 2, SIZE // 2 + beside, 0]
        assert abs(value - expected) < 0.05, (beside, value, expected)


def test_shadows_are_the_same_each_time_and_a_bright_wall_returns_light():
    n, depth, mask = corner()
    dark, bright = (np.full(n.shape, 0.4, np.float32) for _ in range(2))
    dark[:, : SIZE // 2] = 0
    label = matte_label(0.4)
    first, again = (factor_of(n, depth, mask, dark, label) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    at = SIZE // 2, SIZE // 2 + 4
    assert factor_of(n, depth, mask, bright, label)[at].min() > first[at].max()


def test_shadows_change_the_pictures_of_a_batch_and_nothing_else(tmp_path):
    rng = np.random.default_rng(1)
    synthetic.write_dataset(tmp_path, [synthetic.matte()], rng, size=32, category="sphere")
    geometry = Geometry(tmp_path, progress=False, depth=True)
    # the synthetic depth is that of a bowl, whose rim shadows it: a sphere's has the other sign
    split = DataSplit(geometry, np.arange(1), {"m": matte_label(0.4)}, [LIGHT], "train")
    plain, shaded, again = (
        RelitDataset(split, Data(sharing=2, photograph=False, shadows=share), 4, 32, 3)[5]
        for share in (0.0, 1.0, 1.0)
    )
    assert torch.equal(shaded.image, again.image) and torch.equal(plain.light, shaded.light)
    assert torch.equal(plain.n, shaded.n) and not torch.equal(plain.image, shaded.image)


def test_which_pictures_have_shadows_does_not_depend_on_their_material(tmp_path):
    """A stream of its own decides of each picture, also where the first of a group is concerned."""
    rng = np.random.default_rng(1)
    synthetic.write_dataset(tmp_path, [synthetic.matte()], rng, size=32, category="sphere")
    geometry = Geometry(tmp_path, progress=False, depth=True)
    split = DataSplit(geometry, np.arange(1), {"m": matte_label(0.4)}, [LIGHT], "train")
    keys = {"sharing": 1, "photograph": False, "scaled_lobes": 0.5}
    plain, shaded = (
        RelitDataset(split, Data(**keys, shadows=share), 1, 32, 3) for share in (0.0, 0.5)
    )
    pairs = [(plain[k], shaded[k]) for k in range(20)]
    cases = {
        ("scaled(" in one.names[0], torch.equal(one.image, other.image)) for one, other in pairs
    }
    assert len(cases) == 4
