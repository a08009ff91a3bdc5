"""Elevation, roll and field of view of the camera, as Cycles sees them, against shaders.frames."""

import dataclasses

import numpy as np
import pytest

from manifests import ids
from manifests.schema import Camera, CameraRanges, Job
from shaders import frames

pytestmark = pytest.mark.blender

CAMERAS = [
    Camera(size=(96, 96)),
    Camera(size=(96, 96), roll_deg=30.0),
    Camera(size=(96, 96), elevation_deg=-10.0, roll_deg=-15.0, fov_deg=25.0),
    Camera(size=(64, 96), elevation_deg=60.0, roll_deg=15.0, fov_deg=60.0, half_extent=1.178),
]
AZIMUTH = 0.5


def rotation(camera):
    """camera_from_world (3, 3) of a Camera."""
    angles = np.radians([camera.elevation_deg, camera.roll_deg])
    return frames.camera_from_world(AZIMUTH, *angles)


@pytest.mark.parametrize("camera", CAMERAS)
def test_two_small_balls_appear_where_the_projection_puts_them(studio, camera):
    from factory.shapes.mesh import finish
    from factory.shapes.primitives import icosphere

    vertices, faces = icosphere(3)
    places = np.array([[0.5, 0.3, 0.6], [-0.5, -0.3, -0.6]])
    mesh = finish(
        "two balls",
        "primitive",
        np.vstack([0.06 * vertices + place for place in places]),
        np.vstack([faces, faces + len(vertices)]),
        segment=np.repeat([1, 2], len(faces)).astype(np.uint8),
    )
    studio.set_camera(camera)
    studio.set_shape(mesh)
    studio.set_view(AZIMUTH)
    shot = studio.geometry()
    x, y = frames.pixel_grid(*camera.size)
    for number in (1, 2):
        of_ball = mesh.vertices[np.unique(mesh.faces[mesh.segment == number])]
        seen = rotation(camera) @ (of_ball.max(0) + of_ball.min(0)) / 2
        spread = camera.half_extent  # half the frame at the ball's depth
        if camera.fov_deg is not None:
            spread -= np.tan(np.radians(camera.fov_deg) / 2) * seen[2]
        here = shot.segments == number
        assert here.any()
        found = np.array([x[here].mean(), y[here].mean()])
        # a tenth of the ball's radius, and less than half a pixel
        assert np.abs(found - seen[:2] / spread).max() < 0.006


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_given_normal_is_turned_into_the_camera_frame(studio, camera):
    from factory.shapes.primitives import disc

    towards_camera = rotation(camera)[2]
    leaning = towards_camera + 0.3 * np.array([0.2, -0.7, 0.4])
    leaning /= np.linalg.norm(leaning)
    mesh = disc()
    given = dataclasses.replace(
        mesh,
        corner_normals=np.broadcast_to(
            leaning.astype(np.float32), mesh.corner_normals.shape
        ).copy(),
    )
    studio.set_camera(camera)
    studio.set_shape(given)
    studio.set_view(AZIMUTH)
    shot = studio.geometry()
    assert shot.mask.sum() > 100
    assert np.abs(shot.normals[shot.mask] - rotation(camera) @ leaning).max() < 1e-5


def test_a_drawn_perspective_leaves_the_unit_sphere_in_the_frame(studio):
    """At 60° and the half extent of an orthographic camera, the sphere would be cropped."""
    from factory.shapes.primitives import sphere

    job = Job(
        shapes=("sphere",),
        materials=("x",),
        lights=("y",),
        camera=Camera(size=(64, 64)),
        camera_ranges=CameraRanges(fov_deg=(60.0, 60.0)),
    )
    studio.set_shape(sphere(5))
    studio.set_view(0.0)
    edges = {}
    for name, camera in (
        ("as drawn", ids.camera_of(job, "a" * 64, 0)),
        ("as given", Camera(size=(64, 64), fov_deg=60.0)),
    ):
        studio.set_camera(camera)
        mask = studio.geometry().mask
        edges[name] = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).sum()
        assert mask[32, 32]
    assert edges["as drawn"] == 0 and edges["as given"] > 20
