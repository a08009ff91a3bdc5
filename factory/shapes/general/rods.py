"""Things of rods and bars, for testing only: baskets, cages and cycles."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import smooth_path, superellipse
from factory.shapes.general.draws import Generator
from factory.shapes.lofts import ellipsoid, rod, slab, tube
from factory.shapes.rounded_boxes import rounded_box

FRAME, SECOND = 1, 2


def basket(a: Assembly, rng: Generator) -> None:
    """A woven basket, a basket of wire, or a cage. Segments: 1 the weave or the bars, 2 handles and
    floors.
    """
    kind = str(rng.choice(["woven", "wire", "cage"], p=[0.45, 0.3, 0.25]))
    {"woven": _woven, "wire": _wire_basket, "cage": _cage}[kind](a, rng)


def _plan(rng):
    """Half-lengths (2,) and the exponent of a basket's plan."""
    return np.array([rng.uniform(0.5, 0.8), rng.uniform(0.5, 0.8)]), float(rng.choice([2.0, 4.0]))


def _woven(a, rng):
    """Strands that pass outside and inside of upright stakes in turn."""
    half, square = _plan(rng)
    height, flare = rng.uniform(0.45, 1.0), rng.uniform(0.0, 0.35)
    stakes = int(rng.choice([17, 21, 25]))
    thick = rng.uniform(0.028, 0.04)
    rows = min(int(height / (1.75 * thick)), 18)
    count = 6 * stakes
    outline = superellipse(count, square)

    def at(level: float, offset: np.ndarray) -> np.ndarray:
        grown = 1 + flare * (level / height) ** 0.7
        flat = outline * half * grown * (1 + offset[:, None])
        return np.column_stack([flat, np.full(count, level)])

    t = np.arange(count) / count * stakes
    for row in range(rows):
        # an odd number of stakes: the strand is outside where the one below is inside
        wave = 1.1 * thick * np.cos(np.pi * (t + row))
        ring = at(height * (row + 0.5) / rows, wave)
        a.add("strand", tube(ring, [thick, 0.8 * thick], around=8, ring=True), FRAME)
    none = np.zeros(count)
    levels = [at(z, none) for z in np.linspace(0, height, 6)]
    for stake in range(stakes):
        line = np.array([level[6 * stake] for level in levels])
        a.add("stake", tube(line, 0.6 * thick, around=8), FRAME)
    for side in LEFT_RIGHT:  # two strands twisted about the rim
        wave = side * 0.9 * thick * np.cos(2 * np.pi * t)
        rim = at(height, wave)
        rim[:, 2] += side * 0.9 * thick * np.sin(2 * np.pi * t)
        a.add("rim", tube(rim, 1.2 * thick, around=8, ring=True), FRAME)
    a.add("floor", slab(outline[::2] * half, 0.05, 0.8).moved(z=0.03), SECOND)
    _add_handles(a, rng, half * (1 + flare), height, thick)


def _add_handles(a, rng, half, height, thick):
    kind = rng.choice(["arch", "two", "none"], p=[0.5, 0.3, 0.2])
    arc = np.linspace(0, np.pi, 60)
    if kind == "arch":
        tall = rng.uniform(0.5, 0.9)
        line = np.stack([0 * arc, half[1] * np.cos(arc), height + tall * np.sin(arc) ** 0.8], 1)
        turns = int(rng.integers(8, 16))
        for phase in (0.0, np.pi):  # a cord of two strands
            twist = turns * 2 * arc + phase
            shift = thick * np.stack([np.cos(twist), 0 * twist, np.sin(twist)], 1)
            a.add("handle", tube(line + shift, 1.3 * thick, around=8), SECOND)
    elif kind == "two":
        for side in LEFT_RIGHT:
            low = height - 0.05
            line = np.stack(
                [0.22 * np.cos(arc), side * (half[1] + 0.1 * np.sin(arc)), low + 0.2 * np.sin(arc)],
                1,
            )
            a.add("handle", tube(line, 1.4 * thick, around=10, bevel=1.0), SECOND)


def _wire_basket(a, rng):
    half, height, flare = _plan(rng)[0], rng.uniform(0.4, 0.8), rng.uniform(0.05, 0.3)
    thick, square = rng.uniform(0.014, 0.022), float(rng.choice([4.0, 8.0]))
    around = 4 * int(rng.integers(8, 13))
    outline = superellipse(around, square)

    def ring(level: float) -> np.ndarray:
        grown = outline * half * (1 + flare * level / height)
        return np.column_stack([grown, np.full(around, level)])

    for level in np.linspace(0, height, int(rng.integers(3, 7))):
        a.add("hoop", tube(ring(level), thick, around=8, ring=True), FRAME)
    a.add("rim", tube(ring(height), 2.2 * thick, around=12, ring=True), SECOND)
    low, high = ring(0.0), ring(height)
    for number in range(around):
        a.add("bar", rod(low[number], high[number], thick, around=8), FRAME)
    for axis in (0, 1):
        for share in np.linspace(-0.85, 0.85, 9):
            end = np.zeros((2, 3))
            end[:, axis] = share * half[axis]
            edge = (1 - np.abs(share) ** square) ** (1 / square) * half[1 - axis]
            end[:, 1 - axis] = [-edge, edge]
            a.add("floor bar", rod(end[0], end[1], thick, around=8), FRAME)
    _add_handles(a, rng, half * (1 + flare), height, 1.6 * thick)


def _cage(a, rng):
    """A birdcage: upright bars that meet above in a dome, hoops, a floor, a ring, a perch."""
    wide, height = rng.uniform(0.5, 0.7), rng.uniform(0.6, 1.2)
    dome, bars = wide * rng.uniform(0.5, 1.2), int(rng.integers(18, 31))
    thick = rng.uniform(0.013, 0.02)
    square = float(rng.choice([2.0, 2.0, 6.0]))
    outline = superellipse(bars, square) * wide
    arc = np.linspace(0, np.pi / 2, 12)[1:]
    for x, y in outline:
        up = np.array([[x, y, 0.06], [x, y, height / 2], [x, y, height]])
        bow = np.stack([x * np.cos(arc), y * np.cos(arc), height + dome * np.sin(arc)], 1)
        a.add("bar", tube(np.vstack([up, bow]), thick, around=8), FRAME)
    smooth = superellipse(96, square) * wide
    for level in (0.12, rng.uniform(0.3, 0.6) * height, height):
        ring = np.column_stack([smooth, np.full(96, level)])
        a.add("hoop", tube(ring, 1.4 * thick, around=8, ring=True), FRAME)
    a.add("tray", slab(smooth[::2] * 1.06, 0.14, 0.5), SECOND)
    t = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    loop = np.stack([0 * t, 0.1 * np.cos(t), 0.1 * np.sin(t)], 1)
    top = tube(loop, 0.022, around=12, ring=True, side=(1, 0, 0))
    a.add("ring", top.moved(z=height + dome + 0.1), SECOND)
    a.add("knob", ellipsoid([0.12] * 3).moved(z=height + dome), SECOND)
    a.add("perch", rod([0, -wide, 0.4 * height], [0, wide, 0.4 * height], 0.025), SECOND)


def cycle(a: Assembly, rng: Generator) -> None:
    """A bicycle, a tricycle, a penny-farthing or a kick scooter. Segments: 1 the frame, 2 wheels
    and saddle.
    """
    kind = str(rng.choice(["bicycle", "tricycle", "penny", "scooter"], p=[0.5, 0.15, 0.15, 0.2]))
    {"bicycle": _bicycle, "tricycle": _tricycle, "penny": _penny, "scooter": _scooter}[kind](a, rng)


def _wheel(a, at, radius, tyre, spokes, wide=0.06):
    """A wheel in the x–z plane about `at`: tyre, rim, hub and spokes, or a disc without them."""
    t = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    circle = np.stack([np.cos(t), 0 * t, np.sin(t)], 1)
    a.add("tyre", tube((radius - tyre) * circle, tyre, around=16, ring=True).moved(*at), SECOND)
    rim = tube((radius - 2.2 * tyre) * circle, [0.7 * tyre, 0.4 * tyre], around=10, ring=True)
    a.add("rim", rim.moved(*at), FRAME)
    a.add("hub", rod([0, -wide, 0], [0, wide, 0], 0.05, around=16).moved(*at), FRAME)
    if not spokes:
        disc = slab(superellipse(56) * (radius - 2 * tyre), 0.05, 0.6).turned("x", np.pi / 2)
        a.add("disc", disc.moved(*at), FRAME)
    for number in range(spokes):
        angle = 2 * np.pi * number / spokes
        end = (radius - 2.2 * tyre) * np.array([np.cos(angle), 0, np.sin(angle)])
        base = [0.0, wide * 0.8 * (-1) ** number, 0.0]
        a.add("spoke", rod(base, end, 0.011, around=6).moved(*at), FRAME)


def _saddle(a, at, size=1.0):
    lobes = smooth_path([[0.18, 0, 0], [0.0, 0, 0.01], [-0.16, 0, 0.03], [-0.24, 0, 0.04]], 14)
    wide = size * np.interp(np.linspace(0, 1, 14), [0, 0.4, 0.8, 1], [0.03, 0.05, 0.13, 0.11])
    sizes = np.stack([wide, np.full(14, 0.045)], 1)
    a.add("saddle", tube(lobes * size, sizes, around=20, bevel=1.0).moved(*at), SECOND)


def _bicycle(a, rng):
    radius, tyre = rng.uniform(0.44, 0.5), rng.uniform(0.025, 0.05)
    rear, front = np.array([-0.78, 0, radius]), np.array([rng.uniform(0.75, 0.85), 0, radius])
    crank = np.array([-0.12, 0, radius - 0.08])
    seat = np.array([-0.32, 0, rng.uniform(1.15, 1.3)])
    head = np.array([front[0] - 0.27, 0, rng.uniform(1.15, 1.3)])
    neck = head + (front - head) * 0.27
    size = rng.uniform(0.03, 0.042)
    for at in (rear, front):
        _wheel(a, at, radius, tyre, int(rng.choice([16, 20, 24])))
    under = seat + (crank - seat) * 0.15
    low = rng.random() < 0.35  # a step-through frame
    cross = seat + (crank - seat) * (0.6 if low else 0.15)
    for start, end, thick in (
        (crank, seat, size),
        (crank, neck, 1.15 * size),
        (cross, head, size),
        (head, neck, 1.3 * size),
        (head, head + (head - neck) * 0.6, 0.8 * size),
    ):
        a.add("frame", rod(start, end, thick, around=14), FRAME)
    for side in LEFT_RIGHT:
        shift = np.array([0, 0.075 * side, 0])
        a.add("stay", rod(crank + shift * 0.6, rear + shift, 0.02, around=10), FRAME)
        a.add("stay", rod(under + shift * 0.3, rear + shift, 0.016, around=10), FRAME)
        bow = [neck + shift * 0.8, neck + (front - neck) * 0.4 + shift, front + shift]
        a.add("fork", tube(smooth_path(bow, 10), 0.022, around=10), FRAME)
    _drive(a, rng, crank, rear)
    _saddle(a, seat + np.array([0, 0, 0.1]))
    a.add("post", rod(seat, seat + np.array([0, 0, 0.1]), 0.022, around=10), FRAME)
    _bars(a, rng, head + (head - neck) * 0.6)
    if rng.random() < 0.4:
        arc = np.linspace(0.15 * np.pi, 1.05 * np.pi, 24)
        for at, turn in ((rear, 0.0), (front, 0.1)):
            path = (radius + 0.05) * np.stack([np.cos(arc + turn), 0 * arc, np.sin(arc + turn)], 1)
            guard = tube(path, [0.06, 0.012], around=12, side=(0, 1, 0))
            a.add("mudguard", guard.moved(*at), FRAME)


def _drive(a, rng, crank, rear):
    disc = slab(superellipse(40) * 0.13, 0.02).turned("x", np.pi / 2)
    a.add("chainring", disc.moved(*crank + np.array([0, -0.08, 0])), FRAME)
    turn = rng.uniform(0, np.pi)
    for side in LEFT_RIGHT:
        away = side * 0.2 * np.array([np.cos(turn), 0, np.sin(turn)])
        foot = crank + away + [0, 0.12 * side, 0]
        a.add("crank", rod(crank + np.array([0, 0.1 * side, 0]), foot, 0.02, around=10), FRAME)
        pedal = rounded_box([0.14, 0.12, 0.035], 0.012).moved(*foot + np.array([0, 0.07 * side, 0]))
        a.add("pedal", pedal, SECOND)
    for z in (0.13, -0.13):
        end = rear + np.array([0, -0.08, 0.35 * z])
        a.add("chain", rod(crank + np.array([0, -0.08, z]), end, 0.012, around=6), FRAME)


def _bars(a, rng, at):
    kind = rng.choice(["flat", "swept", "drop"])
    wide = rng.uniform(0.28, 0.36)
    if kind == "flat":
        half = [[0, 0, 0], [0.02, wide * 0.5, 0.01], [0, wide, 0.02]]
    elif kind == "swept":
        half = [[0, 0, 0], [0.08, 0.1, 0.06], [0.0, wide, 0.1], [-0.22, wide * 1.02, 0.09]]
    else:
        half = [
            *([0, 0, 0], [0.02, wide * 0.8, 0], [0.16, wide, -0.02]),
            *([0.2, wide, -0.12], [0.1, wide, -0.2], [-0.05, wide, -0.2]),
        ]
    line = smooth_path(half, 22) + at
    a.pair("bar", tube(line, 0.022, around=12), FRAME)
    a.pair("grip", rod(line[-5], line[-1], 0.034, around=14, bevel=1.0), SECOND)


def _tricycle(a, rng):
    big, small = rng.uniform(0.36, 0.46), rng.uniform(0.2, 0.28)
    front, rear = np.array([0.55, 0, big]), np.array([-0.55, 0, small])
    _wheel(a, front, big, 0.05, int(rng.choice([0, 10, 14])))
    spokes = int(rng.choice([0, 8, 12]))
    for side in LEFT_RIGHT:
        _wheel(a, rear + np.array([0, 0.38 * side, 0]), small, 0.045, spokes)
        a.add(
            "fork",
            rod(front + np.array([0, 0.09 * side, 0]), [0.36, 0.05 * side, 1.0], 0.025),
            FRAME,
        )
        foot = front + np.array([0.12 * side, 0.2 * side, 0.08 * side])
        a.add("crank", rod(front + np.array([0, 0.1 * side, 0]), foot, 0.022), FRAME)
        a.add("pedal", rounded_box([0.16, 0.14, 0.05], 0.02).moved(*foot), SECOND)
    a.add("axle", rod(rear + np.array([0, -0.38, 0]), rear + np.array([0, 0.38, 0]), 0.03), FRAME)
    spine = [[0.4, 0, 0.85], [0.15, 0, 0.6], [-0.25, 0, 0.5], [-0.55, 0, small]]
    a.add("frame", tube(smooth_path(spine, 20), 0.05, around=16), FRAME)
    a.add("post", rod([-0.25, 0, 0.5], [-0.27, 0, 0.66], 0.03), FRAME)
    _saddle(a, np.array([-0.27, 0, 0.7]), 1.25)
    a.add("stem", rod([0.36, 0, 0.95], [0.32, 0, 1.12], 0.035), FRAME)
    _bars(a, rng, np.array([0.32, 0, 1.12]))
    if rng.random() < 0.5:
        a.add("step", rounded_box([0.2, 0.5, 0.04], 0.02).moved(-0.62, 0, 0.42), FRAME)


def _penny(a, rng):
    big, small = rng.uniform(0.68, 0.85), rng.uniform(0.2, 0.28)
    front, rear = np.array([0.3, 0, big]), np.array([-0.75, 0, small])
    _wheel(a, front, big, 0.025, 28)
    _wheel(a, rear, small, 0.022, 14)
    top = np.array([0.24, 0, 2 * big + 0.1])
    arc = np.linspace(0.45 * np.pi, 0.98 * np.pi, 20)
    bow = (big + 0.1) * np.stack([np.cos(arc), 0 * arc, np.sin(arc)], 1) + front
    a.add("spine", tube(np.vstack([bow, rear + np.array([0.0, 0, 0.16])]), 0.035, around=14), FRAME)
    for side in LEFT_RIGHT:
        shift = np.array([0, 0.07 * side, 0])
        a.add("fork", rod(top + shift * 0.4, front + shift, 0.025), FRAME)
        a.add("rear fork", rod(rear + np.array([0.0, 0.02 * side, 0.2]), rear + shift, 0.02), FRAME)
        foot = front + np.array([0.05 * side, 0.13 * side, -0.14 * side])
        a.add("crank", rod(front + shift, foot, 0.02), FRAME)
        a.add("pedal", rounded_box([0.13, 0.12, 0.035], 0.012).moved(*foot), SECOND)
    _saddle(a, top + np.array([-0.2, 0, 0.06]))
    _bars(a, rng, top + np.array([0.03, 0, 0.05]))


def _scooter(a, rng):
    radius = rng.uniform(0.11, 0.22)
    deck = radius + rng.uniform(-0.02, 0.06)
    front, rear = np.array([0.6, 0, radius]), np.array([-0.6, 0, radius])
    spokes = int(rng.choice([0, 6, 10]))
    for at in (front, rear):
        _wheel(a, at, radius, 0.035, spokes, 0.05)
    board = rounded_box([0.85, rng.uniform(0.2, 0.3), 0.05], 0.02, edge=4)
    a.add("deck", board.moved(-0.03, 0, deck), FRAME)
    top = np.array([0.36, 0, rng.uniform(1.2, 1.6)])
    low = np.array([0.56, 0, 2 * radius + 0.06])
    a.add("column", rod(low, top, 0.035, around=16), FRAME)
    a.add(
        "neck",
        tube(smooth_path(np.array([low, [0.48, 0, deck + 0.08], [0.3, 0, deck]]), 12), 0.04),
        FRAME,
    )
    for side in LEFT_RIGHT:
        shift = np.array([0, 0.07 * side, 0])
        a.add("fork", rod(low + shift, front + shift, 0.022), FRAME)
        a.add("stay", rod([-0.4, 0.07 * side, deck], rear + shift, 0.022), FRAME)
    a.add("crown", rounded_box([0.06, 0.19, 0.05], 0.015).moved(*low), FRAME)
    _bars(a, rng, top)
