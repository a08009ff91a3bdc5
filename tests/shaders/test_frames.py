"""World, light and camera frames: where the camera stands, what is up, and that turning the light
is rolling its map.
"""

import numpy as np
import pytest

from shaders import envmap, frames

AZIMUTHS = np.radians([0.0, 15.0, 90.0, 200.0, 345.0])


def towards_camera(azimuth, elevation):
    """Unit vector from the object to the camera, world frame, written from the words of
    shaders.frames.
    """
    return np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )


@pytest.mark.parametrize("azimuth", AZIMUTHS)
def test_frames_are_rotations(azimuth):
    for R in (
        frames.world_from_light(azimuth),
        frames.camera_from_light(),
        frames.camera_from_world(azimuth, 0.7),
    ):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize("elevation", np.radians([0.0, 20.0, 65.0]))
@pytest.mark.parametrize("azimuth", AZIMUTHS)
def test_the_cameras_z_axis_leads_from_the_object_to_the_camera(azimuth, elevation):
    z_camera = frames.camera_from_world(azimuth, elevation) @ towards_camera(azimuth, elevation)
    np.testing.assert_allclose(z_camera, [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize("azimuth", AZIMUTHS)
def test_world_up_is_upright_in_the_picture_and_leans_towards_a_camera_above(azimuth):
    up = frames.camera_from_world(azimuth, frames.ELEVATION) @ [0, 0, 1]
    np.testing.assert_allclose(
        up, [0, np.cos(frames.ELEVATION), np.sin(frames.ELEVATION)], atol=1e-15
    )


def test_seen_from_the_front_the_objects_left_side_is_on_the_pictures_right():
    left_of_object = frames.camera_from_world(0.0) @ [0, 1, 0]
    np.testing.assert_allclose(left_of_object, [1, 0, 0], atol=1e-15)


def test_light_frame_at_azimuth_zero_is_world_y_z_x():
    np.testing.assert_array_equal(frames.world_from_light(0.0), [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


def test_camera_from_light_is_the_same_at_every_azimuth():
    for azimuth in AZIMUTHS:
        R = frames.camera_from_world(azimuth) @ frames.world_from_light(azimuth)
        np.testing.assert_allclose(R, frames.camera_from_light(), atol=1e-15)


@pytest.mark.parametrize("texels", [0, 1, 5, 64, 127])
def test_turning_the_camera_by_whole_texels_rolls_the_map_it_sees(texels):
    """A light that stands still in the world is seen, from azimuth t·2π/W, as the stored map rolled
    by t columns.
    """
    height, width, row, column = 64, 128, 22, 100
    w_stored = envmap.directions(height, width)[0][row, column]
    w_world = frames.world_from_light(0.0) @ w_stored
    seen_direction = frames.world_from_light(2 * np.pi * texels / width).T @ w_world
    L = np.zeros((height, width, 3))
    L[row, column] = 1.0
    seen = envmap.roll(L, texels)[..., 0]
    assert seen[envmap.texel(seen_direction, height, width)] == 1.0


def test_one_lit_texel_towards_the_viewer_on_the_horizon_shines_from_below_the_view_axis():
    """φ = π/2 is towards the viewer; a camera 20° above the horizon sees that light 20° below its
    own axis.
    """
    # half a texel, 0.05°, from the horizon and from φ = π/2
    w = envmap.directions(2000, 4000)[0][1000, 1000]
    e = frames.ELEVATION
    np.testing.assert_allclose(
        frames.camera_from_light() @ w, [0, -np.sin(e), np.cos(e)], atol=2e-3
    )


def test_pixel_grid_is_centred_square_and_spans_the_longer_side():
    x, y = frames.pixel_grid(48, 64)
    assert x.shape == y.shape == (48, 64)
    np.testing.assert_allclose([x.sum(), y.sum()], 0, atol=1e-12)
    assert x[0, 1] - x[0, 0] == pytest.approx(y[0, 0] - y[1, 0]) == pytest.approx(2 / 64)
    assert x[0, -1] == pytest.approx(1 - 1 / 64) and y[0, 0] == pytest.approx(48 / 64 - 1 / 64)


def test_orthographic_view_is_straight_ahead_everywhere():
    assert (frames.view_vectors(5, 7) == [0, 0, 1]).all()


def test_perspective_views_meet_in_one_point():
    """Every pixel's vector leads from its place on the plane through the focus to one camera at
    distance 1/tan(fov/2).
    """
    fov = np.radians(35.0)
    x, y = frames.pixel_grid(24, 32)
    camera = np.array([0, 0, 1 / np.tan(fov / 2)])
    expected = camera - np.stack([x, y, 0 * x], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(frames.view_vectors(24, 32, fov), expected, atol=1e-15)


def test_the_focus_looks_straight_ahead_when_the_axis_is_off_centre():
    x, y = frames.pixel_grid(24, 32)
    v = frames.view_vectors(24, 32, 0.6, focus=(x[7, 20], y[7, 20]))
    np.testing.assert_allclose(v[7, 20], [0, 0, 1], atol=1e-15)


def test_roll_turns_what_is_seen_counter_clockwise_and_leaves_the_optical_axis():
    roll, azimuth, elevation = np.radians([30.0, 200.0, 50.0])
    upright = frames.camera_from_world(azimuth, elevation)
    rolled = frames.camera_from_world(azimuth, elevation, roll)
    np.testing.assert_allclose(rolled @ towards_camera(azimuth, elevation), [0, 0, 1], atol=1e-15)
    # what was to the right is now up and to the right
    right_in_world = upright.T @ [1, 0, 0]
    np.testing.assert_allclose(rolled @ right_in_world, [np.cos(roll), np.sin(roll), 0], atol=1e-15)
    np.testing.assert_allclose(frames.camera_from_upright(roll) @ upright, rolled, atol=1e-15)
    np.testing.assert_array_equal(frames.camera_from_world(azimuth, elevation, 0.0), upright)
