"""References that are kept in files are used only by measurements of the same scene."""

import numpy as np
import pytest

from factory.render.estimators.renderer import Portion, Shown
from factory.render.validation.kept_references import FIRST, KeptReference, path_of
from factory.render.validation.scenes import Scene

SCENE = Scene("cube", "steel", "city", 3, 0.5, "full", 5.0, seed=11)


class Noise:
    """A renderer whose samples are random numbers; counts those that it has rendered."""

    def __init__(self, brightness=1.0):
        self.brightness, self.rendered = brightness, 0

    def portion(self, first, count, seed, tier):
        self.rendered += count
        each = [
            np.random.default_rng((seed, k)).random((4, 4, 3)) for k in range(first, first + count)
        ]
        noisy = np.mean(each, axis=0).astype(np.float32) * np.float32(self.brightness)
        return Portion(noisy, np.ones((4, 4), np.float32), noisy, noisy)


def reference(path, renderer, samples=64):
    result = KeptReference(Shown(renderer, 7, "full", np.ones((4, 4), bool)), path)
    if result.samples < samples:
        result.grow(samples - result.samples)
    return result


def test_a_second_measurement_renders_only_the_first_samples(tmp_path):
    path = tmp_path / "folder" / "kept.npz"
    one = reference(path, Noise())
    again = Noise()
    other = reference(path, again)
    assert again.rendered == 2 * FIRST
    assert other.samples == one.samples == 64
    for a, b in zip(one.means, other.means, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_it_grows_as_if_it_had_never_been_kept(tmp_path):
    kept = tmp_path / "kept.npz"
    reference(kept, Noise())
    renderer = Noise()
    grown = reference(kept, renderer, 100)
    assert renderer.rendered == 2 * (FIRST + 36)
    at_once = reference(tmp_path / "other.npz", Noise())
    at_once.grow(36)
    assert np.array_equal(grown.picture, at_once.picture)
    assert reference(kept, Noise(), 8).samples == 100


def test_another_picture_is_rendered_again(tmp_path):
    path = tmp_path / "kept.npz"
    reference(path, Noise())
    changed = Noise(brightness=1.0001)
    assert reference(path, changed).picture.mean() > reference(path, Noise()).picture.mean()
    assert changed.rendered == 2 * 64


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 cut off", b"no archive"])
def test_a_damaged_file_is_rendered_again(tmp_path, damage):
    path = tmp_path / "kept.npz"
    path.write_bytes(damage)
    renderer = Noise()
    reference(path, renderer)
    assert renderer.rendered == 2 * 64


def test_the_error_requested_does_not_change_the_file(tmp_path):
    from dataclasses import replace

    names = {
        path_of(tmp_path, scene, size)
        for scene in (SCENE, replace(SCENE, requested=20.0))
        for size in (64, 128)
    }
    assert len(names) == 2
    assert path_of(tmp_path, replace(SCENE, tier="direct"), 64) not in names
