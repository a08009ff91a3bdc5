"""A node graph (shaders.nodes.Graph) as the nodes of a Blender material, and the plain materials that geometry is rendered with."""

import bpy

from factory.render.settings import assign
from shaders import nodes


def new(name):
    """A material whose tilted normals are left alone and that is never taken for a lamp."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    assign(material, "cycles.use_bump_map_correction", False)  # else Cycles bends tilted normals back
    assign(material, "cycles.emission_sampling", "NONE")  # else a glowing mesh becomes a lamp with a tree of its own
    assign(material, "displacement_method", "BUMP")
    return material


def draw(material, graph):
    """Replaces the material's nodes by those of `graph`."""
    tree = material.node_tree
    tree.nodes.clear()
    drawn = {node.name: _node(tree, node) for node in graph.nodes}
    for link in graph.links:
        tree.links.new(_socket(drawn[link.source].outputs, link.output), _socket(drawn[link.target].inputs, link.input))


def _socket(sockets, identifier):
    for socket in sockets:
        if socket.identifier == identifier:
            return socket
    raise KeyError(f"socket {identifier!r} expected, this Blender's node has {[s.identifier for s in sockets]}; see shaders/nodes.py")


def _node(tree, node):
    drawn = tree.nodes.new(node.type)
    drawn.name = node.name
    for path, value in node.properties.items():
        assign(drawn, path, value)
    if node.ramp:
        _ramp(drawn.color_ramp, node.ramp)
    for identifier, value in node.inputs.items():
        _socket(drawn.inputs, identifier).default_value = value
    return drawn


def _ramp(ramp, stops):
    """Fills a colour ramp; Blender keeps elements sorted by place, so places come first, in ascending order."""
    while len(ramp.elements) > 1:
        ramp.elements.remove(ramp.elements[-1])
    ramp.elements[0].position = stops[0][0]
    for position, _ in stops[1:]:
        ramp.elements.new(position)
    for element, (position, colour) in zip(ramp.elements, stops, strict=True):
        element.position, element.color = position, colour


def glow(level):
    """A material that emits `level` in red, green and blue: how geometry carries a segment's number.

    It has no closure with a normal of its own: the Normal pass, which averages closures' normals, then gives the surface's.
    """
    material = new(f"segment {level}")
    emission = nodes.Node("emission", "ShaderNodeEmission", inputs={"Color": (1.0, 1.0, 1.0, 1.0), "Strength": float(level)})
    draw(material, nodes.Graph((nodes.OUTPUT, emission), (nodes.Link("emission", "Emission", nodes.OUTPUT.name, "Surface"),)))
    return material
