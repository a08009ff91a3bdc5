"""What points of a picture see by our own rays, beside what Cycles shows of the same points."""

import msgspec
import numpy as np
import pytest

from factory.render.ray_tree import RayTree
from factory.render.seen_points import SeenPoints, _lift
from factory.shapes.catalogue import load
from manifests.schema import Camera

pytest.importorskip("numba")
RNG = np.random.default_rng(4)
SIZE = 32


def test_rays_meet_first_what_is_nearest_of_all_triangles():
    centres = RNG.uniform(-1, 1, (300, 1, 3))
    corners = (centres + RNG.normal(size=(300, 3, 3)) * 0.2).astype(np.float32)
    vertices, faces = corners.reshape(-1, 3), np.arange(900).reshape(300, 3)
    origins = RNG.uniform(-1, 1, (400, 3)) + np.array([0, 0, 4])
    towards = np.array([0.1, -0.2, -1])
    towards /= np.linalg.norm(towards)
    met = RayTree(vertices, faces).look(origins, towards)
    a, b, c = (corners[:, k].astype(float)[None] for k in range(3))
    normal = np.cross(b - a, c - a)
    t = (normal * (a - origins[:, None])).sum(-1) / (normal @ towards)
    at = origins[:, None] + t[..., None] * towards
    inside = t > 0
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(other - one, at - one) * normal).sum(-1) >= 0
    t = np.where(inside, t, np.inf)
    nearest = np.where(inside.any(1), t.argmin(1), -1)
    assert (nearest < 0).any() and (nearest >= 0).mean() > 0.3
    assert (met.face != nearest).mean() <= 0.005  # a ray along an edge may count to either side
    same = (met.face == nearest) & (nearest >= 0)
    np.testing.assert_allclose(met.distance[same], t.min(1)[same], rtol=1e-4)
    u, v = met.place[same].T
    first, second, third = (corners[met.face[same], k] for k in range(3))
    there = first + u[:, None] * (second - first) + v[:, None] * (third - first)
    place = origins[same] + met.distance[same][:, None] * towards
    np.testing.assert_allclose(there, place, atol=2e-4)


def pasted(surface, name):
    values = getattr(surface, name)
    frame = np.zeros((*surface.mask.shape, *values.shape[1:]))
    frame[surface.mask] = values
    return frame


def page():
    """A sheet that is open and bent, of which this side and that are seen."""
    from factory.shapes.mesh import finish

    x = np.linspace(-1, 1, 9)
    edge = np.stack([x, 0.8 * x**2, np.full(9, -0.5)], axis=1)
    corners = np.concatenate([edge, edge + np.array([0.2, 0.3, 1.0])])
    faces = [[k, k + 1, k + 10] for k in range(8)] + [[k, k + 10, k + 9] for k in range(8)]
    return finish("page", "test", corners, np.array(faces), crease_deg=60.0)


@pytest.mark.blender
@pytest.mark.parametrize("shape", ["chair:2", "vessel:1", "sphere", "page"])
def test_points_see_what_cycles_shows(studio, shape):
    mesh = page() if shape == "page" else load(shape)
    lens, azimuth = Camera(size=(SIZE, SIZE), elevation_deg=25.0), 0.7
    across, shift = 4, (-0.375, -0.125)
    seen = SeenPoints(mesh, RayTree(mesh.vertices.astype(np.float32), mesh.faces))
    ours = seen.look(lens, azimuth, across, shift)
    studio.set_camera(msgspec.structs.replace(lens, size=(SIZE * across, SIZE * across)))
    studio.set_shape(mesh)
    studio.set_light(np.ones((64, 128, 3), np.float32), 0)
    studio.set_view(azimuth)
    theirs = studio._surface(*shift)
    assert (ours.mask != theirs.mask).sum() <= 2
    both = ours.mask & theirs.mask
    assert both.sum() > 2000
    assert ours.lift.min() >= 0 and ours.lift.max() > 1e-4
    for name, most in (("normals", 3e-3), ("facets", 3e-3), ("depth", 1e-3), ("segments", 0)):
        off = np.abs(pasted(ours, name) - pasted(theirs, name))[both].reshape(both.sum(), -1)
        assert (off.max(1) > most).mean() <= 0.003, name


def test_pixels_that_are_named_see_the_same_as_all():
    mesh, lens = load("chair:2"), Camera(size=(SIZE, SIZE // 2), elevation_deg=10.0)
    seen = SeenPoints(mesh, RayTree(mesh.vertices.astype(np.float32), mesh.faces))
    every = seen.look(lens, 0.3, 2, (0.25, 0.25))
    where = RNG.random(lens.size) < 0.4
    some = seen.look(lens, 0.3, 2, (0.25, 0.25), where)
    fine = where.repeat(2, 0).repeat(2, 1)
    np.testing.assert_array_equal(some.mask, every.mask & fine)
    assert 0 < some.mask.sum() < every.mask.sum()
    for ours, theirs in zip(some[1:], every[1:], strict=True):
        np.testing.assert_array_equal(ours, theirs[fine[every.mask]])


def test_no_pixels_see_nothing():
    mesh = load("cube")
    seen = SeenPoints(mesh, RayTree(mesh.vertices.astype(np.float32), mesh.faces))
    lens = Camera(size=(SIZE, SIZE))
    surface = seen.look(lens, 0.0, 4, (0.0, 0.0), np.zeros(lens.size, bool))
    assert not surface.mask.any() and surface.normals.shape == (0, 3)


def test_a_seam_of_two_triangles_has_no_holes():
    """Points of a grid lie on the diagonal of a square that fills the frame."""
    from factory.shapes.mesh import finish

    corners = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = finish("square", "test", corners, faces, crease_deg=10.0)
    seen = SeenPoints(mesh, RayTree(mesh.vertices.astype(np.float32), mesh.faces))
    surface = seen.look(Camera(size=(64, 64), elevation_deg=0.0), 0.0, 4, (0.0, 0.0))
    rows, columns = np.nonzero(surface.mask)
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert min(height, width) > 100 and surface.mask.sum() == height * width


def test_points_are_lifted_to_the_planes_that_touch_the_smooth_surface():
    """Of a tube of twelve sides, whose planes at the ends of a chord meet above its middle."""
    corners = np.array([[1, 0], [np.cos(np.pi / 6), np.sin(np.pi / 6)]])
    vertices = np.array([[*corners[0], 0], [*corners[1], 0], [*corners[1], 1]])
    normals = np.array([[*corners[0], 0], [*corners[1], 0], [*corners[1], 0]])
    rising = np.einsum("kjc,kc->kj", vertices[None] - vertices[:, None], normals)[None]
    middle = np.array([[0.5, 0.5, 0.0]])
    height = (1 - np.cos(np.pi / 6)) / 2
    assert _lift(rising, middle)[0] == pytest.approx(height, rel=1e-5)
    assert _lift(rising, np.eye(3)[:1])[0] == pytest.approx(0, abs=1e-6)  # at a corner
    # in a hollow, too: so far lies the rim above the plane at a corner, less what the middle does
    assert _lift(-rising, middle)[0] == pytest.approx(height, rel=1e-5)
    assert _lift(0 * rising, middle)[0] == 0  # flat
