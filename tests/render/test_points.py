"""Points: geometry looks through centres, and knows where Cycles' pixel shows two surfaces."""

from statistics import NormalDist

import numpy as np
import pytest

from factory.render import points


def seen(normal, segment, size=(4, 5)):
    """A Seen of one normal, which is also the facet's, and one segment; no mask where it is 0."""
    vectors = np.broadcast_to(np.asarray(normal, np.float32), (*size, 3)) * (segment > 0)
    return points.Seen(
        np.full(size, segment > 0), vectors, vectors, np.full(size, segment, np.uint8)
    )


def test_the_share_of_another_surface_is_counted_and_the_nearest_is_kept():
    centre = seen([0, 0, 1], 1)
    turned = np.array([0, np.sin(0.1), np.cos(0.1)])  # 6 degrees
    barely = np.array([0, np.sin(0.03), np.cos(0.03)])
    around = [centre, seen(barely, 1), seen(turned, 1), seen([0, 0, 1], 2), seen([0, 0, 1], 0)]
    share, other = points.other(centre, around)
    np.testing.assert_allclose(share, 3 / 5)
    np.testing.assert_allclose(other.normals[2, 3], turned, atol=1e-6)
    assert (other.segments == 1).all() and other.mask.all()
    share, other = points.other(centre, [centre, around[4], around[2]])
    np.testing.assert_allclose(share, 2 / 3)
    assert not other.mask.any() and not other.segments.any()  # the background
    assert not points.other(seen([0, 0, 1], 0), around)[0].any()


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
    corners = camera.seen(mesh.vertices, 0.35, lens)[mesh.faces]
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
