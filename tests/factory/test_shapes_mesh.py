"""Normals, creases, the enclosing sphere, hashes and primitives."""

import numpy as np
import pytest

from factory.shapes.catalogue import load
from factory.shapes.creases import corner_normals, edge_pairs
from factory.shapes.enclosing import smallest_sphere
from factory.shapes.mesh import finish, geometry_hash
from factory.shapes.primitives import icosphere
from factory.shapes.raster import look
from factory.shapes.rounded_boxes import rounded_box
from manifests.errors import InputError
from shaders.frames import camera_from_world


def box():
    """A unit cube of twelve triangles."""
    from scipy.spatial import ConvexHull

    vertices = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    hull = ConvexHull(vertices)
    faces = hull.simplices.copy()
    for f, normal in zip(faces, hull.equations[:, :3], strict=True):
        if np.cross(vertices[f[1]] - vertices[f[0]], vertices[f[2]] - vertices[f[0]]) @ normal < 0:
            f[1:] = f[:0:-1]
    return vertices, faces


def test_sphere_normals_are_its_points_to_the_last_bit_of_a_float32():
    for spec in ("sphere", "sphere:3"):
        mesh = load(spec)
        assert np.array_equal(mesh.corner_normals, mesh.vertices[mesh.faces].astype(np.float32))
        assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max() < 1e-12


def test_interpolated_sphere_normals_stay_within_a_tenth_of_a_degree_inside_the_silhouette():
    """What a renderer interpolates across the facets, against the analytic normal at each pixel, up
    to 80° from the view.
    """
    mesh, camera = load("sphere"), camera_from_world(0.4)
    face, weight = look(mesh.vertices, mesh.faces, camera, 128)
    hit = face >= 0
    result = np.einsum("pc,pci->pi", weight[hit], mesh.corner_normals[face[hit]]) @ camera.T
    result /= np.linalg.norm(result, axis=1, keepdims=True)
    centre = (np.arange(128) + 0.5) / 64 - 1
    x, y = (
        np.broadcast_to(centre * 1.02, (128, 128))[hit],
        np.broadcast_to(-centre[:, None] * 1.02, (128, 128))[hit],
    )
    inside = x**2 + y**2 < np.sin(np.radians(80)) ** 2
    truth = np.stack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))], 1)
    angle = np.degrees(2 * np.arcsin(np.linalg.norm(result - truth, axis=1) / 2))
    assert angle[inside].max() < 0.1


@pytest.mark.parametrize(
    ("spec", "degrees"), [("cube", 9), ("torus", 0.5), ("blob", 0.5), ("blob:5", 0.5)]
)
def test_analytic_normals_agree_with_the_facets(spec, degrees):
    """The facets' own mean is off by a share of a facet's turn: 7.5° on the cube's bevels, 5.6°
    round the tube, 1.5° on the blob.
    """
    mesh = load(spec)
    smooth = corner_normals(mesh.vertices, mesh.faces, 60)
    cosine = (smooth * mesh.corner_normals).sum(2)
    assert mesh.report.watertight
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < degrees


def test_a_cubes_edges_stay_sharp_below_a_right_angle_and_become_smooth_above():
    vertices, faces = box()
    flat = corner_normals(vertices, faces, 45)
    corners = vertices[faces]
    facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # each side of the unit cube: cross product of length 1
    assert np.abs(flat - facet[:, None]).max() < 1e-6
    round_ = corner_normals(vertices, faces, 91)
    assert np.abs(round_ - corners / np.linalg.norm(corners, axis=2, keepdims=True)).max() < 1e-6


def test_a_fold_is_smooth_or_sharp_by_its_angle():
    for fold, crease, smooth in ((40, 45, True), (50, 45, False)):
        c, s = np.cos(np.radians(fold)), np.sin(np.radians(fold))
        vertices = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-c, 0, s]])
        normals = corner_normals(vertices, np.array([[0, 2, 1], [0, 1, 3]]), crease)
        assert np.allclose(normals[0, 0], normals[1, 0], atol=1e-6) == smooth


def test_a_blade_keeps_its_faces_own_normals():
    """Two faces almost back to back: their mean lies in the blade's plane and would shade neither
    side.
    """
    vertices = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0.02], [1, 0, -0.02]])
    faces = np.array([[0, 2, 1], [0, 1, 3]])
    corners = vertices[faces]
    facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facet /= np.linalg.norm(facet, axis=1, keepdims=True)
    normals = corner_normals(vertices, faces, 180)
    assert (normals * facet[:, None]).sum(2).min() > 0.99 and np.abs(
        np.linalg.norm(normals, axis=2) - 1
    ).max() < 1e-6


def test_the_smallest_sphere_is_exact():
    rng = np.random.default_rng(3)
    for points, centre, radius in (
        (np.array([[0, 0, 0], [2, 0, 0], [1, 0.3, 0.0]]), (1, 0, 0), 1.0),
        (
            np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float),
            (0.5, 0.5, 0.5),
            3**0.5 / 2,
        ),
        (icosphere(3)[0] * 2 + 5, (5, 5, 5), 2.0),
    ):
        result = smallest_sphere(points)
        assert np.allclose(result[0], centre, atol=1e-7) and abs(result[1] - radius) < 1e-9
    points = rng.normal(size=(500, 3))
    centre, radius = smallest_sphere(points)
    assert np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + 1e-12)
    nudges = rng.normal(size=(200, 3)) * 1e-3
    # no other centre does better
    assert all(np.linalg.norm(points - centre - d, axis=1).max() > radius for d in nudges)


def test_the_hash_knows_neither_names_nor_order():
    vertices, faces = rounded_box([1, 0.6, 0.4], 0.1)
    rng = np.random.default_rng(1)
    order, shuffle = rng.permutation(len(vertices)), rng.permutation(len(faces))
    renamed = np.roll(np.argsort(order)[faces[shuffle]], 1, axis=1)
    one = finish("one", "chair", vertices, faces)
    two = finish("two", "sofa", vertices[order] * 3 + [4, 5, 6], renamed)
    assert one.hash == two.hash and len(one.hash) == 64


def test_the_hash_knows_geometry_winding_and_segments():
    vertices, faces = rounded_box([1, 0.6, 0.4], 0.1)
    segment = np.ones(len(faces), np.uint8)
    base = geometry_hash(vertices, faces, segment)
    moved = vertices.copy()
    moved[7, 0] += 1e-4
    segment_two = segment.copy()
    segment_two[0] = 2
    others = [
        geometry_hash(moved, faces, segment),
        geometry_hash(vertices, faces[:, ::-1], segment),
        geometry_hash(vertices, faces, segment_two),
    ]
    assert len({base, *others}) == 4


def test_a_mesh_cannot_be_written_to():
    mesh = load("disc")
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 0


def test_edges_of_more_than_two_faces_are_counted():
    fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert sorted(edge_pairs(fan)[3]) == [1, 1, 1, 1, 1, 1, 3]


def test_points_of_no_area_are_refused():
    with pytest.raises(
        InputError, match="expected a mesh with a surface, found 1 triangle of no area"
    ):
        finish("line", "x", np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]]))


def test_another_crease_angle_is_another_shape():

    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    hashes = [
        finish(name, "primitive", vertices, faces, crease_deg=angle).hash
        for name, angle in (("a", 30), ("b", 30.0), ("c", 60))
    ]
    assert hashes[0] == hashes[1] != hashes[2]
