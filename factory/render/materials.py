"""A node graph (shaders.nodes.Graph) as a group of Blender nodes, and the materials that show such
groups.

A fitted mixture has some 80 nodes and 500 colour stops, which Blender takes some 40 ms to put down:
each mixture is built once, as a node group, and a material of one node shows whichever group it is
told to.
"""

import bpy

from factory.render.settings import assign
from shaders import nodes


def new(name):
    """A material that shows a node group, none as yet; tilted normals are left alone, and it is
    never taken for a lamp.
    """
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    # else Cycles bends tilted normals back
    assign(material, "cycles.use_bump_map_correction", False)
    # else a glowing mesh becomes a lamp with a tree of its own
    assign(material, "cycles.emission_sampling", "NONE")
    assign(material, "displacement_method", "BUMP")
    material.node_tree.nodes.clear()
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    output.name = "output"
    material.node_tree.nodes.new("ShaderNodeGroup").name = "shown"
    return material


def show(material, group):
    """Lets the material show a group from `build`."""
    tree = material.node_tree
    shown = tree.nodes["shown"]
    if shown.node_tree is group:
        return
    first = shown.node_tree is None
    shown.node_tree = group
    if first:
        tree.links.new(shown.outputs[0], tree.nodes["output"].inputs["Surface"])


def build(graph):
    """A node group with the nodes of `graph`, its one output the surface."""
    tree = bpy.data.node_groups.new("mixture", "ShaderNodeTree")
    tree.interface.new_socket("Surface", in_out="OUTPUT", socket_type="NodeSocketShader")
    drawn = {node.name: _node(tree, node) for node in graph.nodes if node.name != nodes.OUTPUT.name}
    surface = tree.nodes.new("NodeGroupOutput").inputs["Surface"]
    for link in graph.links:
        source = _socket(drawn[link.source].outputs, link.output)
        tree.links.new(
            source,
            (
                surface
                if link.target == nodes.OUTPUT.name
                else _socket(drawn[link.target].inputs, link.input)
            ),
        )
    return tree


def _socket(sockets, identifier):
    for socket in sockets:
        if socket.identifier == identifier:
            return socket
    raise KeyError(
        f"node: expected socket {identifier!r}, found {[s.identifier for s in sockets]} in this"
        " Blender (see shaders/nodes.py)"
    )


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
    """Fills a colour ramp. All values go in at once: set one by one, each makes Blender look
    through all its trees (ten times slower).
    """
    while len(ramp.elements) > len(stops):
        ramp.elements.remove(ramp.elements[-1])
    while len(ramp.elements) < len(stops):
        ramp.elements.new(0.5)
    ramp.elements.foreach_set("position", [position for position, _ in stops])
    ramp.elements.foreach_set("color", [value for _, colour in stops for value in colour])


def emit_id(level):
    """A node group that emits `level` in red, green and blue: how geometry carries a segment's
    number.

    It has no closure with a normal of its own: the Normal pass, which averages closures' normals,
    then gives the surface's.
    """
    emission = nodes.Node(
        "emission",
        "ShaderNodeEmission",
        inputs={"Color": (1.0, 1.0, 1.0, 1.0), "Strength": float(level)},
    )
    return build(
        nodes.Graph(
            (nodes.OUTPUT, emission),
            (nodes.Link("emission", "Emission", nodes.OUTPUT.name, "Surface"),),
        )
    )
