"""Points: geometry looks through centres, and knows where Cycles' pixel shows two surfaces."""

from statistics import NormalDist

import numpy as np
import pytest

from factory.render import points
from manifests.facets import OTHERS


def seen(normal, segment, size=(4, 5)):
    """A Seen of one normal, which is also the facet's, and one segment; no mask where it is 0."""
    vectors = np.broadcast_to(np.asarray(normal, np.float32), (*size, 3)) * (segment > 0)
    return points.Seen(
        np.full(size, segment > 0), vectors, vectors, np.full(size, segment, np.uint8)
    )


def test_shares_of_other_surfaces_are_counted_and_the_nearest_point_of_each_is_kept():
    centre = seen([0, 0, 1], 1)
    turned = np.array([0, np.sin(0.1), np.cos(0.1)])  # 6 degrees
    barely = np.array([0, np.sin(0.03), np.cos(0.03)])
    like_turned = np.array([0, np.sin(0.13), np.cos(0.13)])
    background = seen([0, 0, 1], 0)
    around = [
        centre,
        seen(barely, 1),
        seen(turned, 1),
        seen([0, 0, 1], 2),
        seen(like_turned, 1),
        background,
    ]
    shares, others = points.others(centre, around)
    assert shares.shape == (OTHERS, 4, 5) and len(others) == OTHERS
    np.testing.assert_allclose(shares[:, 1, 2], [2 / 6, 1 / 6, 1 / 6, 0, 0, 0, 0])
    np.testing.assert_allclose(others[0].normals[2, 3], turned, atol=1e-6)
    assert (others[1].segments == 2).all() and others[1].mask.all()
    assert not others[2].mask.any() and not others[2].segments.any()  # the background
    assert not points.others(background, around)[0].any()
    assert not points.others(centre, [centre, seen(barely, 1)])[0].any()


def test_points_beyond_the_most_surfaces_count_to_the_one_that_is_most_alike():
    turned = [np.array([0, np.sin(a), np.cos(a)]) for a in (0.2, 0.5, 0.52, 0.75)]
    centre = seen([0, 0, 1], 1)
    shares, others = points.others(centre, [seen(n, 1) for n in turned], most=2)
    np.testing.assert_allclose(shares[:, 0, 0], [1 / 4, 3 / 4])
    np.testing.assert_allclose(others[1].normals[0, 0], turned[1], atol=1e-6)
    shares, _ = points.others(centre, [seen(turned[0], 1), seen([0, 0, 1], 0), centre], most=1)
    np.testing.assert_allclose(shares[0, 0, 0], 1 / 3)  # the background to the centre


def test_normals_that_face_away_are_a_surface_of_their_own():
    facing, away = ([1, 0, z] for z in (0.01, -0.01))
    shares, others = points.others(seen(facing, 1), [seen(facing, 1), seen(away, 1)])
    assert shares[0, 0, 0] == 0.5 and (others[0].normals[..., 2] < 0).all()


def test_points_stand_for_equal_parts_of_the_filter():
    places = np.array(points.offsets()) / points.DEVIATION
    lengths = np.linalg.norm(places, axis=1)
    assert len(places) == points.COUNT and (np.diff(lengths) >= 0).all()
    bell = NormalDist()
    for degrees in range(0, 180, 15):  # of edges through and beside the centre
        across = places @ [np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]
        for distance in (-1.5, -0.6, 0.0, 0.3, 1.1):
            assert abs((across < distance).mean() - bell.cdf(distance)) < 0.08


@pytest.mark.blender
def test_geometry_of_points_looks_through_the_centres(studio):
    """On a cube's planes, depth says where a ray passed: .0005 pixels would be 3e-5 or more."""
    from factory.render import camera
    from factory.shapes.primitives import cube
    from manifests.schema import Camera
    from shaders import frames

    lens = Camera(size=(12, 12), pixel="centre")
    mesh = cube()
    studio.set_camera(lens)
    studio.set_shape(mesh)
    studio.set_view(0.35)
    shot = studio.geometry()
    x, y = (grid * lens.half_extent for grid in frames.pixel_grid(*lens.size))
    corners = camera.vertices_from_camera(mesh.vertices, 0.35, lens)[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)
    across /= areas[:, None]
    cosines = shot.facets.normals[shot.mask] @ across.T
    face = cosines.argmax(1)
    n = across[face]
    height = (n * corners[face, 0]).sum(1)
    expected = (height - n[:, 0] * x[shot.mask] - n[:, 1] * y[shot.mask]) / n[:, 2]
    wide = areas[face] > 0.5 * areas.max()  # the bevels' facets are many and small
    inside = (shot.facets.share[shot.mask] == 0) & wide
    assert inside.sum() > 10
    off = np.abs(-shot.depth[shot.mask] - expected)[inside]
    slope = np.hypot(n[:, 0], n[:, 1])[inside] / n[inside, 2]
    assert (slope > 0.5).all() and off.max() < 1e-5
