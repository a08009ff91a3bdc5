"""Small things of metal, for testing only: keys and screws."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import close_surface, grid_faces
from factory.shapes.general import fields
from factory.shapes.general.draws import Generator
from factory.shapes.general.isosurface import Field, surface_of
from factory.shapes.lofts import loft, tube

METAL, SECOND = 1, 2
CELLS = 128  # along a key: its teeth and its grooves are thin


def key(a: Assembly, rng: Generator) -> None:
    """A key for a cylinder lock or an old one with a bit, perhaps on a ring. Segments: 1 the key,
    2 the ring.
    """
    is_flat = rng.random() < 0.5
    field = _flat_key(rng) if is_flat else _bit_key(rng)
    a.add("key", surface_of(field, 1.3, CELLS), METAL)
    if rng.random() < 0.4:
        size = rng.uniform(0.22, 0.32)
        t = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        ring = size * np.stack([np.cos(t), 0 * t, np.sin(t)], 1)
        loop = tube(ring, 0.03, around=14, ring=True, side=(0, 1, 0))
        hole = -0.82 if is_flat else -0.95
        a.add("ring", loop.moved(0, 0, hole - size + 0.03), SECOND)
    a.turn("x", rng.uniform(-0.6, 0.6))  # on its side; the bit or the teeth are at ±y
    a.turn("y", rng.uniform(-0.8, 0.8))


def _flat_key(rng) -> Field:
    """A bow with a hole and a blade with teeth, along z from −1 to 1, thin along x."""
    thick, half = rng.uniform(0.05, 0.07), rng.uniform(0.13, 0.17)
    teeth = int(rng.integers(5, 9))
    bow_size, square = rng.uniform(0.36, 0.46), rng.choice([2.0, 3.0, 5.0])
    t = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    c, s = np.cos(t), np.sin(t)
    share = (np.abs(c) ** square + np.abs(s) ** square) ** (-1 / square)
    bow = np.stack([bow_size * c * share, 0.8 * bow_size * s * share - 0.62], 1)
    if rng.random() < 0.4:  # clover
        bow = np.stack([c, s], 1) * (bow_size * (0.85 + 0.2 * np.cos(3 * (t - np.pi / 2))))[:, None]
        bow = bow - [0, 0.62]
    cuts = []
    for z in np.linspace(-0.05, 0.8, teeth):
        deep = rng.uniform(-0.6, 0.6) * half
        cuts += [[half, z], [deep, z + 0.035], [deep, z + 0.065]]
    tip = [[half, 0.9], [0.2 * half, 1.0], [-0.2 * half, 1.0], [-half, 0.88]]
    blade = np.array([[-half, -0.4], [half, -0.4], *cuts, *tip])
    hole = rng.uniform(0.07, 0.1)
    opening = np.stack([hole * c * rng.uniform(1, 1.8), hole * s - 0.74], 1)
    field = fields.union(
        [
            fields.extruded(fields.Outline([bow, opening]), thick, 0.02),
            fields.extruded(fields.Outline([blade]), 0.8 * thick, 0.012),
            fields.moved(fields.box((thick * 1.2, half * 1.35, 0.06), 0.02), (0, 0, -0.22)),
        ],
        0.03,
    )
    grooves = [
        fields.moved(fields.box((0.025, 0.022, 0.9), 0.008), (side * 0.8 * thick, place, 0.75))
        for side, place in ((1, -0.35 * half), (-1, -0.7 * half))
    ]
    return fields.cut(field, grooves, 0.01)


def _bit_key(rng) -> Field:
    """A ring or clover as bow, a round shank with collars, and a notched bit; along z."""
    shank, ring, wire = rng.uniform(0.05, 0.075), rng.uniform(0.18, 0.3), rng.uniform(0.04, 0.065)
    upright = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # an axis along z to one along x
    loop = fields.turned(fields.torus(ring, wire), upright)
    bows = [fields.moved(loop, (0, 0, -0.7))]
    kind = rng.choice(["ring", "clover", "heart"])
    if kind == "clover":
        small = fields.turned(fields.torus(0.75 * ring, wire), upright)
        places = [(0, 0, -0.95), (0, ring, -0.62), (0, -ring, -0.62)]
        bows = [fields.moved(small, place) for place in places]
    elif kind == "heart":
        t = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        wide = 16 * np.sin(t) ** 3
        high = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
        heart = np.stack([0 * t, wide / 16, -high / 16], 1) * 1.6 * ring + [0, 0, -0.72]
        bows = [fields.path(heart, wire, closed=True)]
    parts = [*bows, fields.capsule((0, 0, -0.45), (0, 0, 1.0), shank, shank * 0.8)]
    for z in (-0.4, -0.32, *([rng.uniform(0.3, 0.45)] if rng.random() < 0.5 else [])):
        parts.append(fields.moved(fields.cylinder(shank * 1.7, 0.025, 0.015), (0, 0, z)))
    deep, tall = rng.uniform(0.22, 0.34), rng.uniform(0.14, 0.22)
    middle = 0.92 - tall
    bit = fields.moved(
        fields.box((0.035, deep / 2 + 0.03, tall), 0.01), (0, deep / 2 + 0.03, middle)
    )
    notches = []
    for z in np.linspace(-0.75, 0.75, int(rng.integers(2, 4))):
        long = deep * rng.uniform(0.15, 0.32)
        end = rng.choice([deep + 0.06, shank + deep * 0.35])
        notches.append(
            fields.moved(fields.box((0.2, long, 0.028), 0.004), (0, end, middle + z * tall))
        )
    return fields.union([fields.union(parts, 0.03), fields.cut(bit, notches, 0.0)], 0.015)


def screw(a: Assembly, rng: Generator) -> None:
    """A bolt, perhaps with its nut, a wood screw, a thumbscrew or an eye. Segments: 1 the screw,
    2 the nut.
    """
    kind = str(rng.choice(["bolt", "wood screw", "thumbscrew", "eye"], p=[0.4, 0.3, 0.15, 0.15]))
    radius = rng.uniform(0.14, 0.24)
    long = rng.uniform(1.0, 1.7)
    pitch = radius * rng.uniform(0.3, 0.5)
    pointed = kind in ("wood screw", "eye")
    if pointed:
        pitch *= 1.5
    plain = rng.uniform(0.05, 0.45) * long
    a.add("thread", _thread(radius, long, pitch, plain, pointed), METAL)
    if kind == "bolt":
        _bolt_head(a, rng, radius)
        if rng.random() < 0.5:
            size, thick = radius * rng.uniform(1.6, 1.9), radius * rng.uniform(0.8, 1.2)
            nut = surface_of(_hexagon(size, thick / 2, hole=0.92 * radius), 1.5 * size, 64)
            a.add("nut", nut.moved(z=-rng.uniform(plain + thick, long * 0.9)), SECOND)
    elif kind == "wood screw":
        _slotted_head(a, rng, radius)
    elif kind == "thumbscrew":
        wing = fields.mirrored(
            fields.union(
                [
                    fields.cylinder(radius * 1.3, radius * 0.7, 0.04),
                    fields.capsule((0, 0, 0), (0, radius * 2.6, radius * 1.3), radius * 0.8, 0.11),
                    fields.moved(
                        fields.ellipsoid((0.07, radius, radius * 1.1)),
                        (0, radius * 2.4, radius * 1.2),
                    ),
                ],
                0.08,
            )
        )
        flat = fields.intersection(
            [wing, fields.union([fields.box((0.1, 2, 2), 0.05), fields.cylinder(0.4, 2, 0.02)])],
            0.05,
        )
        a.add("wings", surface_of(flat, 1.2).moved(z=radius * 0.5), METAL)
    else:
        size = radius * rng.uniform(1.5, 2.4)
        arc = np.linspace(-np.pi / 2, rng.uniform(0.8, 1.45) * np.pi, 44)
        bow = np.stack([0 * arc, size * np.cos(arc), size * np.sin(arc) + size + 0.06], 1)
        path = np.vstack([[0, 0, -0.05], bow])
        a.add("eye", tube(path, radius * 0.62, around=24, bevel=1.0, side=(1, 0, 0)), METAL)
    a.turn("y", rng.uniform(0.2, 2.6))
    a.turn("z", rng.uniform(0, 2 * np.pi))


def _thread(radius, long, pitch, plain, pointed):
    """A shank along −z from 0: smooth for `plain`, then with a thread, and a point if asked for."""
    around = 48
    rows = int(np.clip(long / pitch * 12, 60, 420))
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    rings = []
    for z in np.linspace(0.05, -long, rows):
        phase = (-z / pitch - angle / (2 * np.pi)) % 1.0
        crest = np.clip(1.6 * np.abs(2 * phase - 1) - 0.3, 0, 1)
        onset = np.clip((-z - plain) / pitch, 0, 1)
        end = np.clip((long + z) / (2.5 * radius), 0, 1) if pointed else 1.0
        ease = min((long + z) / (0.4 * radius) + 0.55, 1.0)
        depth = (0.32 if pointed else 0.2) * onset
        size = radius * (1 - depth * (1 - crest)) * min(end + 0.02, ease)
        flat = np.stack([np.cos(angle), np.sin(angle)], 1) * size[:, None]
        rings.append(np.column_stack([flat, np.full(around, z)]))
    return loft(rings)


def _hexagon(size, half, hole=0.0) -> Field:
    """A hexagonal prism about z with chamfered corners; `hole`: radius of one along its axis."""
    t = np.arange(6) * np.pi / 3
    sides = [fields.half_space((np.cos(x), np.sin(x), 0), size * 0.87) for x in t]
    lids = [fields.half_space((0, 0, s), half) for s in (1.0, -1.0)]
    dome = fields.ellipsoid((size * 1.16, size * 1.16, half * 2.2))
    prism = fields.intersection([*sides, *lids, dome], 0.01)
    return fields.cut(prism, [fields.cylinder(hole, 4 * half, 0.0)], 0.01) if hole else prism


def _bolt_head(a, rng, radius):
    kind = rng.choice(["hexagon", "socket", "carriage"], p=[0.5, 0.3, 0.2])
    size, tall = radius * rng.uniform(1.6, 2.0), radius * rng.uniform(0.9, 1.4)
    if kind == "hexagon":
        head = _hexagon(size, tall / 2)
    elif kind == "socket":
        prism = _hexagon(size * 0.5, tall)
        head = fields.cut(
            fields.cylinder(size * 0.9, tall / 2, 0.03),
            [fields.moved(prism, (0, 0, tall * 0.9))],
            0.01,
        )
    else:
        dome = fields.ellipsoid((size * 1.1, size * 1.1, tall))
        head = fields.moved(
            fields.intersection([dome, fields.half_space((0, 0, -1), 0.0)], 0.03), (0, 0, -tall / 2)
        )
    a.add("head", surface_of(head, 1.5 * size, 64).moved(z=tall / 2), METAL)
    if rng.random() < 0.4:
        a.add("washer", _ring_plate(size * 1.35, radius, 0.05).moved(z=-0.03), SECOND)


def _ring_plate(outer, inner, thick):
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    section = [(inner, -0.5), (outer, -0.5), (outer, 0.5), (inner, 0.5)]
    points = [np.column_stack([circle * r, np.full(64, z * thick)]) for r, z in section]
    return close_surface(np.concatenate(points), grid_faces(4, 64, True, True))


def _slotted_head(a, rng, radius):
    size, tall = radius * rng.uniform(1.8, 2.2), radius * rng.uniform(0.7, 1.0)
    if rng.random() < 0.5:  # countersunk
        head = fields.cone(radius * 0.8, size, tall / 2, 0.02)
    else:
        dome = fields.ellipsoid((size, size, tall * 1.1))
        head = fields.moved(
            fields.intersection([dome, fields.half_space((0, 0, -1), 0.0)], 0.03), (0, 0, -tall / 2)
        )
    slot = fields.moved(fields.box((size * 2, size * 0.13, tall * 0.45), 0.01), (0, 0, tall * 0.62))
    slots = [slot]
    if rng.random() < 0.5:  # a cross
        arm = fields.box((size * 0.62, size * 0.12, tall * 0.5), 0.01)
        other = fields.box((size * 0.12, size * 0.62, tall * 0.5), 0.01)
        slots = [fields.moved(each, (0, 0, tall * 0.62)) for each in (arm, other)]
    a.add(
        "head", surface_of(fields.cut(head, slots, 0.015), 1.5 * size, 72).moved(z=tall / 2), METAL
    )
