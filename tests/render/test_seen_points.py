"""What points of a picture see by our own rays, beside what Cycles shows of the same points."""

import msgspec
import numpy as np
import pytest

from factory.render.camera import vertices_from_camera
from factory.render.ray_tree import RayTree
from factory.render.seen_points import SeenPoints
from factory.shapes.catalogue import load
from manifests.schema import Camera

pytest.importorskip("numba")
RNG = np.random.default_rng(4)
SIZE = 32


def test_points_see_what_is_nearest_of_all_triangles():
    """Of 300 triangles in a heap, by the plain formula: depth, facet and segment."""
    from factory.shapes.mesh import finish

    centres = RNG.uniform(-1, 1, (300, 1, 3))
    corners = (centres + RNG.normal(size=(300, 3, 3)) * 0.2).reshape(-1, 3)
    faces, segment = np.arange(900).reshape(300, 3), RNG.integers(1, 4, 300)
    mesh = finish("heap", "test", corners, faces, segment=segment, parts=("a", "b", "c"))
    lens, azimuth, across, shift = Camera(size=(10, 12), elevation_deg=20.0), 0.4, 2, (0.25, -0.1)
    seen = SeenPoints(mesh, RayTree(mesh.vertices.astype(np.float32), mesh.faces))
    surface = seen.look(lens, azimuth, across, shift)
    there = vertices_from_camera(mesh.vertices, azimuth, lens)
    a, b, c = (there[mesh.faces[:, k]][None] for k in range(3))
    step = 2 * lens.half_extent / (12 * across)
    columns, rows = np.meshgrid(np.arange(12 * across), np.arange(10 * across))
    x = (columns.ravel() + 0.5 - 12 * across / 2 + shift[0]) * step
    y = (10 * across / 2 - rows.ravel() - 0.5 + shift[1]) * step
    origins = np.stack([x, y, np.zeros(len(x))], axis=1)[:, None]
    normal = np.cross(b - a, c - a)
    z = (normal * (a - origins)).sum(-1) / normal[..., 2]
    at = origins + z[..., None] * np.array([0, 0, 1.0])
    inside = np.ones(z.shape, bool)
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(other - one, at - one) * normal).sum(-1) >= 0
    z = np.where(inside, z, -np.inf)
    nearest, hit = z.argmax(1), inside.any(1)
    mask = surface.mask.ravel()
    assert 0.3 < hit.mean() < 1
    assert (mask != hit).mean() <= 0.005  # a ray along an edge may count to either side
    depth = np.full(len(hit), np.nan)
    depth[mask] = surface.depth
    same = np.abs(depth + z.max(1)) < 1e-4
    assert (same | ~hit).mean() >= 0.995
    facet, segments = np.zeros((len(hit), 3)), np.zeros(len(hit), int)
    facet[mask], segments[mask] = surface.facets, surface.segments
    unit = normal[0] / np.linalg.norm(normal[0], axis=1, keepdims=True)
    unit *= np.where(unit[:, 2:] < 0, -1, 1)
    np.testing.assert_allclose(facet[same], unit[nearest[same]], atol=2e-4)
    np.testing.assert_array_equal(segments[same], mesh.segment[nearest[same]])


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
    from factory.render.ray_kernels import lift

    corners = np.array([[1, 0], [np.cos(np.pi / 6), np.sin(np.pi / 6)]])
    vertices = np.array([[*corners[0], 0], [*corners[1], 0], [*corners[1], 1]])
    normals = np.array([[*corners[0], 0], [*corners[1], 0], [*corners[1], 0]])
    rising = np.einsum("kjc,kc->kj", vertices[None] - vertices[:, None], normals)
    rising, one = rising.astype(np.float32), np.float32(1)
    middle, corner = np.array([[0.5, 0.5, 0.0], [1, 0, 0]], np.float32)
    height = (1 - np.cos(np.pi / 6)) / 2
    assert lift(rising, one, middle) == pytest.approx(height, rel=1e-5)
    assert lift(rising, one, corner) == pytest.approx(0, abs=1e-6)
    # in a hollow, too: so far lies the rim above the plane at a corner, less what the middle does
    assert lift(rising, -one, middle) == pytest.approx(height, rel=1e-5)
    assert lift(0 * rising, one, middle) == 0  # flat
