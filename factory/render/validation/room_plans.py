"""What objects_in_rooms shows: which objects, in which materials, in which places, and from where.

A plan is drawn from a seed, and needs no Blender. The object stands at the origin, on a table that
is put into a place of factory.lights.interiors.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from factory.lights import interiors, surroundings
from factory.lights.interiors import Box, Furniture
from factory.shapes.mesh import Mesh

RADII = (0.15, 0.3)  # metres, of the sphere about the object
ELEVATIONS = (8.0, 35.0)  # degrees
ATTEMPTS = 12  # azimuths that are tried for a free view before another place is
EACH = 3  # materials of a scene
SURROUNDINGS = ("plain", "varied")
BESIDE = ("vessel", "toy", "lamp", "cushion", "letter", "tool", "dish")  # kinds of other things
MOST_BESIDE = 4
SEEDS = 6  # of each family
OWN_FAMILIES, HELD_OUT_FAMILIES = (
    ("chair", "sofa", "car", "monitor"),
    ("dish", "knot", "letter", "tool"),
)
OWN = tuple(f"{family}:{1000 + k}" for k in range(SEEDS) for family in OWN_FAMILIES)
HELD_OUT = tuple(f"{family}:{k}" for k in range(SEEDS) for family in HELD_OUT_FAMILIES)
# those of docs/jobs/photographed-edits; the committed weights were trained on ten of the twelve
MATERIALS = (
    "chrome-steel", "aluminium", "nickel", "silver-paint", "blue-metallic-paint2",
    "yellow-phenolic", "blue-acrylic", "acrylic_felt_yellow", "light-brown-fabric",
    "violet-rubber", "cc_nothern_aurora", "white-marble",
)  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """A scene that is to be rendered.

    place         seed of factory.lights.interiors
    radius        of the sphere about the object, metres
    azimuths      in radians, of which the first with a free view is used
    elevation     in radians
    surroundings  of SURROUNDINGS
    """

    shape: str
    materials: tuple[str, ...]
    place: int
    radius: float
    azimuths: tuple[float, ...]
    elevation: float
    surroundings: str = SURROUNDINGS[0]


def draw_plan(
    number: int,
    attempt: int,
    seed: int,
    meshes: Sequence[Path],
    look: str = SURROUNDINGS[0],
    only_meshes: bool = False,
) -> Plan:
    """Return scene `number` of a seed; each attempt has another place and camera.

    look         the Plan's surroundings, on which nothing else of it depends
    only_meshes  whether to show meshes alone, instead of the program's own shapes beside them
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    groups: list[Sequence[Any]] = [OWN, HELD_OUT, *([meshes] if meshes else [])]
    if only_meshes:
        groups = [meshes]
    group = groups[number % len(groups)]
    shape = str(group[number // len(groups) % len(group)])
    names = tuple(str(name) for name in rng.permutation(MATERIALS)[:EACH])
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, attempt)))
    return Plan(
        shape=shape,
        materials=names,
        place=int(rng.integers(1 << 31)),
        radius=float(rng.uniform(*RADII)),
        azimuths=tuple(float(a) for a in rng.uniform(0, 2 * math.pi, ATTEMPTS)),
        elevation=math.radians(rng.uniform(*ELEVATIONS)),
        surroundings=look,
    )


def with_table(plan: Plan, mesh: Mesh) -> interiors.Scene:
    """Return the planned place with a table whose top is where the object, at the origin, ends."""
    place = interiors.draw(plan.place)
    floor = place.boxes[0].high[2]
    top = float(mesh.vertices[:, 2].min()) * plan.radius
    rng = np.random.default_rng(plan.place)
    half = rng.uniform(1.3, 3.0, 2) * plan.radius
    red, green, blue = (float(c) for c in rng.uniform(0.05, 0.7) * rng.uniform(0.6, 1, 3))
    look = interiors.Material((red, green, blue), roughness=float(rng.uniform(0.2, 0.9)))
    table = Box((-half[0], -half[1], floor), (half[0], half[1], top), look)
    if plan.surroundings == "varied":
        place = surroundings.varied(place, plan.place)
        table = dataclasses.replace(table, material=surroundings.surface(rng, "table"))
        beside = _others(rng, half, top, plan.radius)
        place = dataclasses.replace(place, furniture=(*place.furniture, *beside))
    return dataclasses.replace(place, boxes=(*place.boxes, table))


def _others(
    rng: np.random.Generator, half: np.ndarray, top: float, radius: float
) -> list[Furniture]:
    """Return things that stand on a table beside an object of a radius, where there is room."""
    things: list[Furniture] = []
    for _ in range(int(rng.integers(MOST_BESIDE + 1))):
        size = float(radius * rng.uniform(0.15, 0.5))
        spot = rng.uniform(-1, 1, 2) * np.maximum(half - 0.7 * size, 0)
        kind = f"{rng.choice(BESIDE)}:{int(rng.integers(interiors.SEEDS))}"
        look = surroundings.surface(rng, "furniture", float(rng.random() < 0.15))
        turn = float(rng.uniform(0, 2 * np.pi))
        near = [math.dist(spot, thing.place[:2]) < size + thing.radius for thing in things]
        if np.hypot(*spot) > radius + size and not any(near):
            place = (float(spot[0]), float(spot[1]), top)
            things.append(Furniture(kind, place, size, turn, look))
    return things


def shape_name(plan: Plan) -> str:
    """Return what a scene.json calls a plan's shape: a file goes by its name alone."""
    return Path(plan.shape).stem if Path(plan.shape).suffix else plan.shape
