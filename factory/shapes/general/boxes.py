"""Flat faces that meet in sharp edges: machine parts made of blocks, and boxes, cabinets, houses.

Most things that people make have such faces, and most other families have none.
"""

import numpy as np
from numpy.typing import ArrayLike

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import Surface
from factory.shapes.general.draws import Generator, log_uniform, rotation
from factory.shapes.lofts import loft, rod

RINGS = 13  # of a prism along its axis, so that every shape has 2,000 triangles
PER_SIDE = 14  # points along each side of a prism's outline


def prism(outline: ArrayLike, height: float, top: ArrayLike = (1.0, 1.0)) -> Surface:
    """Return a prism about z, centred: a convex outline (N, 2), and its factors at the top end.

    A top of (1, 0.02) is a wedge, one of (0.02, 0.02) a pyramid.
    """
    corners = np.asarray(outline, float)
    per_side = PER_SIDE if len(corners) <= 8 else 1
    t = np.arange(per_side)[:, None] / per_side
    ahead = np.roll(corners, -1, axis=0)
    points = (corners[:, None] * (1 - t) + ahead[:, None] * t).reshape(-1, 2)
    share = np.linspace(0, 1, RINGS)[:, None, None]
    rings = points * (1 - share + share * np.asarray(top, float))
    z = np.broadcast_to((share - 0.5) * height, (RINGS, len(points), 1))
    return loft(np.concatenate([rings, z], 2))


def box(size: ArrayLike) -> Surface:
    """Return a box with sharp edges, centred; size: its sides along x, y and z."""
    x, y, z = np.asarray(size, float)
    return prism([(x / 2, y / 2), (-x / 2, y / 2), (-x / 2, -y / 2), (x / 2, -y / 2)], z)


def _polygon(sides: int, turn: float = 0.0) -> np.ndarray:
    angle = 2 * np.pi * np.arange(sides) / sides + turn
    return np.stack([np.cos(angle), np.sin(angle)], 1)


def _piece(rng: Generator, size: np.ndarray) -> Surface:
    """A box, a cylinder, a prism, a wedge or a pyramid of about this size (3,)."""
    kind = rng.choice(["box", "round", "prism", "tapered"], p=[0.52, 0.18, 0.15, 0.15])
    if kind == "box":
        return box(size)
    if kind == "tapered":
        half = size[:2] / 2
        outline = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * half
        top = rng.choice([0.02, 1.0, rng.uniform(0.2, 0.9)], 2)
        return prism(outline, size[2], top)
    sides = 48 if kind == "round" else int(rng.integers(3, 9))
    outline = _polygon(sides, rng.uniform(0, 2 * np.pi)) * size[:2].mean() / 2
    surface = prism(outline, size[2], np.full(2, rng.uniform(0.3, 1) if rng.random() < 0.2 else 1))
    axis = rng.integers(3)  # lying along x or y, or standing
    return surface if axis == 2 else surface.turned("xy"[axis], np.pi / 2)


def _extents(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    return surface.vertices.min(0), surface.vertices.max(0)


def block(a: Assembly, rng: Generator) -> None:
    """Two to eight blocks, each on a side of an earlier one, such as parts of machines and robots.
    Segments: 1 the first block, 2 the others.
    """
    count = int(rng.integers(2, 9))
    size = np.array([log_uniform(rng, 0.3, 1.0) for _ in range(3)])
    pieces = [_piece(rng, size)]
    for _ in range(count - 1):
        low, high = _extents(pieces[rng.integers(len(pieces))])
        own = np.array([log_uniform(rng, 0.1, 0.8) for _ in range(3)])
        if rng.random() < 0.25:  # a bar or a plate
            own[rng.integers(3)] *= rng.choice([0.25, 2.5])
        piece = _piece(rng, own)
        if rng.random() < 0.25:
            piece = piece.turned("xyz"[rng.integers(3)], rng.uniform(0, np.pi))
        axis, sign = rng.integers(3), rng.choice([-1.0, 1.0])
        place = rng.uniform(low, high)
        depth = _extents(piece)[1][axis]
        sunk = rng.uniform(0.2, 1.0) * depth  # how far it goes into the other
        place[axis] = (high[axis] if sign > 0 else low[axis]) + sign * (depth - sunk)
        pieces.append(piece.moved(*place))
    turn = rotation(rng) if rng.random() < 0.5 else np.eye(3)
    for number, piece in enumerate(pieces):
        turned = Surface(piece.vertices @ turn.T, piece.faces)
        a.add(f"block {number + 1}", turned, 1 if number == 0 else 2)


def cabinet(a: Assembly, rng: Generator) -> None:
    """A cupboard, a crate, a window frame, stairs or a house. Segments: 1 the body, 2 the rest."""
    kinds = (_cupboard, _shelves, _crate, _frame, _stairs, _house)
    size = np.array([log_uniform(rng, 0.25, 1.2) for _ in range(3)])
    kinds[rng.choice(len(kinds), p=[0.35, 0.15, 0.15, 0.12, 0.08, 0.15])](a, rng, size)


def _cupboard(a, rng, size):
    """A body with doors or drawers that stand out or lie in, handles, a plinth or a top."""
    x, y, z = size
    a.add("body", box(size), 1)
    rows, columns = (int(n) for n in rng.integers(1, 5, 2))
    gap, out = rng.uniform(0.01, 0.05) * min(y, z), rng.uniform(0.01, 0.06)
    width, height = (y - gap) / columns - gap, (z - gap) / rows - gap
    framed, handle = rng.random() < 0.4, rng.choice(["bar", "knob", "none"])
    for row in range(rows):
        for column in range(columns):
            at = np.array(
                [
                    (x + out) / 2,
                    -y / 2 + gap + width / 2 + column * (width + gap),
                    -z / 2 + gap + height / 2 + row * (height + gap),
                ]
            )
            if framed:
                bar = rng.uniform(0.1, 0.2) * min(width, height)
                _bars(a, at, (out, width, height), bar)
            else:
                a.add("front", box((out, width, height)).moved(*at), 2)
            front = at + np.array([out / 2, 0, 0.3 * height * rng.choice([-1, 0, 1])])
            if handle == "bar":
                long = rng.uniform(0.2, 0.6) * width
                a.add("handle", box((0.06, long, 0.03)).moved(*front), 2)
            elif handle == "knob":
                knob = prism(_polygon(24) * 0.025, 0.08).turned("y", np.pi / 2)
                a.add("handle", knob.moved(*front), 2)
    if rng.random() < 0.5:
        thick, over = rng.uniform(0.03, 0.1), rng.uniform(0.0, 0.12)
        a.add("top", box((x + over, y + over, thick)).moved(z=(z + thick) / 2), 2)
    if rng.random() < 0.5:
        tall = rng.uniform(0.05, 0.3)
        for i in (-1, 1):
            for j in (-1, 1):
                leg = box((0.07, 0.07, tall + 0.02))
                a.add("leg", leg.moved(0.42 * x * i, 0.42 * y * j, -z / 2 - tall / 2), 2)


def _bars(a, at, size, bar):
    """Four bars around a panel that lies deeper; size: (depth, width, height) of the whole."""
    out, width, height = size
    for s in (-1, 1):
        a.add(
            "frame", box((out, bar, height)).moved(at[0], at[1] + s * (width - bar) / 2, at[2]), 2
        )
        across = box((out, width - 2 * bar + 0.002, bar))
        a.add("frame", across.moved(at[0], at[1], at[2] + s * (height - bar) / 2), 2)


def _walls(a, size, thick, sides):
    """The named sides of a hollow box: "back", "left", "right", "bottom", "top", "front"."""
    x, y, z = size
    places = {
        "back": ((thick, y, z), (-(x - thick) / 2, 0, 0)),
        "front": ((thick, y, z), ((x - thick) / 2, 0, 0)),
        "left": ((x, thick, z), (0, (y - thick) / 2, 0)),
        "right": ((x, thick, z), (0, -(y - thick) / 2, 0)),
        "bottom": ((x, y, thick), (0, 0, -(z - thick) / 2)),
        "top": ((x, y, thick), (0, 0, (z - thick) / 2)),
    }
    for side in sides:
        wall, at = places[side]
        a.add(side, box(wall).moved(*at), 1)


def _shelves(a, rng, size):
    """An open cupboard with boards, some compartments filled with books or boxes."""
    x, y, z = size * [0.7, 1.0, 1.3]
    thick = rng.uniform(0.02, 0.06)
    _walls(a, (x, y, z), thick, ("back", "left", "right", "bottom", "top"))
    boards = int(rng.integers(1, 5))
    step = z / (boards + 1)
    for number in range(boards + 1):
        floor = -z / 2 + step * number
        if number:
            a.add("board", box((x, y, thick)).moved(z=floor), 2)
        along = -y / 2 + thick
        while rng.random() < 0.8:
            wide, tall = rng.uniform(0.03, 0.25) * y, rng.uniform(0.4, 0.85) * step
            if along + wide > y / 2 - thick:
                break
            deep = rng.uniform(0.4, 0.9) * x
            book = box((deep, wide, tall))
            a.add(
                "book", book.moved((deep - x) / 2, along + wide / 2, floor + (tall + thick) / 2), 2
            )
            along += wide * rng.uniform(1.0, 1.6)


def _crate(a, rng, size):
    """An open box, perhaps with a lid that stands open or lies beside."""
    thick = rng.uniform(0.03, 0.1) * size.min()
    _walls(a, size, thick, ("back", "front", "left", "right", "bottom"))
    x, y, z = size
    if rng.random() < 0.5:
        lid = box((x, y, thick)).moved(x / 2, 0, thick / 2).turned("y", -rng.uniform(0.1, 1.9))
        a.add("lid", lid.moved(-x / 2, 0, z / 2), 2)
    if rng.random() < 0.4:
        for s in (-1, 1):
            strip = box((0.15 * x, y * 1.06, 0.12 * z))
            a.add("strip", strip.moved(s * 0.3 * x, 0, rng.uniform(-0.3, 0.3) * z), 2)


def _frame(a, rng, size):
    """A window or a picture frame with bars, with or without a pane."""
    deep = rng.uniform(0.04, 0.2)
    _, y, z = size
    bar = rng.uniform(0.06, 0.16) * min(y, z)
    _bars(a, np.zeros(3), (deep, y, z), bar)
    for _ in range(int(rng.integers(0, 3))):
        a.add("bar", box((deep * 0.7, y - bar, bar * 0.5)).moved(z=rng.uniform(-0.35, 0.35) * z), 2)
    for _ in range(int(rng.integers(0, 3))):
        a.add("bar", box((deep * 0.6, bar * 0.5, z - bar)).moved(y=rng.uniform(-0.35, 0.35) * y), 2)
    if rng.random() < 0.6:
        a.add("pane", box((deep * 0.3, y - bar, z - bar)), 1)


def _stairs(a, rng, size):
    """Steps between two walls, or free, with or without a rail."""
    steps = int(rng.integers(3, 9))
    x, y, z = size
    for number in range(steps):
        tall = z * (number + 1) / steps
        step = box((x / steps * 1.001, y, tall))
        a.add("step", step.moved(-x / 2 + x * (number + 0.5) / steps, 0, tall / 2), 1)
    if rng.random() < 0.5:
        for s in (-1, 1):
            ends = np.array([[-x / 2, s * y * 0.45, 0.3], [x / 2, s * y * 0.45, z + 0.3]])
            a.add("rail", rod(ends[0], ends[1], 0.025), 2)


def _house(a, rng, size):
    """Walls, a gabled or hipped roof that overhangs, windows, a door, a chimney."""
    x, y, z = size
    a.add("walls", box(size), 1)
    over, rise = rng.uniform(1.0, 1.25), rng.uniform(0.25, 0.9) * y
    ridge = 0.02 if rng.random() < 0.7 else rng.uniform(0.1, 0.6)
    half = np.array([x, y]) / 2 * over
    outline = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * half
    along = 1.0 if rng.random() < 0.6 else rng.uniform(0.1, 0.7)
    a.add("roof", prism(outline, rise, (along, ridge)).moved(z=(z + rise) / 2), 2)
    for _ in range(int(rng.integers(0, 5))):
        wide, tall = rng.uniform(0.1, 0.3) * y, rng.uniform(0.15, 0.4) * z
        place = (x / 2, rng.uniform(-0.35, 0.35) * y, rng.uniform(-0.25, 0.25) * z)
        a.add("window", box((0.05, wide, tall)).moved(*place), 2)
    if rng.random() < 0.4:
        chimney = box((0.12 * x, 0.12 * y, rise))
        place = (rng.uniform(-0.3, 0.3) * x, 0.2 * y, z / 2 + rise * 0.8)
        a.add("chimney", chimney.moved(*place), 2)
