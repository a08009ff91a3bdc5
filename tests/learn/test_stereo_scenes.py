"""Normals of disparities are those of the surface, and their error is stated as large as it is."""

import numpy as np
import pytest

from learn.experiments.training import stereo_scenes
from manifests.errors import InputError
from shaders import frames
from tests.support import stereo_sphere


def ball(path):
    (each,) = stereo_scenes.objects_of(path, path.parent)
    size = len(each.mask)
    _, n = stereo_sphere.sphere(size)
    y, x = np.indices((size, size)) - (size - 1) / 2
    v = np.stack([-x, y, np.full_like(x, stereo_sphere.FOCAL)], -1)
    right = frames.turned_to_viewer(n, v / np.linalg.norm(v, axis=-1, keepdims=True))
    inner = each.valid & (right[..., 2] > 0.5)
    return each, stereo_scenes.angle(each.normals, right)[inner].mean()


def test_disparities_of_a_sphere_have_its_normals(tmp_path):
    each, error = ball(stereo_sphere.written(tmp_path / "a"))
    assert error < 2  # what the window rounds off
    assert each.valid.sum() > 0.9 * each.mask.sum()
    assert each.own["offset"] < 3


def test_rounded_disparities_are_worse_and_their_stated_noise_says_by_how_much(tmp_path):
    _, smooth = ball(stereo_sphere.written(tmp_path / "a"))
    each, rounded = ball(stereo_sphere.written(tmp_path / "b", step=1.0))
    assert rounded > smooth
    assert 0.3 < each.own["noise"] / rounded < 3


def test_a_wrong_offset_is_off_by_about_what_the_report_says(tmp_path):
    wrong = stereo_sphere.written(
        tmp_path / "a", offset=stereo_sphere.OFFSET + 30, offset_error=30.0
    )
    each, error = ball(wrong)
    _, right = ball(stereo_sphere.written(tmp_path / "b"))
    assert error > 2 * right
    assert 0.3 < each.own["offset"] / error < 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"picture": "../sphere.png"}, "sphere.png"),
        ({"objects": {"ball": "none.png"}}, "none.png"),
        ({"disparity": "mask.npz"}, "mask.npz"),
        ({"focal": "long"}, "focal"),
        ({"shapes": {"ball": "egg"}}, "egg"),
    ],
)
def test_what_is_wrong_with_a_description_is_a_line(tmp_path, changes, words):
    path = stereo_sphere.written(tmp_path / "a", **changes)
    with pytest.raises(InputError, match=words) as error:
        stereo_scenes.objects_of(path, path.parent)
    assert "\n" not in str(error.value)


def test_disparities_of_another_size_are_refused(tmp_path):
    path = stereo_sphere.written(tmp_path / "a")
    np.savez(tmp_path / "a" / "disparity.npz", np.ones((4, 5), np.float32))
    with pytest.raises(InputError, match="5 × 4"):
        stereo_scenes.objects_of(path, path.parent)
