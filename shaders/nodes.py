"""The node graph of a mixture as data: nodes, their properties, socket values, and links.

Sockets are named by Blender's identifiers (`socket.identifier`), which are unique within a node: a
Math node's inputs are `Value`, `Value_001`, `Value_002`, an Add Shader's `Shader`, `Shader_001`.
The factory builds real nodes from a Graph; nothing here imports bpy. The material itself must have
`material.cycles.use_bump_map_correction = False`: Cycles would "correct" tilted normals.

For each closure:  Facing ─ colour ramp ─ × scale ─► Color
                   Facing ─ ramp ─ multiply-add ─ exponent ─► Roughness
                   Facing ─ ramp ─ multiply-add ─ t;  normalize(N + t (I − (I·N) N)) ─► Normal
                   and an Add Shader sums all closures.

A ramp that would be flat is a number in the socket instead, and a closure whose weight is 0
everywhere is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from shaders.mixture import Mixture

Socket: TypeAlias = tuple[str, str]  # a node's name, and an identifier of one of its sockets
Value: TypeAlias = float | tuple[float, ...]  # of a socket without a link; RGBA for a colour
Ramp: TypeAlias = tuple[tuple[float, tuple[float, ...]], ...]  # (position, RGBA)
LAYER_WEIGHT, GEOMETRY = "facing", "geometry"
GLOSSY = {"ggx": "GGX", "beckmann": "BECKMANN", "ashikhmin_shirley": "ASHIKHMIN_SHIRLEY"}


@dataclass(frozen=True)
class Node:
    """One node.

    name        unique in its graph
    type        Blender's bl_idname
    properties  attributes of the node (`distribution`, `operation`); for a colour ramp
                `color_ramp.interpolation`
    inputs      socket identifier → default_value: a float or a tuple (RGBA for a colour)
    ramp        colour ramps only: ((position, (r, g, b, 1)), …), at most 32
    """

    name: str
    type: str
    properties: dict[str, str] = field(default_factory=dict)
    inputs: dict[str, Value] = field(default_factory=dict)
    ramp: Ramp = ()


@dataclass(frozen=True)
class Link:
    """A link from an output socket to an input socket; nodes by name, sockets by identifier."""

    source: str
    output: str
    target: str
    input: str


@dataclass(frozen=True)
class Graph:
    """Nodes and links; the surface leaves at the node named `output`, input `Surface`."""

    nodes: tuple[Node, ...]
    links: tuple[Link, ...]

    def node(self, name: str) -> Node:
        """Return the node of that name."""
        return next(n for n in self.nodes if n.name == name)


OUTPUT = Node("output", "ShaderNodeOutputMaterial")


class _Drawing:
    """A graph under construction; the facing and geometry nodes are added when first needed."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.links: list[Link] = []

    def add(
        self,
        name: str,
        kind: str,
        properties: dict[str, str] | None = None,
        inputs: Mapping[str, Value] | None = None,
        ramp: Ramp = (),
        **feeds: Socket,
    ) -> str:
        """Add a node and return its name.

        feeds  input identifier = (node name, output identifier)
        """
        self.nodes.append(Node(name, kind, properties or {}, dict(inputs or {}), ramp))
        self.links += [Link(*source, name, socket) for socket, source in feeds.items()]
        return name

    def once(self, name: str, kind: str, **keywords: Any) -> str:
        """Return the name of a node, which is added if it is not there yet."""
        return name if any(n.name == name for n in self.nodes) else self.add(name, kind, **keywords)

    def facing(self) -> Socket:
        """Return the source of 1 − cos_o: Layer Weight with Blend ½."""
        return self.once(LAYER_WEIGHT, "ShaderNodeLayerWeight", inputs={"Blend": 0.5}), "Facing"

    def ramp(self, name: str, stops: np.ndarray, rgb: np.ndarray) -> Socket:
        """Add a colour ramp over the facing and return its colour output; rgb (V, 3) in [0, 1]."""
        colours = tuple((float(x), (*map(float, c), 1.0)) for x, c in zip(stops, rgb, strict=True))
        self.add(
            name,
            "ShaderNodeValToRGB",
            {"color_ramp.interpolation": "LINEAR"},
            ramp=colours,
            Fac=self.facing(),
        )
        return name, "Color"


def graph(mixture: Mixture) -> Graph:
    """Return the graph whose surface is `mixture`; its node `output` is an OutputMaterial."""
    drawing = _Drawing()
    drawing.nodes.append(OUTPUT)
    surface: Socket | None = None
    for k in range(len(mixture.kinds)):
        if not (mixture.weights[:, k] > 0).any() and (surface or k + 1 < len(mixture.kinds)):
            continue  # weighs nothing anywhere; a wholly black mixture keeps its last closure
        shader = _closure(drawing, mixture, k), "BSDF"
        if surface is None:
            surface = shader
        else:
            surface = (
                drawing.add(f"sum {k}", "ShaderNodeAddShader", Shader=surface, Shader_001=shader),
                "Shader",
            )
    if surface is not None:  # a mixture has at least one closure
        drawing.links.append(Link(*surface, OUTPUT.name, "Surface"))
    return Graph(tuple(drawing.nodes), tuple(drawing.links))


def _closure(drawing: _Drawing, mixture: Mixture, k: int) -> str:
    """Add closure k with all nodes that feed it; return its node's name."""
    kind = mixture.kinds[k]
    inputs: dict[str, Value] = {}
    feeds: dict[str, Socket] = {}
    properties: dict[str, str] = {}
    colour = _colour(drawing, f"colour {k}", mixture.stops, mixture.weights[:, k])
    _feed(inputs, feeds, "Color", colour)
    if kind == "diffuse":
        bl_idname, inputs["Roughness"] = "ShaderNodeBsdfDiffuse", 0.0
    else:
        half = 1.0 if kind == "sheen" else 0.5  # Roughness = √α for Glossy, α itself for Sheen
        _feed(
            inputs,
            feeds,
            "Roughness",
            _roughness(drawing, f"roughness {k}", mixture.stops, half * mixture.log_alpha[:, k]),
        )
        bl_idname = "ShaderNodeBsdfSheen" if kind == "sheen" else "ShaderNodeBsdfGlossy"
        properties["distribution"] = "ASHIKHMIN" if kind == "sheen" else GLOSSY[kind]
    if kind != "diffuse" and kind != "sheen":
        inputs["Anisotropy"] = 0.0
    if np.abs(mixture.tilt[:, k]).max() > 1e-6:
        feeds["Normal"] = _normal(drawing, k, mixture.stops, mixture.tilt[:, k])
    return drawing.add(f"closure {k}", bl_idname, properties, inputs, (), **feeds)


def _feed(
    inputs: dict[str, Value], feeds: dict[str, Socket], socket: str, value: Socket | Value
) -> None:
    """Link a socket to a value that is a source, or set the socket to any other value."""
    if isinstance(value, tuple) and isinstance(value[0], str):
        feeds[socket] = value[0], str(value[1])
    else:
        inputs[socket] = value


def _colour(drawing: _Drawing, name: str, stops: np.ndarray, rgb: np.ndarray) -> Socket | Value:
    """Return a source of the RGB weights (V, 3) over the facing, or one RGBA if they are constant.

    The source is a ramp of values up to 1, times their maximum.
    """
    if np.ptp(rgb, axis=0).max() == 0:
        return (*map(float, rgb[0]), 1.0)
    scale = float(rgb.max())
    source = drawing.ramp(f"{name} ramp", stops, rgb / scale)
    return (
        drawing.add(
            name, "ShaderNodeVectorMath", {"operation": "SCALE"}, {"Scale": scale}, Vector=source
        ),
        "Vector",
    )


def _scalar(drawing: _Drawing, name: str, stops: np.ndarray, values: np.ndarray) -> Socket | float:
    """Return a source of the values (V,) over the facing, or a float if they are constant.

    The source is a grey ramp in [0, 1], then × range + minimum.
    """
    low, span = float(values.min()), float(np.ptp(values))
    if span < 1e-9:
        return low
    grey = np.repeat(((values - low) / span)[:, None], 3, axis=1)
    source = drawing.ramp(f"{name} ramp", stops, grey)
    scale = {"Value_001": span, "Value_002": low}
    return (
        drawing.add(
            f"{name} range", "ShaderNodeMath", {"operation": "MULTIPLY_ADD"}, scale, Value=source
        ),
        "Value",
    )


def _roughness(
    drawing: _Drawing, name: str, stops: np.ndarray, log_roughness: np.ndarray
) -> Socket | float:
    """Return a source of the logarithms' exp over the facing, or a float if they are constant."""
    source = _scalar(drawing, name, stops, log_roughness)
    if isinstance(source, float):
        return float(np.exp(source))
    return drawing.add(name, "ShaderNodeMath", {"operation": "EXPONENT"}, Value=source), "Value"


def _normal(drawing: _Drawing, k: int, stops: np.ndarray, tilt: np.ndarray) -> Socket:
    """Return the source of normalize(N + t (I − (I·N) N)); I: Incoming, towards the viewer."""

    def vector(name, operation, inputs=None, **feeds):
        return drawing.add(name, "ShaderNodeVectorMath", {"operation": operation}, inputs, **feeds)

    geometry = drawing.once(GEOMETRY, "ShaderNodeNewGeometry")
    normal, incoming = (geometry, "Normal"), (geometry, "Incoming")
    if not any(n.name == "across" for n in drawing.nodes):
        vector("cosine", "DOT_PRODUCT", Vector=incoming, Vector_001=normal)
        vector("along", "SCALE", Vector=normal, Scale=("cosine", "Value"))
        vector("across", "SUBTRACT", Vector=incoming, Vector_001=("along", "Vector"))
    t = _scalar(drawing, f"tilt {k}", stops, tilt)
    fixed, fed = ({"Scale": t}, {}) if isinstance(t, float) else ({}, {"Scale": t})
    lean = vector(f"lean {k}", "SCALE", fixed, Vector=("across", "Vector"), **fed)
    moved = vector(f"moved {k}", "ADD", Vector=normal, Vector_001=(lean, "Vector"))
    return vector(f"normal {k}", "NORMALIZE", Vector=(moved, "Vector")), "Vector"
