"""Patterns of surfaces: what each kind looks like when it is rendered on a square."""

import numpy as np
import pytest

pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")

import bpy

from factory.lights import surroundings
from factory.lights.interiors import Box, Material, Pattern, Scene, Sky
from factory.render import panorama, patterns, render_result
from factory.render.settings import assign

RED, BLUE = (0.6, 0.05, 0.05), (0.05, 0.05, 0.6)


def shares(kind, size=0.1, turn=0.0):
    """Return (64, 64) how much of the second colour a square metre of a floor has, row 0 north."""
    look = Material(RED, pattern=Pattern(kind, BLUE, size, turn))
    floor = Box((-2, -2, -1.1), (2, 2, -1), look)
    stage, _ = panorama.build(Scene(Sky(0.5, 0, 0, 0, False), (floor,)), panorama.PANORAMA)
    (thing,) = stage.objects
    tree = thing.data.materials[0].node_tree
    glow = tree.nodes.new("ShaderNodeEmission")
    shown = tree.nodes["Principled BSDF"].inputs["Base Color"].links[0].from_socket
    tree.links.new(shown, glow.inputs["Color"])
    tree.links.new(glow.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    data = bpy.data.cameras.new("camera")
    data.type, data.ortho_scale = "ORTHO", 1.0
    camera = bpy.data.objects.new("camera", data)
    stage.collection.objects.link(camera)
    stage.camera = camera
    for path, value in (
        ("render.resolution_x", 64),
        ("render.resolution_y", 64),
        ("cycles.samples", 4),
        ("cycles.use_denoising", False),
    ):
        assign(stage, path, value)
    L = render_result.render_passes(stage)["Combined"][..., :3]
    blue = (L[..., 2] - RED[2]) / (BLUE[2] - RED[2])
    red = (L[..., 0] - BLUE[0]) / (RED[0] - BLUE[0])
    assert blue + red == pytest.approx(1, abs=1e-3)
    return blue


def test_each_kind_can_be_drawn():
    assert set(patterns.AMOUNTS) == set(surroundings.KINDS)


@pytest.mark.parametrize("kind", surroundings.KINDS)
def test_a_pattern_mixes_its_two_colours(kind):
    share = shares(kind)
    assert share.min() > -1e-3 and share.max() < 1.001
    assert share.std() > 0.05 and 0.03 < share.mean() < 0.97


def test_stripes_have_their_size_and_turn():
    share = shares("stripes", size=0.25)
    assert share.std(0).max() < 0.05  # along a stripe
    edges = abs(np.diff(share.mean(0) > 0.5)).sum()
    assert edges == pytest.approx(8, abs=1)  # four of them in a metre
    turned = shares("stripes", size=0.25, turn=np.pi / 2)
    assert turned.std(1).max() < 0.05


def test_walls_have_coordinates_along_the_floor_and_up():
    wall = Box((0, 0, 0), (0.2, 3, 2), Material(RED))
    mesh = panorama._box_mesh(wall)
    patterns.add_coordinates(mesh, 2.0)
    uv = np.array([tuple(corner.uv) for corner in mesh.uv_layers[patterns.LAYER].data])
    sides = [uv[list(face.loop_indices)] for face in mesh.polygons if abs(face.normal[0]) > 0.9]
    assert len(sides) == 2
    for side in sides:
        assert np.ptp(side, axis=0) == pytest.approx([6, 4])
