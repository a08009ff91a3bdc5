"""Pixels read from Cycles' own result are those that Blender would write, and a window shows what
the whole frame shows.
"""

import numpy as np
import OpenEXR
import pytest

pytestmark = pytest.mark.blender


@pytest.fixture
def chair(studio):
    from factory.render.validation import reference
    from factory.shapes.catalogue import load
    from shaders.mixture import Mixture

    mesh = load("chair:3")
    studio.set_shape(mesh)
    studio.set_light(reference.soft_light())
    studio.set_materials([Mixture.lambert([0.5, 0.4, 0.3])] * mesh.segments)
    studio.set_view(1.0)
    return studio


def test_pixels_equal_blenders_own_file_bit_for_bit(chair, tmp_path):
    import bpy

    from factory.render import render_result
    from manifests.quiet import silenced
    from manifests.schema import Camera

    chair.set_camera(Camera(size=(40, 56)))
    chair.picture(2, 3)
    scene = chair._scene
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = (
        "OPEN_EXR",
        "32",
    )
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.filepath = str(tmp_path / "blender.exr")
    with silenced(1):
        bpy.ops.render.render(scene=scene.name, write_still=True)
    with OpenEXR.File(str(tmp_path / "blender.exr")) as file:
        np.testing.assert_array_equal(
            render_result._passes["Combined"], file.channels()["RGBA"].pixels
        )


@pytest.mark.parametrize("fov_deg", [None, 50.0])
def test_a_window_shows_the_pixels_of_the_whole_frame_noise_and_all(chair, fov_deg):
    from factory.render import render_result, window
    from manifests.schema import Camera

    chair.set_camera(Camera(size=(40, 56), fov_deg=fov_deg))
    radiance, alpha = chair.picture(2, 3)
    mask = chair.geometry().mask
    top, bottom, left, right = window.around(chair._vertices, 1.0, chair._lens)
    assert (bottom - top) * (right - left) < 40 * 56  # a window indeed
    for way, expected in (
        ("picture", np.concatenate([radiance, alpha[..., None]], axis=-1)),
        ("geometry", mask),
    ):
        chair._show(way)
        chair._scene.cycles.samples = 2 if way == "picture" else 1
        chair._scene.cycles.seed = 3
        chair._scene.render.use_border = False
        whole = render_result.render_passes(chair._scene)["Combined"]
        np.testing.assert_array_equal(whole if way == "picture" else whole[..., 3] > 0.5, expected)


def test_an_object_beyond_the_frame_is_cut_off_not_refused(chair):
    from manifests.schema import Camera

    chair.set_camera(Camera(size=(24, 24), half_extent=0.3))
    radiance, alpha = chair.picture(1, 0)
    assert radiance.shape == (24, 24, 3) and alpha.max() > 0


def test_rendering_prints_nothing(chair, capfd):
    from manifests.schema import Camera

    chair.set_camera(Camera(size=(16, 16)))
    chair.render(1, 0)
    assert capfd.readouterr().out == ""


def test_a_pixel_is_its_squares_mean_or_its_centres_point_as_the_camera_says(chair):
    from manifests.schema import Camera

    chair.set_camera(Camera(size=(48, 48)))
    _, share = chair.picture(16, 3)
    mixed = ((share > 0.01) & (share < 0.99)).sum()
    assert mixed > 50  # the outline of a chair crosses more pixels than that
    chair.set_camera(Camera(size=(48, 48), pixel="centre"))
    _, point = chair.picture(16, 3)
    # an edge through the very centre still splits the .01 px of the filter
    partial = (point > 0.01) & (point < 0.99)
    assert partial.sum() <= 0.05 * mixed
    disagree = (point > 0.5) != chair.geometry().mask
    assert (disagree & ~partial).sum() == 0
    assert chair.settings["picture"]["cycles.pixel_filter_type"]["value"] == "GAUSSIAN"
    chair.set_camera(Camera(size=(48, 48)))
    np.testing.assert_array_equal(chair.picture(16, 3)[1], share)


def test_a_camera_within_the_object_sees_the_whole_frame():
    """A corner behind the camera falls on a place of its own in the frame, and what leads there may
    cross all of it.
    """
    from factory.render import camera, window
    from manifests.schema import Camera

    lens = Camera(size=(40, 56), fov_deg=120.0)
    away = camera.distance(lens)
    assert away < 1
    # right, up, towards the camera
    seen = np.array([(-0.1, -0.2, -0.5), (0.1, -0.2, -0.5), (0.0, -0.05, away + 0.2)])
    vertices = seen @ camera.camera_from_fixed_world(lens)
    assert window.around(vertices, 0.0, lens) == (0, 40, 0, 56)
    top, bottom, left, right = window.around(vertices[[0, 1, 0]], 0.0, lens)
    assert (bottom - top) * (right - left) < 200
