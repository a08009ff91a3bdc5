"""What grows, for testing only: plants in pots and seashells."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import Surface
from factory.shapes.curves import smooth_path
from factory.shapes.general.draws import Generator
from factory.shapes.general.vessels import turned_ring
from factory.shapes.lofts import ellipsoid, loft, revolve, slab, tube
from factory.shapes.shells import shell

LIVING, POT = 1, 2


def plant(a: Assembly, rng: Generator) -> None:
    """A plant in a pot: leaves on stems, a rosette, a cactus or tulips. Segments: 1 the plant,
    2 pot and soil.
    """
    kind = str(rng.choice(["leafy", "rosette", "cactus", "tulips"], p=[0.35, 0.25, 0.2, 0.2]))
    wide = rng.uniform(0.3, 0.42)
    soil = _pot(a, rng, wide)
    if kind == "leafy":
        _leafy(a, rng, wide, soil)
    elif kind == "rosette":
        _rosette(a, rng, soil)
    elif kind == "cactus":
        _cactus(a, rng, wide, soil)
    else:
        _tulips(a, rng, wide, soil)


def _pot(a, rng, wide):
    """Add a pot with soil; return the height of the soil."""
    height, low, wall = rng.uniform(0.4, 0.7), rng.uniform(0.6, 0.95) * wide, 0.035
    rim = rng.uniform(0.0, 0.05)
    lip = height * rng.uniform(0.75, 0.85)
    outer = [
        [low * 0.9, 0],
        [low, 0.02],
        [low + (wide - low) * 0.8, lip],
        [wide + rim, lip + 0.01],
        [wide + rim + 0.01, height - 0.01],
        [wide + rim - 0.01, height],
    ]
    soil = height - rng.uniform(0.05, 0.1)
    inner = [[wide - wall, height], [wide - wall - 0.02, soil - 0.02], [low - wall, 0.06]]
    a.add("pot", turned_ring(np.array(outer + inner + [[low * 0.5, 0.06], [low * 0.5, 0]])), POT)
    bumps = np.linspace(0, wide - wall + 0.01, 12)[::-1]
    ground = np.stack([bumps, soil + 0.03 * np.cos(bumps / wide * 1.5)], 1)
    a.add("soil", revolve(np.vstack([[0, soil - 0.1], [wide - wall, soil - 0.1], ground]), 48), POT)
    return soil


def _leaf(rng, length, width, bend, fold, pointed=0.8):
    """A leaf (Surface) from the origin along +x; it bends down by `bend` radians to its tip.

    fold  how far the edges rise above the middle, as a share of the width
    """
    t = np.linspace(0, 1, 12)
    angle = -bend * t
    run = np.concatenate([[0], np.cumsum(np.cos(angle[1:]))]) / 11 * length
    rise = np.concatenate([[0], np.cumsum(np.sin(angle[1:]))]) / 11 * length
    half = width * np.sin(np.pi * np.clip(0.06 + 0.92 * t, 0, 1) ** pointed) ** 0.8 + 0.006
    across = np.linspace(-1, 1, 7)
    wave = rng.uniform(0, 0.06) * np.sin(5 * np.pi * t)[:, None] * across**2
    side = half[:, None] * across
    lift = fold * half[:, None] * np.abs(across) ** 1.5 + wave * width
    points = np.stack(
        [
            run[:, None] - lift * np.sin(angle)[:, None],
            side,
            rise[:, None] + lift * np.cos(angle)[:, None],
        ],
        -1,
    )
    return shell(points, 0.02 * (0.5 + width), times=1)


def _placed(leaf: Surface, pitch: float, turn: float, at) -> Surface:
    """The leaf raised by `pitch` radians, turned about z and moved."""
    return leaf.turned("y", -pitch).turned("z", turn).moved(*at)


def _leafy(a, rng, wide, soil):
    stems = int(rng.integers(1, 5))
    length, width = rng.uniform(0.35, 0.6), rng.uniform(0.1, 0.22)
    per_stem = max(3, int(24 / stems * rng.uniform(0.5, 0.9)))
    for _ in range(stems):
        around = rng.uniform(0, 2 * np.pi)
        away = np.array([np.cos(around), np.sin(around), 0]) * rng.uniform(0.1, 0.6)
        tall = rng.uniform(0.6, 1.3)
        root = away * wide * 0.6 + [0, 0, soil - 0.05]
        points = [root, root + 0.3 * away + [0, 0, 0.55 * tall], root + 0.6 * away + [0, 0, tall]]
        line = smooth_path(points, 20)
        a.add("stem", tube(line, np.linspace(0.035, 0.018, 20), around=10), LIVING)
        turn = around
        for t in np.linspace(0.3, 1.0, per_stem):
            turn += 2.4 + rng.uniform(-0.3, 0.3)  # about the golden angle
            size = rng.uniform(0.7, 1.1) * (1.1 - 0.4 * t)
            leaf = _leaf(rng, length * size, width * size, rng.uniform(0.3, 1.5), 0.35)
            at = line[min(int(t * 19), 19)]
            a.add("leaf", _placed(leaf, rng.uniform(0.1, 0.7) + 0.5 * t, turn, at), LIVING)


def _rosette(a, rng, soil):
    count = int(rng.integers(14, 30))
    length, width = rng.uniform(0.5, 0.95), rng.uniform(0.06, 0.14)
    upright, bend = rng.uniform(0.3, 0.6), rng.uniform(-0.6, 0.9)
    for number in range(count):
        t = number / count  # from the outermost to the innermost
        pitch = (0.25 + upright * t + 0.55 * t) * 1.2 + rng.uniform(-0.08, 0.08)
        size = (1 - 0.35 * t) * rng.uniform(0.9, 1.1)
        leaf = _leaf(rng, length * size, width * size, bend * (1 - 0.5 * t), 0.8, 0.6)
        turn = 2.4 * number
        at = [0.06 * np.cos(turn), 0.06 * np.sin(turn), soil]
        a.add("leaf", _placed(leaf, pitch, turn, at), LIVING)


def _cactus(a, rng, wide, soil):
    tall, ribs = rng.uniform(0.6, 1.4), int(rng.integers(8, 15))
    thick = wide * rng.uniform(0.5, 0.75)
    depth = rng.uniform(0.08, 0.2)
    if rng.random() < 0.35:
        tall = thick * 1.6
        thick *= 1.3
    a.add("body", _ribbed([[0, 0, soil - 0.05], [0, 0, soil + tall]], thick, ribs, depth), LIVING)
    for _ in range(int(rng.integers(0, 4)) if tall > 0.8 else 0):
        turn, level = rng.uniform(0, 2 * np.pi), soil + tall * rng.uniform(0.35, 0.6)
        side = thick * rng.uniform(1.6, 2.1)
        bow = [
            [thick * 0.6, 0, level],
            [side * 0.9, 0, level + 0.04],
            [side, 0, level + 0.25],
            [side, 0, level + rng.uniform(0.4, 0.6)],
        ]
        arm = _ribbed(smooth_path(bow, 24), thick * 0.5, 8, depth)
        a.add("arm", arm.turned("z", turn), LIVING)


def _ribbed(path, thick, ribs, depth):
    """A column with ribs along a path and round ends."""
    path = smooth_path(path, 40)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.array([0.0, 1.0, 0.0])
    other = np.cross(tangent, side)
    angle = np.linspace(0, 2 * np.pi, ribs * 8, endpoint=False)
    section = 1 - depth * (1 - np.abs(np.cos(0.5 * ribs * angle)))
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    s = np.linspace(0, length, 40)
    size = thick * np.sqrt(np.clip(1 - (1 - np.minimum(length - s, thick) / thick) ** 2, 1e-3, 1))
    rings = [
        p + r * section[:, None] * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * o)
        for p, r, o in zip(path, size, other, strict=True)
    ]
    return loft(rings)


def _tulips(a, rng, wide, soil):
    for _ in range(int(rng.integers(3, 7))):
        around, tall = rng.uniform(0, 2 * np.pi), rng.uniform(0.7, 1.2)
        away = np.array([np.cos(around), np.sin(around), 0.0]) * rng.uniform(0.1, 1.0) * wide * 0.7
        lean = away * rng.uniform(0.3, 1.2)
        top = away + lean + [0, 0, soil + tall]
        line = smooth_path(
            [
                away + np.array([0, 0, soil - 0.05]),
                away + 0.4 * lean + np.array([0, 0, soil + 0.5 * tall]),
                top,
            ],
            16,
        )
        a.add("stem", tube(line, 0.022, around=10), LIVING)
        size = rng.uniform(0.16, 0.22)
        a.add("heart", ellipsoid([0.1, 0.1, 0.2]).moved(*top + np.array([0, 0, 0.06])), LIVING)
        for number in range(6):
            petal = _leaf(rng, size * 1.7, size * 0.52, -rng.uniform(0.1, 0.4), 0.5, 0.75)
            pitch = rng.uniform(1.15, 1.35) - 0.2 * (number % 2)
            turn = number * np.pi / 3 + around
            at = top + 0.035 * np.array([np.cos(turn), np.sin(turn), 0])
            a.add("petal", _placed(petal, pitch, turn, at), LIVING)
        for number in range(2):
            blade = _leaf(rng, tall * 0.75, 0.06, rng.uniform(0.2, 0.9), 0.7, 0.55)
            turn = around + number * np.pi + rng.uniform(-0.5, 0.5)
            pitch = rng.uniform(1.0, 1.35)
            a.add("blade", _placed(blade, pitch, turn, [*away[:2], soil]), LIVING)


def seashell(a: Assembly, rng: Generator) -> None:
    """A snail's, whelk's or nautilus's shell, a turret or a scallop."""
    kind = str(rng.choice(["snail", "whelk", "nautilus", "turret", "scallop"]))
    if kind == "scallop":
        valve = _scallop(rng)
        a.add("valve", valve, 1)
        if rng.random() < 0.5:
            a.add("other valve", valve.scaled(z=-rng.uniform(0.3, 0.8)), 1)
        ears = np.array([[-0.42, -0.03], [0.42, -0.03], [0.3, 0.26], [-0.3, 0.26]])
        a.add("ears", slab(ears, 0.05, 0.6), 1)
        a.turn("y", -rng.uniform(0.2, 1.2))
    else:
        a.add("shell", _coiled(rng, kind), 1)
        a.turn("x", rng.uniform(-0.5, 0.5) + np.pi / 2 * (kind == "nautilus"))
        a.turn("y", rng.uniform(-0.4, 0.4) + (kind in ("whelk", "turret")) * rng.uniform(0, 1.5))
    a.turn("z", rng.uniform(0, 2 * np.pi))


def _coiled(rng, kind):
    """A tube that winds about z and grows by the same factor each turn, open at its mouth.

    Source: Raup, "Geometric analysis of shell coiling" (1966): expansion for each turn, distance of
    the section from the axis, translation along the axis.
    """
    turns, growth, fall = {
        "snail": (4.0, rng.uniform(1.7, 2.1), rng.uniform(1.1, 2.0)),
        "whelk": (5.0, rng.uniform(1.55, 1.8), rng.uniform(2.4, 3.4)),
        "nautilus": (3.0, rng.uniform(2.5, 3.3), 0.0),
        "turret": (8.0, rng.uniform(1.25, 1.35), rng.uniform(3.4, 5.0)),
    }[kind]
    tall = {"snail": 1.0, "whelk": 1.35, "nautilus": 0.85, "turret": 1.1}[kind]
    tail = rng.uniform(0.5, 1.2) if kind == "whelk" else 0.0
    folds, fold = int(rng.integers(8, 16)), rng.uniform(0.0, 0.09) * (kind != "nautilus")
    ridges, ridge = int(rng.integers(5, 12)), rng.uniform(0.0, 0.03)
    steps, around = int(44 * turns), 40
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)

    def ring(turn: float, shrink: float) -> np.ndarray:
        size = growth ** (turn - turns)
        bumps = fold * np.clip(np.cos(folds * 2 * np.pi * turn), 0, 1) * (np.cos(angle) > -0.3)
        section = 0.5 * size * (shrink + bumps + ridge * np.cos(ridges * angle) * np.cos(angle / 2))
        outward = 0.46 * size + section * np.cos(angle)
        along = section * np.sin(angle) * tall
        along = along - tail * size * np.exp(-(((angle - 1.5 * np.pi) / 0.45) ** 2)) * shrink
        along = along - fall * 0.5 * size
        c, s = np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)
        return np.stack([np.maximum(outward, 0.0) * c, np.maximum(outward, 0.0) * s, along], 1)

    outside = [ring(t, 1.0) for t in np.linspace(0, turns, steps)]
    flare = rng.uniform(1.02, 1.12)
    lip = [ring(turns + 0.01, flare), ring(turns + 0.012, 0.9 * flare), ring(turns, 0.86)]
    inside = [ring(t, 0.86) for t in np.linspace(turns - 0.02, turns - 0.6, 24)]
    return loft([*outside, *lip, *inside])


def _scallop(rng):
    """One valve of a scallop: a domed fan with ribs, its hinge at the origin."""
    ribs, depth = int(rng.integers(9, 19)), rng.uniform(0.015, 0.04)
    dome, spread = rng.uniform(0.25, 0.45), rng.uniform(1.05, 1.25)
    u = np.linspace(0.03, 1, 26)[:, None]
    v = np.linspace(-1, 1, ribs * 5)[None, :]
    angle = v * spread
    radius = u * np.cos(0.72 * angle) ** 0.7 * (1 + 0.015 * np.cos(2 * np.pi * ribs * v / 2) * u)
    height = dome * np.sin(np.pi * u**0.7 * 0.93) * np.sqrt(np.maximum(1 - 0.94 * v**2, 0))
    height = height + depth * u * np.cos(np.pi * ribs * v)
    points = np.stack([radius * np.sin(angle), radius * np.cos(angle), height], -1)
    return shell(points, 0.035, times=1)
