"""Claims of shaders.nodes: the graph, carried out node by node, is the mixture; it is no larger
than needed; Blender has its sockets.
"""

import importlib.util
import subprocess
import sys

import numpy as np
import pytest

from shaders import closures, nodes
from shaders.mixture import Mixture, ramp

STOPS = np.array([0, 2, 30, 90, 160, 255]) / 255


def a_mixture(rng):
    shape = len(STOPS), 4
    weights = rng.uniform(0, 3, (*shape, 3))
    weights[:, 3] = 0  # a closure that never weighs anything
    return Mixture(
        ("diffuse", "ggx", "sheen", "beckmann"),
        STOPS,
        rng.uniform(-3, -0.3, shape),
        rng.uniform(0, 0.4, shape),
        weights,
    )


class Interpreter:
    """Carries a graph out for one shading point: normal n, view v (Incoming), light w; a closure's
    output is f · cos, RGB.
    """

    def __init__(self, graph, n, v, w):
        self.graph, self.n, self.v, self.w = graph, n, v, w

    def surface(self):
        return self.input(nodes.OUTPUT, "Surface")

    def input(self, node, socket):
        fed = [
            link for link in self.graph.links if (link.target, link.input) == (node.name, socket)
        ]
        assert len(fed) <= 1, f"{node.name}.{socket}: expected one link"
        if fed:
            return self.output(self.graph.node(fed[0].source), fed[0].output)
        return (
            node.inputs[socket]
            if socket in node.inputs
            else self.n
            if socket == "Normal"
            else pytest.fail(f"{node.name}.{socket}: unset")
        )

    def output(self, node, socket):
        def get(name):
            return self.input(node, name)

        match node.type:
            case "ShaderNodeLayerWeight":
                assert (socket, get("Blend")) == ("Facing", 0.5)
                return 1 - abs(self.n @ self.v)
            case "ShaderNodeNewGeometry":
                return {"Normal": self.n, "Incoming": self.v}[socket]
            case "ShaderNodeValToRGB":
                x, colours = (
                    np.array([p for p, _ in node.ramp]),
                    np.array([c for _, c in node.ramp]),
                )
                assert colours.min() >= 0 and colours.max() <= 1
                return ramp(x, colours[:, :3], np.array([get("Fac")]))[0]
            case "ShaderNodeMath":
                a = np.mean(get("Value"))  # a grey colour in a number's socket
                return (
                    a * get("Value_001") + get("Value_002")
                    if node.properties["operation"] == "MULTIPLY_ADD"
                    else np.exp(a)
                )
            case "ShaderNodeVectorMath":
                v = get("Vector")
                return {
                    "SCALE": lambda: v * get("Scale"),
                    "ADD": lambda: v + get("Vector_001"),
                    "SUBTRACT": lambda: v - get("Vector_001"),
                    "DOT_PRODUCT": lambda: v @ get("Vector_001"),
                    "NORMALIZE": lambda: v / np.linalg.norm(v),
                }[node.properties["operation"]]()
            case "ShaderNodeAddShader":
                return get("Shader") + get("Shader_001")
        return self.closure(node, get)

    def closure(self, node, get):
        n = get("Normal")
        h = (self.w + self.v) / np.linalg.norm(self.w + self.v)
        roughness = get("Roughness")
        kind = {"ASHIKHMIN": "sheen", "GGX": "ggx", "BECKMANN": "beckmann"}.get(
            node.properties.get("distribution"), "diffuse"
        )
        alpha = roughness if kind == "sheen" else roughness**2
        f = closures.CLOSURES[kind](alpha, n @ self.w, n @ self.v, n @ h, h @ self.v)
        return np.array(get("Color"))[:3] * f * (n @ self.w)


def test_the_graph_carried_out_is_the_mixture(rng):
    mixture = a_mixture(rng)
    graph = nodes.graph(mixture)
    n = np.array([0.0, 0.6, 0.8])
    for _ in range(20):
        # far enough from the horizon that no tilt loses the light
        v, w = rng.normal(size=(2, 3)) * 0.6 + 2 * n
        v, w = v / np.linalg.norm(v), w / np.linalg.norm(w)
        h = (w + v) / np.linalg.norm(w + v)
        expected = mixture.evaluate(n @ w, n @ v, n @ h, h @ v) * (n @ w)
        np.testing.assert_allclose(Interpreter(graph, n, v, w).surface(), expected, rtol=1e-9)


def test_a_lambert_mixture_needs_two_nodes():
    graph = nodes.graph(Mixture.lambert([0.2, 0.3, 0.4]))
    assert [n.type for n in graph.nodes] == ["ShaderNodeOutputMaterial", "ShaderNodeBsdfDiffuse"]
    assert graph.nodes[1].inputs["Color"] == (0.2, 0.3, 0.4, 1.0)


def test_a_closure_that_weighs_nothing_is_left_out(rng):
    types = [n.properties.get("distribution") for n in nodes.graph(a_mixture(rng)).nodes]
    assert "BECKMANN" not in types and "GGX" in types


def test_a_black_material_still_has_a_surface():
    graph = nodes.graph(Mixture.lambert([0, 0, 0]))
    assert [link.target for link in graph.links] == ["output"]


def test_names_are_unique_and_links_lead_to_nodes_that_are_there(rng):
    graph = nodes.graph(a_mixture(rng))
    names = [n.name for n in graph.nodes]
    assert len(names) == len(set(names))
    assert {link.source for link in graph.links} | {link.target for link in graph.links} <= set(
        names
    )


CHECK_IN_BLENDER = """
import bpy, numpy as np
from shaders import nodes
from shaders.mixture import Mixture
stops, one = np.array([0, 0.5, 1]), np.ones((3, 5))
kinds = ("diffuse", "ggx", "beckmann", "ashikhmin_shirley", "sheen")
curve = np.array([[0.1], [0.2], [0.3]])
colours = np.repeat((one * curve)[..., None], 3, -1)
graph = nodes.graph(Mixture(kinds, stops, -one - curve, one * curve, colours))
material = bpy.data.materials.new("m")
material.use_nodes = True
made = {n.name: material.node_tree.nodes.new(n.type) for n in graph.nodes}
for n in graph.nodes:
    for name, value in n.properties.items():
        owner, _, name = ("." + name).rpartition(".")
        target = getattr(made[n.name], owner.strip(".")) if owner.strip(".") else made[n.name]
        setattr(target, name, value)
        assert getattr(target, name) == value
    assert set(n.inputs) <= {s.identifier for s in made[n.name].inputs}, n
for link in graph.links:
    assert link.output in {s.identifier for s in made[link.source].outputs}, link
    assert link.input in {s.identifier for s in made[link.target].inputs}, link
material.cycles.use_bump_map_correction = False
print("every socket is there", flush=True)
import os
os._exit(0)
"""


@pytest.mark.blender
@pytest.mark.skipif(
    importlib.util.find_spec("bpy") is None,
    reason="needs Blender as a module (pip install .[factory])",
)
def test_blender_has_every_node_property_and_socket_that_is_named(root):
    done = subprocess.run(
        [sys.executable, "-c", CHECK_IN_BLENDER],
        cwd=root,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "every socket is there" in done.stdout, done.stderr[-2000:]
