"""The cameras that a job draws: from seed, shape and viewpoint alone, within the job's ranges; and
what stays as it was where nothing is drawn.
"""

import hashlib
import json

import msgspec
import numpy as np
import pytest

from manifests import ids
from manifests.line_files import encode
from manifests.schema import Camera, CameraRanges, Job

RANGES = CameraRanges(
    elevation_deg=(-10.0, 60.0), roll_deg=(-15.0, 15.0), fov_deg=(15.0, 60.0), perspective_share=0.5
)
JOB = Job(
    shapes=("cube",),
    materials=("m",),
    lights=("l",),
    camera=Camera(size=(16, 16), pixel="centre"),
    camera_ranges=RANGES,
    seed=3,
)
FIRST = "16 16 23.885 21.056 1.042566 centre roll -13.208"  # of shape 0, viewpoint 5
SHAPES = [hashlib.sha256(str(k).encode()).hexdigest() for k in range(200)]


def drawn(job=JOB):
    return [ids.camera_of(job, shape, view) for shape in SHAPES for view in range(8)]


def test_draws_lie_within_the_ranges_and_fill_them():
    cameras = drawn()
    for key, (low, high) in (("elevation_deg", (-10, 60)), ("roll_deg", (-15, 15))):
        values = np.array([getattr(camera, key) for camera in cameras])
        assert low <= values.min() < low + 1 and high - 1 < values.max() <= high
        # the mean of 1,600 uniform draws; five standard errors
        assert abs(values.mean() - (low + high) / 2) < 5 * (high - low) / np.sqrt(12 * 1600)
    fov = [camera.fov_deg for camera in cameras if camera.fov_deg is not None]
    assert abs(len(fov) / len(cameras) - 0.5) < 5 * np.sqrt(0.25 / 1600)
    assert 15 <= min(fov) < 16 and 59 < max(fov) <= 60


def test_the_sphere_fills_the_frame_in_perspective_as_without():
    """The ray that touches the unit sphere leaves the axis by asin(1/d); d from half_extent."""
    for camera in drawn():
        if camera.fov_deg is None:
            assert camera.half_extent == 1.02
            continue
        half = np.radians(camera.fov_deg) / 2
        distance = camera.half_extent / np.tan(half)
        touching = np.tan(np.arcsin(1 / distance)) / np.tan(half)
        assert touching < 1 and camera.half_extent == pytest.approx(1.02 / np.cos(half), abs=1e-6)


def test_a_draw_depends_on_seed_shape_and_viewpoint_alone():
    first = ids.camera_of(JOB, SHAPES[0], 5)
    assert len({ids.camera_words(camera) for camera in drawn()}) > 1550
    other = msgspec.structs.replace(JOB, shapes=("a", "b"), lights=("x",), views=(5, 7), name="n")
    assert ids.camera_of(other, SHAPES[0], 5) == first
    assert ids.camera_of(msgspec.structs.replace(JOB, seed=4), SHAPES[0], 5) != first
    # another machine must draw the same: ids are hashes of these numbers
    assert ids.camera_words(first) == FIRST


def test_a_range_that_is_added_leaves_the_other_draws():
    alone = CameraRanges(roll_deg=(-15.0, 15.0))
    with_roll = drawn(msgspec.structs.replace(JOB, camera_ranges=alone))
    assert [camera.roll_deg for camera in with_roll] == [camera.roll_deg for camera in drawn()]
    assert {(c.elevation_deg, c.fov_deg, c.half_extent) for c in with_roll} == {(20.0, None, 1.02)}


def test_without_roll_words_and_files_are_those_of_before_there_was_one():
    assert ids.camera_words(Camera()) == "256 256 orthographic 20.0 1.02"
    assert ids.camera_words(Camera(roll_deg=-0.0)) == ids.camera_words(Camera())
    assert ids.camera_words(Camera(roll_deg=4)).endswith(" roll 4.0")
    job = msgspec.structs.replace(JOB, camera_ranges=None, name=',"roll_deg":0.0')
    held = json.loads(encode(job))
    assert "roll_deg" not in held["camera"] and "camera_ranges" not in held
    assert held["name"] == ',"roll_deg":0.0'
    assert msgspec.json.decode(encode(job), type=Job) == job


@pytest.mark.parametrize("roll", [0.001, -15.0])
def test_roll_and_ranges_are_written_where_they_have_an_effect(roll):
    job = msgspec.structs.replace(JOB, camera=Camera(roll_deg=roll))
    assert msgspec.json.decode(encode(job), type=Job) == job
