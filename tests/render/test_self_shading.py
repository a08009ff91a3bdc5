"""Objects that cannot shade themselves: by their vertices, and by Cycles."""

import numpy as np
import pytest

from factory.render import self_shading
from factory.render.self_shading import FEW, WIDER, has_convex_side, may_shade_itself
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
def test_it_depends_on_the_side_and_is_not_known_in_perspective(studio, tmp_path, monkeypatch):
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
    monkeypatch.setattr(self_shading, "may_shade_itself", lambda *_: False)
    studio.set_camera(Camera(size=(40, 40), fov_deg=30))
    assert studio.may_shade_itself()
