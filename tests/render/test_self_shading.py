"""Objects that cannot shade themselves: by their vertices, and by Cycles."""

import numpy as np
import pytest

from factory.render import camera
from factory.render.self_shading import (
    FEW,
    TOLERANCE,
    WIDER,
    are_known,
    has_convex_side,
    may_shade_itself,
)
from manifests.schema import Camera
from shaders.mixture import Mixture

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
UP = np.array([0, 0, 1], np.float32)


def seen(count=100, height=0.0, raised=0):
    """Facets of a square that face the viewer, of which some lie lower by `height`."""
    points = np.zeros((count, 3), np.float32)
    points[:raised, 2] = -height
    return np.repeat(UP[None], count, 0), points


def test_a_vertex_above_a_visible_facet_may_shade_it():
    assert not may_shade_itself(SQUARE, *seen())
    above = np.concatenate([SQUARE, [[0, 0, 0.01]]]).astype(np.float32)
    assert may_shade_itself(above, *seen())
    below = np.concatenate([SQUARE, [[0, 0, -0.5]]]).astype(np.float32)
    assert not may_shade_itself(below, *seen())


def test_few_facets_may_lie_a_little_lower():
    few = int(100 * FEW)
    assert not may_shade_itself(SQUARE, *seen(height=0.9 * WIDER, raised=few))
    assert may_shade_itself(SQUARE, *seen(height=0.9 * WIDER, raised=few + 1))
    assert may_shade_itself(SQUARE, *seen(height=1.1 * WIDER, raised=1))


def test_nothing_visible_shades_nothing():
    assert not may_shade_itself(SQUARE, np.zeros((0, 3)), np.zeros((0, 3)))


def test_a_mesh_without_outer_facets_is_left_out_at_once():
    rng = np.random.default_rng(1)
    triangle = SQUARE[:3] - SQUARE[:3].mean(0)
    # an outer square before a heap of triangles that face every side
    heap = 0.01 * triangle @ np.linalg.qr(rng.normal(size=(500, 3, 3)))[0]
    heap = heap + rng.uniform(-1, 0, (500, 1, 3)) - [0, 0, 0.1]
    corners = np.concatenate([SQUARE[None, :3], heap])
    assert not has_convex_side(corners.reshape(-1, 3), corners)
    assert has_convex_side(SQUARE, SQUARE[None, :3])


@pytest.mark.blender
@pytest.mark.parametrize(
    ("name", "convex"), [("sphere:2", True), ("cube", True), ("torus", False), ("chair:2", False)]
)
def test_cycles_shows_the_same_where_an_object_cannot_shade_itself(studio, name, convex):
    from factory.lights import load as load_light
    from factory.shapes.catalogue import load

    mesh = load(name)
    studio.set_camera(Camera(size=(40, 40)))
    studio.set_shape(mesh)
    studio.set_light(load_light("night").L64, 5)
    studio.set_materials([Mixture.lambert([0.6] * 3)] * mesh.segments)
    studio.set_view(0.4)
    assert studio.may_shade_itself() != convex
    full, direct = (studio.portion(0, 16, 3, tier).noisy for tier in ("full", "direct"))
    assert np.array_equal(full, direct) == convex


@pytest.mark.blender
def test_it_depends_on_the_side(studio, tmp_path):
    import trimesh

    from factory.shapes.catalogue import load

    box = trimesh.creation.box((1, 1, 1))
    behind = trimesh.creation.box((0.5, 0.2, 0.2)).apply_translation((-0.6, 0, 0))
    (tmp_path / "box.obj").write_text(trimesh.util.concatenate([box, behind]).export(None, "obj"))
    studio.set_camera(Camera(size=(40, 40)))
    studio.set_shape(load(tmp_path / "box.obj", up="z", front="x"))
    for azimuth, shaded in ((0.0, False), (np.pi, True), (0.0, False)):
        studio.set_view(azimuth)
        assert studio.may_shade_itself() == shaded


def test_a_facet_that_could_lean_either_way_is_not_known():
    rng = np.random.default_rng(2)
    facets = rng.normal(size=(4000, 3))
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)
    views = np.array([0.0, 0.0, 1.0]) + 0.5 * rng.normal(size=(4000, 3)) * [1, 1, 0]
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    facets *= np.sign(np.einsum("pi,pi->p", facets, views))[:, None]  # they face the viewer
    rendered = facets * [1, 1, np.nan]
    rendered[:, 2] = np.sqrt(np.maximum(1 - (rendered[:, :2] ** 2).sum(1), 0))
    known = np.array(
        [are_known(*pair) for pair in zip(rendered[:, None], views[:, None], strict=True)]
    )
    away = facets[:, 2] < 0
    assert away.sum() > 100 and not known[away].any()
    assert known.sum() > 2000 and not are_known(rendered, views)


@pytest.mark.blender
@pytest.mark.parametrize(("fov", "half_extent"), [(None, 1.02), (20.0, 1.05), (60.0, 0.7)])
def test_points_of_the_surface_are_where_the_mesh_is(studio, tmp_path, fov, half_extent):
    import trimesh

    from factory.shapes.catalogue import load

    (tmp_path / "box.obj").write_text(trimesh.creation.box((1, 1, 1)).export(None, "obj"))
    studio.set_camera(Camera(size=(24, 40), fov_deg=fov, half_extent=half_extent))
    studio.set_shape(load(tmp_path / "box.obj", up="z", front="x"))
    studio.set_view(0.7)
    at, lens = studio._surface(), studio._require_camera()
    points = camera.points(lens, at.mask, at.depth)
    # back in the object's frame each point lies on one of the box's faces
    inside = np.abs(points @ camera.vertices_from_camera(np.eye(3), 0.7, lens).T)
    half = np.abs(studio._vertices).max()
    np.testing.assert_allclose(inside.max(1), half, rtol=0, atol=TOLERANCE / 4)


@pytest.mark.blender
@pytest.mark.parametrize(
    ("name", "convex"), [("sphere:2", True), ("cube", True), ("torus", False), ("chair:2", False)]
)
def test_it_is_the_same_in_perspective(studio, name, convex):
    from factory.lights import load as load_light
    from factory.shapes.catalogue import load

    mesh = load(name)
    studio.set_shape(mesh)
    studio.set_light(load_light("night").L64, 5)
    studio.set_materials([Mixture.lambert([0.6] * 3)] * mesh.segments)
    studio.set_view(0.4)
    for fov in (15.0, 50.0):
        wide = 1.02 / np.cos(np.radians(fov) / 2)
        studio.set_camera(Camera(size=(40, 40), fov_deg=fov, half_extent=wide))
        assert studio.may_shade_itself() != convex
        full, direct = (studio.portion(0, 16, 3, tier).noisy for tier in ("full", "direct"))
        assert np.array_equal(full, direct) == convex


@pytest.mark.blender
def test_walls_of_a_gap_are_visible_in_perspective_alone(studio, tmp_path):
    import trimesh

    from factory.shapes.catalogue import load

    boxes = [trimesh.creation.box((1, 0.5, 1)).apply_translation((0, y, 0)) for y in (-0.4, 0.4)]
    (tmp_path / "gap.obj").write_text(trimesh.util.concatenate(boxes).export(None, "obj"))
    studio.set_shape(load(tmp_path / "gap.obj", up="z", front="x"))
    studio.set_view(0.0)
    for fov, shaded in ((None, False), (50.0, True)):
        studio.set_camera(Camera(size=(40, 40), elevation_deg=0.0, fov_deg=fov, half_extent=1.2))
        assert studio.may_shade_itself() == shaded
