"""Bodies without a use: smooth unions and cuts of primitives, metaballs, stones, knots."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.curves import smooth_path
from factory.shapes.general import fields
from factory.shapes.general.draws import Generator, log_uniform, log_uniforms, rotation, waves
from factory.shapes.general.isosurface import Field, surface_of
from factory.shapes.lofts import tube


def compound(a: Assembly, rng: Generator) -> None:
    """Two to seven primitives blended into one body, half of them symmetric."""
    upright = rng.random() < 0.6
    blend = log_uniform(rng, 0.01, 0.25)
    parts = []
    for number in range(int(rng.integers(2, 8))):
        place = rng.normal(0, 0.38, 3) * (number > 0)
        part = _primitive(rng, 1.2 if number == 0 else 0.8)
        if not upright or rng.random() < 0.3:
            part = fields.turned(part, rotation(rng))
        parts.append(fields.moved(part, place))
    field = fields.union(parts, blend)
    if rng.random() < 0.5:
        field = fields.mirrored(field)
    _add_body(a, _maybe_bumpy(rng, field))


def carving(a: Assembly, rng: Generator) -> None:
    """A block, ball or cylinder with pieces cut out of it, or hollowed and opened."""
    body = _primitive(rng, 1.9, ["superquadric", "box", "cylinder"])
    blend = log_uniform(rng, 0.01, 0.1)
    if rng.random() < 0.3:
        wall = fields.shell(body, rng.uniform(0.08, 0.16))
        opening = fields.half_space((0, 0, -1), -rng.uniform(0.05, 0.4))
        field = fields.cut(wall, [opening], blend)
    else:
        tools = []
        for _ in range(int(rng.integers(1, 5))):
            tool = fields.turned(_primitive(rng, 0.9), rotation(rng))
            direction = rng.normal(size=3)
            direction *= rng.uniform(0.3, 0.8) / np.linalg.norm(direction)
            tools.append(fields.moved(tool, direction))
        field = fields.cut(body, tools, blend)
    _add_body(a, _maybe_bumpy(rng, field))


def metaball(a: Assembly, rng: Generator) -> None:
    """A soft lump: the level set of a sum of bells."""
    count = int(rng.integers(3, 10))
    centres = rng.normal(0, 0.4, (count, 3))
    widths = rng.uniform(0.18, 0.42, count)
    signs = np.where(np.arange(count) < 2, 1.0, rng.choice([1.0, -0.6], count, p=[0.8, 0.2]))

    def field(p: np.ndarray) -> np.ndarray:
        total = np.zeros(p.shape[:-1])
        for centre, width, sign in zip(centres, widths, signs, strict=True):
            away = p - centre
            square = np.einsum("...i,...i->...", away, away)
            total += sign * np.exp(-square / (2 * width**2))
        # the logarithm of a bell has the slope of a distance near its width
        return 0.3 * np.sqrt(2 * np.maximum(-np.log(np.maximum(total, 1e-30)), 0)) - 0.3

    _add_body(a, field)


def stone(a: Assembly, rng: Generator) -> None:
    """A pebble, a boulder, or a cut gem: a displaced or faceted ball."""
    half = rng.uniform(0.5, 1.0, 3)
    if rng.random() < 0.4:
        count = int(rng.integers(8, 40))
        normals = rng.normal(size=(count, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        distances = np.linalg.norm(normals * half, axis=1) * rng.uniform(0.75, 0.95, count)
        planes = [fields.half_space(n, d) for n, d in zip(normals, distances, strict=True)]
        field = fields.intersection([fields.ellipsoid(half), *planes], rng.uniform(0.0, 0.06))
    else:
        field = fields.superquadric(half, rng.uniform(2, 4))
        rough = rng.uniform(0.02, 0.12)
        field = fields.displaced(field, waves(rng, rough, 2.0, rng.choice([8.0, 25.0]), 14))
    _add_body(a, fields.scaled_values(fields.turned(field, rotation(rng)), 0.8))


def knot(a: Assembly, rng: Generator) -> None:
    """A closed or open tube that winds: a torus knot, a random loop, a spring, a chain of rings."""
    kind = rng.choice(["torus", "loop", "spring", "coil", "chain"], p=[0.25, 0.3, 0.2, 0.1, 0.15])
    around = int(rng.choice([24, 4, 6], p=[0.8, 0.1, 0.1]))
    square = float(rng.choice([2.0, 4.0, 8.0], p=[0.7, 0.15, 0.15]))
    if kind == "chain":
        return _chain(a, rng)
    count = 260
    t = np.linspace(0, 2 * np.pi, count, endpoint=False)
    closed = kind in ("torus", "loop")
    size = rng.uniform(0.07, 0.2)
    if kind == "torus":
        p, q = [(2, 3), (3, 2), (3, 4), (2, 5), (1, 3)][rng.integers(5)]
        ring = 0.7 + 0.32 * np.cos(q * t)
        points = np.stack([ring * np.cos(p * t), ring * np.sin(p * t), 0.32 * np.sin(q * t)], 1)
        size = min(size, 0.13)
    elif kind == "loop":
        numbers = np.arange(1, 4)
        size_of = rng.normal(size=(3, 3, 2)) / numbers[:, None] ** 1.2
        phase = numbers[None] * t[:, None]
        points = np.cos(phase) @ size_of[..., 0] + np.sin(phase) @ size_of[..., 1]
        points /= np.linalg.norm(points - points.mean(0), axis=1).max()
    else:
        turns = rng.uniform(2, 6)
        u = np.linspace(0, 1, count)
        radius = 0.6 if kind == "spring" else 0.15 + 0.75 * u
        rise = rng.uniform(0.5, 1.8) if kind == "spring" else rng.uniform(0.0, 0.3)
        angle = 2 * np.pi * turns * u
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle), rise * u], 1)
        size = min(size, 0.4 * (rise / turns if kind == "spring" else 0.75 / turns))
    swell = 1 + rng.uniform(0, 0.35) * np.sin(t * int(rng.integers(1, 4)))
    surface = tube(points, size * swell, around=around, square=square, bevel=1.0, ring=closed)
    a.add("tube", surface, 1)


def _chain(a, rng):
    t = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    long, wide = rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.3)
    size = rng.uniform(0.05, 0.09)
    at, direction = np.zeros(3), np.array([1.0, 0, 0])
    for number in range(int(rng.integers(3, 7))):
        link = np.stack([long * np.cos(t), wide * np.sin(t), 0 * t], 1)
        if number % 2:
            link = link[:, [0, 2, 1]]
        side = np.cross([0.0, 0.0, 1.0], direction)
        frame = np.stack([direction, side, np.cross(direction, side)])
        a.add(f"link {number % 2 + 1}", tube(link @ frame + at, size, around=20, ring=True), 1)
        at = at + direction * 2 * (long - size)
        turn = rng.uniform(-0.5, 0.5)
        c, s = np.cos(turn), np.sin(turn)
        x, y, _ = direction
        direction = np.array([c * x - s * y, s * x + c * y, 0.0])


def wire(a: Assembly, rng: Generator) -> None:
    """Bent pipes: a trunk with branches, as coral, driftwood or plumbing has them."""
    ends = [np.array([0.0, 0.0, -0.9])]
    blend, size = log_uniform(rng, 0.02, 0.15), rng.uniform(0.08, 0.2)
    parts: list[Field] = []
    for number in range(int(rng.integers(3, 8))):
        start = ends[int(rng.integers(len(ends)))] if number else ends[0]
        step = np.add(rng.normal(0, 0.35, (3, 3)), (0, 0, 0.2))
        points = np.clip(start + np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)]), -1, 1)
        run = smooth_path(points + rng.normal(0, 1e-3, points.shape), 12)
        ends += [points[2], points[3]]
        thick = size * rng.uniform(0.6, 1.1)
        parts.append(fields.path(run, np.linspace(thick, thick * rng.uniform(0.4, 1.1), 12)))
    _add_body(a, fields.union(parts, blend), half_extent=1.35)


def _primitive(rng, scale, kinds=None):
    half = log_uniforms(rng, 0.14, 0.6, 3) * scale
    kind = rng.choice(kinds or ["superquadric", "box", "capsule", "cylinder", "torus", "cone"])
    least = half.min()
    if kind == "superquadric":
        return fields.superquadric(half, rng.choice([2.0, 3.0, 5.0]))
    if kind == "box":
        return fields.box(half, rng.uniform(0.05, 0.5) * least)
    if kind == "capsule":
        return fields.capsule((0, 0, -half[2]), (0, 0, half[2]), half[0] * 0.8, half[1] * 0.8)
    if kind == "cylinder":
        return fields.cylinder(half[0], half[2], rng.uniform(0.05, 0.4) * min(half[0], half[2]))
    if kind == "torus":
        return fields.torus(half[0], min(half[1], 0.8 * half[0]) * 0.5)
    return fields.cone(half[0], half[1], half[2], rng.uniform(0.05, 0.4) * least)


def _maybe_bumpy(rng, field):
    if rng.random() < 0.25:
        return fields.scaled_values(
            fields.displaced(field, waves(rng, rng.uniform(0.005, 0.03), 4, 16)), 0.85
        )
    return field


def _add_body(a, field, half_extent=1.9):
    a.add("body", surface_of(field, half_extent), 1)
