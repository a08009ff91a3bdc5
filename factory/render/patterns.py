"""Patterns of surfaces (factory.lights.interiors.Pattern) as Blender's texture nodes.

A pattern says at each point how much of its second colour a surface has. The texture nodes take
coordinates in metres along the surface, which `add_coordinates` gives a mesh.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import bpy
import numpy as np

from factory.lights.interiors import Material, Pattern

LAYER = "along the surface"
LENGTH = 8.0  # of a plank, in multiples of its width
GROUT = 0.04  # width of the grout, as a share of the height of a tile or a brick
SOFT = 0.3  # width of the range of noise that mottled surfaces stretch over their two colours

Socket: TypeAlias = bpy.types.NodeSocket


def add_coordinates(mesh: bpy.types.Mesh, scale: float = 1.0) -> None:
    """Give a mesh coordinates in metres along each face, by projecting it along one axis.

    scale  metres per unit of the mesh
    """
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    normals = np.empty((len(mesh.polygons), 3), np.float32)
    mesh.polygons.foreach_get("normal", normals.ravel())
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    sizes = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_total", sizes)
    axis = np.repeat(abs(normals).argmax(1), sizes)
    # walls: along the floor and up
    kept = np.array([(1, 2), (0, 2), (0, 1)])[axis]
    uv = scale * np.take_along_axis(points[corners], kept, 1)
    layer = mesh.uv_layers.new(name=LAYER)
    layer.data.foreach_set("uv", np.ascontiguousarray(uv, np.float32).ravel())


def colour(tree: bpy.types.NodeTree, material: Material, pattern: Pattern) -> Socket:
    """Return the colour of a surface with a pattern, as an output of new nodes in its tree."""
    place = tree.nodes.new("ShaderNodeUVMap")
    place.uv_map = LAYER
    moved = tree.nodes.new("ShaderNodeMapping")
    moved.inputs["Location"].default_value = (*pattern.offset, 0.0)
    moved.inputs["Rotation"].default_value = (0.0, 0.0, pattern.turn)
    tree.links.new(place.outputs[0], moved.inputs["Vector"])
    amount = AMOUNTS[pattern.kind](tree, moved.outputs[0], pattern.size)
    mix = tree.nodes.new("ShaderNodeMixRGB")
    tree.links.new(amount, mix.inputs["Fac"])
    mix.inputs["Color1"].default_value = (*material.colour, 1.0)
    mix.inputs["Color2"].default_value = (*pattern.colour, 1.0)
    return mix.outputs["Color"]


def _node(tree: bpy.types.NodeTree, kind: str, place: Socket, **inputs: float) -> bpy.types.Node:
    node = tree.nodes.new(f"ShaderNodeTex{kind}")
    tree.links.new(place, node.inputs["Vector"])
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ").title()].default_value = value
    return node


def _math(
    tree: bpy.types.NodeTree, operation: str, *values: Socket | float, clamp: bool = True
) -> Socket:
    node = tree.nodes.new("ShaderNodeMath")
    node.operation, node.use_clamp = operation, clamp
    for number, value in enumerate(values):
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, node.inputs[number])
        else:
            node.inputs[number].default_value = value
    return node.outputs[0]


def _bricks(
    tree: bpy.types.NodeTree, place: Socket, width: float, height: float, offset: float
) -> Socket:
    """Return a shade for each brick, and 1, the second colour, for the grout between them."""
    node = _node(tree, "Brick", place, scale=1.0, brick_width=width, row_height=height)
    node.offset = offset
    node.inputs["Mortar Size"].default_value = GROUT * height / 2
    for name, shade in (("Color1", 0.0), ("Color2", 0.3), ("Mortar", 1.0)):
        node.inputs[name].default_value = (shade, shade, shade, 1.0)
    return node.outputs["Color"]


def _stretch(tree: bpy.types.NodeTree, place: Socket, along: float, across: float) -> Socket:
    node = tree.nodes.new("ShaderNodeMapping")
    node.inputs["Scale"].default_value = (along, across, 1.0)
    tree.links.new(place, node.inputs["Vector"])
    return node.outputs[0]


def _wood(tree: bpy.types.NodeTree, place: Socket, size: float) -> Socket:
    planks = _bricks(tree, place, LENGTH * size, size, 0.37)
    grain = _node(
        tree, "Noise", _stretch(tree, place, 0.6 / size, 14 / size), scale=1.0, detail=4.0
    )
    contrast = _math(tree, "MULTIPLY_ADD", grain.outputs[0], 2.5, -0.9)
    return _math(tree, "MULTIPLY_ADD", contrast, 0.6, planks)


def _bands(tree: bpy.types.NodeTree, place: Socket, size: float, across: str) -> Socket:
    """Return 0 and 1 in turn, each half of `size` wide."""
    node = _node(tree, "Wave", place, scale=np.pi / 10 / size)
    node.bands_direction = across
    return _math(tree, "GREATER_THAN", node.outputs["Fac"], 0.5)


def _weave(tree: bpy.types.NodeTree, place: Socket, size: float) -> Socket:
    along, across = (_bands(tree, place, size, direction) for direction in "XY")
    return _math(tree, "MULTIPLY", _math(tree, "ADD", along, across, clamp=False), 0.5)


def _dots(tree: bpy.types.NodeTree, place: Socket, size: float) -> Socket:
    node = _node(tree, "Voronoi", place, scale=1 / size, randomness=0.4)
    node.voronoi_dimensions = "2D"
    return _math(tree, "LESS_THAN", node.outputs["Distance"], 0.3)


def _patches(tree: bpy.types.NodeTree, place: Socket, size: float) -> Socket:
    node = _node(tree, "Voronoi", place, scale=1 / size)
    node.voronoi_dimensions = "2D"
    parts = tree.nodes.new("ShaderNodeSeparateColor")
    tree.links.new(node.outputs["Color"], parts.inputs[0])
    return parts.outputs[0]


def _mottled(tree: bpy.types.NodeTree, place: Socket, size: float) -> Socket:
    node = _node(tree, "Noise", place, scale=1 / size, detail=6.0, roughness=0.7)
    return _math(tree, "MULTIPLY_ADD", node.outputs[0], 1 / SOFT, 0.5 - 0.5 / SOFT)


def _marble(tree: bpy.types.NodeTree, place: Socket, size: float) -> Socket:
    node = _node(tree, "Wave", place, scale=0.1 / size, distortion=12.0, detail=4.0)
    return _math(tree, "POWER", node.outputs["Fac"], 4.0)


AMOUNTS: dict[str, Callable[[Any, Any, float], Socket]] = {
    "wood": _wood,
    "tiles": lambda tree, place, size: _bricks(tree, place, size, size, 0.0),
    "bricks": lambda tree, place, size: _bricks(tree, place, 2.2 * size, size, 0.5),
    "stripes": lambda tree, place, size: _bands(tree, place, size, "X"),
    "checks": lambda tree, place, size: _node(tree, "Checker", place, scale=1 / size).outputs[
        "Fac"
    ],
    "weave": _weave,
    "dots": _dots,
    "patches": _patches,
    "mottled": _mottled,
    "marble": _marble,
}
