"""Normals, depth, mask and segments, as Blender gives them, against what they are."""

import dataclasses

import numpy as np
import pytest

pytestmark = pytest.mark.blender


def test_normals_of_a_sphere_are_its_analytic_ones(studio):
    from factory.render.validation import closed_forms

    figures = closed_forms.geometry(studio, size=96, level=6)
    assert figures["max_deg"] <= 0.1
    assert figures["length_error"] <= 1e-3
    # pixels whose centre lies within the mesh's sagitta of the silhouette
    assert figures["mask_pixels"] <= 2
    assert figures["depth_error"] <= 1e-3


def test_given_corner_normals_come_back_to_float_precision(studio):
    """A flat disc whose corner normals lean by 30°: what is seen is the given normal, not the
    face's.
    """
    from factory.render.camera import camera_from_fixed_world
    from factory.shapes.primitives import disc
    from manifests.schema import Camera

    mesh = disc()
    leaning = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])
    given = dataclasses.replace(
        mesh,
        corner_normals=np.broadcast_to(
            leaning.astype(np.float32), mesh.corner_normals.shape
        ).copy(),
    )
    studio.set_camera(Camera(size=(32, 32)))
    studio.set_shape(given)
    studio.set_view(0.0)
    shot = studio.geometry()
    expected = camera_from_fixed_world(Camera()) @ leaning
    # Blender's split normals would be 5e-5 off
    assert np.abs(shot.normals[shot.mask] - expected).max() < 1e-6


def test_a_sharp_edge_keeps_both_its_normals(studio):
    from factory.render.body import split_by_normal
    from factory.shapes.catalogue import load

    mesh = load("chair:3")
    vertices, normals, faces = split_by_normal(mesh.vertices, mesh.faces, mesh.corner_normals)
    np.testing.assert_array_equal(normals[faces], mesh.corner_normals)
    np.testing.assert_array_equal(vertices[faces], mesh.vertices[mesh.faces].astype(np.float32))
    assert len(vertices) < mesh.faces.size  # shared where they can be


def test_segments_are_those_of_the_faces_seen(studio):
    """The upper half of a sphere is segment 2: seen from above the horizon, pixels whose world z is
    above 0 are.
    """
    from factory.render.camera import camera_from_fixed_world
    from factory.render.validation import reference
    from factory.shapes.primitives import sphere
    from manifests.schema import Camera

    mesh = sphere(5)
    upper = mesh.vertices[mesh.faces].mean(1)[:, 2] > 0
    halves = dataclasses.replace(mesh, segment=(1 + upper).astype(np.uint8))
    studio.set_camera(Camera(size=(64, 64)))
    studio.set_shape(halves)
    studio.set_view(2.0)
    shot = studio.geometry()
    spots = reference.pixel_spots(64, 1.02)
    z = (reference.sphere_normals(spots.reshape(-1, 2)) @ camera_from_fixed_world(Camera()))[
        :, 2
    ].reshape(64, 64)
    clear = shot.mask & (np.abs(z) > 0.06)  # a face's height
    assert ((shot.segments == 2) == (z > 0))[clear].all()
    assert set(np.unique(shot.segments)) == {0, 1, 2}


def test_turning_the_object_is_the_view_from_that_azimuth(studio):
    """A small ball at the object's front-left (x, y > 0): from azimuth 45° it is in front, from
    −45° on the right.
    """
    from factory.shapes.mesh import finish
    from factory.shapes.primitives import icosphere
    from manifests.schema import Camera

    vertices, faces = icosphere(3)
    small = 0.2 * vertices + np.array([0.7, 0.7, 0.0]) * 0.8
    # keeps the enclosing sphere's centre near the origin
    far = 0.01 * vertices - np.array([0.7, 0.7, 0.0])
    mesh = finish(
        "two balls", "primitive", np.vstack([small, far]), np.vstack([faces, faces + len(vertices)])
    )
    studio.set_camera(Camera(size=(64, 64)))
    studio.set_shape(mesh)
    columns = {}
    for degrees in (45, -45, 135):
        studio.set_view(np.radians(degrees))
        shot = studio.geometry()
        columns[degrees] = np.nonzero(shot.mask)[1].mean()
    assert abs(columns[45] - 31.5) < 4
    # the camera's right is world (s, −c): at −45° the point (1, 1) lies on it
    assert columns[-45] > 45
    assert columns[135] < 18


def test_normals_face_the_viewer_in_perspective_too(studio):
    from factory.render.camera import view_vectors
    from factory.shapes.mesh import finish
    from factory.shapes.primitives import icosphere
    from manifests.schema import Camera

    vertices, faces = icosphere(1)  # so coarse that smooth normals lean over the horizon
    mesh = finish("coarse", "primitive", vertices, faces, normals=vertices[faces])
    for lens in (Camera(size=(48, 48)), Camera(size=(48, 48), fov_deg=50.0)):
        studio.set_camera(lens)
        studio.set_shape(mesh)
        shot = studio.geometry()
        cosine = (shot.normals * view_vectors(lens)).sum(-1)[shot.mask]
        assert cosine.min() >= 1e-3 - 1e-6
        assert np.abs(np.linalg.norm(shot.normals[shot.mask], axis=-1) - 1).max() < 1e-6
