"""Node graphs (shaders.nodes.Graph) as groups of Blender nodes, and materials that show a group.

A fitted mixture has about 80 nodes and 500 colour stops, which take Blender about 40 ms to build.
Each mixture is therefore built once, as a node group, and a material of one node shows a group.
"""

from collections.abc import Sequence
from typing import Any

import bpy

from factory.render.settings import assign
from shaders import nodes

FACET_SHIFT = 2.0  # added to a facet's normal, so that no channel that is emitted is negative


def new(name: str) -> bpy.types.Material:
    """Return a new material that shows no node group yet."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    # otherwise Cycles bends tilted normals back
    assign(material, "cycles.use_bump_map_correction", False)
    # otherwise Cycles samples a mesh that emits as a light source
    assign(material, "cycles.emission_sampling", "NONE")
    assign(material, "displacement_method", "BUMP")
    material.node_tree.nodes.clear()
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    output.name = "output"
    material.node_tree.nodes.new("ShaderNodeGroup").name = "shown"
    return material


def show(material: bpy.types.Material, group: bpy.types.NodeTree) -> None:
    """Make the material show a group from `build`."""
    tree = material.node_tree
    shown = tree.nodes["shown"]
    if shown.node_tree is group:
        return
    first = shown.node_tree is None
    shown.node_tree = group
    if first:
        tree.links.new(shown.outputs[0], tree.nodes["output"].inputs["Surface"])


def build(graph: nodes.Graph) -> bpy.types.NodeTree:
    """Return a new node group with the nodes of `graph`; its only output is the surface."""
    tree = bpy.data.node_groups.new("mixture", "ShaderNodeTree")
    tree.interface.new_socket("Surface", in_out="OUTPUT", socket_type="NodeSocketShader")
    built = {node.name: _node(tree, node) for node in graph.nodes if node.name != nodes.OUTPUT.name}
    surface = tree.nodes.new("NodeGroupOutput").inputs["Surface"]
    for link in graph.links:
        source = _socket(built[link.source].outputs, link.output)
        tree.links.new(
            source,
            (
                surface
                if link.target == nodes.OUTPUT.name
                else _socket(built[link.target].inputs, link.input)
            ),
        )
    return tree


def _socket(sockets: Any, identifier: str) -> bpy.types.NodeSocket:
    for socket in sockets:
        if socket.identifier == identifier:
            return socket
    raise KeyError(
        f"node: expected socket {identifier!r}, found {[s.identifier for s in sockets]} in this"
        " Blender (see shaders/nodes.py)"
    )


def _node(tree: bpy.types.NodeTree, node: nodes.Node) -> bpy.types.Node:
    built = tree.nodes.new(node.type)
    built.name = node.name
    for path, text in node.properties.items():
        assign(built, path, text)
    if node.ramp:
        _fill_ramp(built.color_ramp, node.ramp)
    for identifier, value in node.inputs.items():
        _socket(built.inputs, identifier).default_value = value
    return built


def _fill_ramp(ramp: bpy.types.ColorRamp, stops: Sequence[tuple[float, Sequence[float]]]) -> None:
    """Give a colour ramp its stops (position, RGBA).

    All values are set at once. Set one by one, each makes Blender search all its node trees, which
    is ten times slower.
    """
    while len(ramp.elements) > len(stops):
        ramp.elements.remove(ramp.elements[-1])
    while len(ramp.elements) < len(stops):
        ramp.elements.new(0.5)
    ramp.elements.foreach_set("position", [position for position, _ in stops])
    ramp.elements.foreach_set("color", [value for _, colour in stops for value in colour])


def id_emission(level: int) -> bpy.types.NodeTree:
    """Return a node group that emits a segment's number and the facet's direction.

    Red is `level`; green and blue are x + 2 and y + 2 of the facet's unit normal, which faces the
    viewer, in the camera's frame: x right, y up. It has no closure with a normal of its own, so the
    Normal pass, which averages the closures' normals, shows the surface's normal.
    """
    node, link = nodes.Node, nodes.Link
    shift = {"operation": "ADD"}
    return build(
        nodes.Graph(
            (
                nodes.OUTPUT,
                node("geometry", "ShaderNodeNewGeometry"),
                node(
                    "in camera",
                    "ShaderNodeVectorTransform",
                    {"vector_type": "NORMAL", "convert_from": "WORLD", "convert_to": "CAMERA"},
                ),
                node("parts", "ShaderNodeSeparateXYZ"),
                node("x", "ShaderNodeMath", shift, {"Value_001": FACET_SHIFT}),
                node("y", "ShaderNodeMath", shift, {"Value_001": FACET_SHIFT}),
                node("colour", "ShaderNodeCombineColor", inputs={"Red": float(level)}),
                node("emission", "ShaderNodeEmission", inputs={"Strength": 1.0}),
            ),
            (
                link("geometry", "True Normal", "in camera", "Vector"),
                link("in camera", "Vector", "parts", "Vector"),
                link("parts", "X", "x", "Value"),
                link("parts", "Y", "y", "Value"),
                link("x", "Value", "colour", "Green"),
                link("y", "Value", "colour", "Blue"),
                link("colour", "Color", "emission", "Color"),
                link("emission", "Emission", nodes.OUTPUT.name, "Surface"),
            ),
        )
    )
