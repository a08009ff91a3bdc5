"""Parts of sofas: base, back, arms, cushions, pillows and feet, of the proportions of a Plan."""

from dataclasses import dataclass

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT, close_surface
from factory.shapes.curves import rounded_path, smooth_path
from factory.shapes.lofts import ellipsoid, rod, tube
from factory.shapes.rounded_boxes import cushion, rounded_box

SOFT, FRAME = 1, 2  # segments


@dataclass(frozen=True)
class Plan:
    """The numbers that the parts share, in m.

    y runs over the seats from −width/2 to width/2; the seat's front is x = depth/2.
    """

    seats: int
    width: float  # between the arms
    depth: float
    height: float  # of the seat
    back: float  # height of the back's top
    low: float  # underside of the base
    lean: float  # the back's, radians
    thick: float  # the back's


def base(a: Assembly, p: Plan) -> None:
    """Add the upholstered base."""
    high = p.height - 0.13
    box = rounded_box([p.depth + p.thick, p.width + 0.04, high - p.low], 0.03, edge=3, inner=6)
    a.add("base", box.moved(-p.thick / 2, 0, (high + p.low) / 2), SOFT)


def back_body(a: Assembly, rng: np.random.Generator, p: Plan, kind: str) -> None:
    """Add the upholstered back: straight on top, a camel's hump, or round-shouldered."""
    tall = p.back - p.low - 0.02
    inner = 4 + 4 * p.seats
    body = rounded_box(
        [p.thick, p.width + 0.1, tall], rng.uniform(0.25, 0.46) * p.thick, (0.06, 0, 0), 4, inner
    )
    v = body.vertices.copy()
    share = np.clip(v[:, 2] / tall + 0.5, 0, 1)
    across = 2 * v[:, 1] / p.width
    if kind == "camel":
        v[:, 2] += share**2 * (0.13 * np.cos(np.clip(across, -1, 1) * np.pi / 2) ** 2 - 0.03)
    elif kind == "round":
        v[:, 2] -= share**2 * 0.22 * np.clip(np.abs(across) - 0.55, 0, None) ** 2 / 0.2
    a.add(
        "back",
        close_surface(v, body.faces)
        .turned("y", -p.lean)
        .moved(-p.depth / 2 - p.thick / 2 - p.lean * tall * 0.4, 0, (p.back + p.low) / 2),
        SOFT,
    )


def arms(a: Assembly, rng: np.random.Generator, p: Plan, kind: str, chaise: int = 0) -> float:
    """Add two arms, or one beside a chaise; return the half width over arms and seats."""
    thick = {
        "box": rng.uniform(0.1, 0.26),
        "roll": rng.uniform(0.13, 0.2),
        "pad": rng.uniform(0.16, 0.3),
        "none": 0.0,
    }.get(kind, rng.uniform(0.1, 0.17))
    high = p.height + rng.uniform(0.12, 0.26)
    x_front, x_rear = p.depth / 2 + rng.uniform(-0.03, 0.04), -p.depth / 2 - p.thick
    for side in LEFT_RIGHT if kind != "none" else ():
        if side == chaise:
            continue
        y = side * (p.width / 2 + thick / 2)
        middle, length = (x_front + x_rear) / 2, x_front - x_rear
        if kind == "box":
            box = rounded_box(
                [length, thick, high - p.low], min(0.3 * thick, 0.05), edge=3, inner=5
            )
            a.add("arm", box.moved(middle, y, (high + p.low) / 2), SOFT)
        elif kind == "roll":
            a.add(
                "arm",
                rounded_box(
                    [length, thick * 0.72, high - p.low - 0.02], 0.03, edge=3, inner=5
                ).moved(middle, y, (high + p.low) / 2 - 0.02),
                SOFT,
            )
            rear, front = ([x, y + side * 0.02, high - 0.03] for x in (x_rear, x_front))
            a.add("arm roll", rod(rear, front, thick * 0.62, around=24, bevel=0.25), SOFT)
        elif kind == "pad":
            a.add(
                "arm",
                cushion([length, thick, high - p.low - 0.02], 0.12, 7).moved(
                    middle, y, (high + p.low) / 2
                ),
                SOFT,
            )
        else:
            rise, lean = (
                (p.back - high) * (0.85 if kind == "slope" else 0.0),
                (0.07 if kind == "flare" else 0.0),
            )
            path = smooth_path(
                [[x_front, y, high], [middle, y, high + 0.25 * rise], [x_rear, y, high + rise]], 9
            )
            half = np.stack([np.full(9, thick / 2), (path[:, 2] - p.low) / 2], 1)
            path[:, 2] = (path[:, 2] + p.low) / 2
            arm = tube(path, half, around=32, square=6.0, bevel=0.3)
            v = arm.vertices.copy()
            v[:, 1] += side * lean * ((v[:, 2] - p.low) / (high - p.low)) ** 2
            a.add("arm", close_surface(v, arm.faces), SOFT)
    return p.width / 2 + thick


def chaise_longue(a: Assembly, rng: np.random.Generator, p: Plan, side: int) -> None:
    """Add a seat at one end that extends to the front."""
    reach, wide = rng.uniform(0.5, 0.85), p.width / p.seats
    y, high = side * (p.width / 2 - wide / 2 + 0.02), p.height - 0.13
    a.add(
        "chaise",
        rounded_box([reach + 0.1, wide, high - p.low], 0.03, edge=3, inner=5).moved(
            p.depth / 2 + reach / 2 - 0.05, y, (high + p.low) / 2
        ),
        SOFT,
    )
    top = cushion([reach + 0.05, wide, 0.16], rng.uniform(0.08, 0.25), 7)
    a.add("chaise cushion", top.moved(p.depth / 2 + reach / 2 + 0.02, y, p.height - 0.075), SOFT)
    for s in LEFT_RIGHT:
        x = p.depth / 2 + reach - 0.08
        a.add(
            "foot",
            rod(
                [x, y + s * (wide / 2 - 0.08), p.low + 0.02],
                [x, y + s * (wide / 2 - 0.08), 0],
                0.025,
                0.018,
                square=4.0,
            ),
            FRAME,
        )


def seat_cushions(a: Assembly, rng: np.random.Generator, p: Plan, count: int) -> None:
    """Add one long seat cushion, or one per seat."""
    high, puff, over = rng.uniform(0.14, 0.2), rng.uniform(0.06, 0.32), rng.uniform(0.0, 0.05)
    each = p.width / count
    for k in range(count):
        y = -p.width / 2 + (k + 0.5) * each
        seat = cushion([p.depth + over, each - 0.006, high], puff, 8 if count > 1 else 12)
        a.add("seat cushion", seat.moved(over / 2 + 0.01, y, p.height - high / 2 + 0.01), SOFT)


def back_cushions(a: Assembly, rng: np.random.Generator, p: Plan, kind: str, count: int) -> None:
    """Add cushions that lean on the back."""
    if kind == "none":
        return
    tall = p.back - p.height - (0.03 if kind == "box" else -0.05)
    thick = rng.uniform(0.12, 0.2)
    if kind == "lumbar":
        tall, count = tall * 0.5, 1
    each = p.width / count
    for k in range(count):
        y = -p.width / 2 + (k + 0.5) * each
        pad = cushion(
            [thick, each - 0.012, tall], 0.22 if kind == "box" else 0.5, 8 if count > 1 else 12
        ).turned("y", -p.lean - 0.03)
        if kind == "soft":
            pad = pad.turned("x", rng.uniform(-0.03, 0.03))
        x = -p.depth / 2 + thick / 2 - 0.01 - p.lean * tall * 0.35
        a.add(
            "back cushion",
            pad.moved(x, y, p.height + tall / 2 + (0.04 if kind == "lumbar" else 0.0)),
            SOFT,
        )


def throw_pillows(a: Assembly, rng: np.random.Generator, p: Plan) -> None:
    """Add none to three loose pillows."""
    count = min(int(rng.choice([0, 0, 1, 2, 3])), p.seats)
    for k in range(count):
        size = rng.uniform(0.36, 0.46)
        pillow = (
            ellipsoid([0.16, size, size * rng.choice([1.0, 0.7])], 3.2, 20)
            .turned("y", -rng.uniform(0.25, 0.45))
            .turned("z", rng.uniform(-0.3, 0.3))
        )
        y = ((k + rng.uniform(0.2, 0.8)) / count * 2 - 1) * (p.width / 2 - size / 2)
        a.add("pillow", pillow.moved(-p.depth / 2 + 0.27, y, p.height + size * 0.42), SOFT)


def feet(a: Assembly, rng: np.random.Generator, p: Plan, half: float, kind: str) -> None:
    """Add cones, blocks, turned bulbs, sled runners, or a skirt to the floor."""
    x_front, x_rear = p.depth / 2 - 0.06, -p.depth / 2 - p.thick + 0.08
    if kind == "skirt" or p.low < 0.06:
        a.add(
            "plinth",
            rounded_box(
                [x_front - x_rear + 0.06, 2 * half - 0.08, p.low + 0.04], 0.01, edge=2
            ).moved((x_front + x_rear) / 2, 0, p.low / 2 + 0.02),
            FRAME,
        )
        return
    size = rng.uniform(0.02, 0.035)
    places = [
        (x, side * (min(half, p.width / 2 + 0.05) - 0.07), side)
        for x in (x_front, x_rear)
        for side in LEFT_RIGHT
    ] + ([(x_front, 0.0, 0), (x_rear, 0.0, 0)] if p.seats > 2 else [])
    if kind == "sled":
        for side in LEFT_RIGHT:
            y = side * (half - 0.1)
            path = rounded_path(
                [
                    [x_front, y, p.low + 0.03],
                    [x_front, y, 0.012],
                    [x_rear, y, 0.012],
                    [x_rear, y, p.low + 0.03],
                ],
                0.03,
            )
            a.add("runner", tube(path, np.array([0.025, 0.01]), around=16, square=6.0), FRAME)
        return
    for x, y, side in places:
        if kind == "turned":
            z = np.linspace(p.low + 0.02, 0, 16)
            t = np.linspace(0, 1, 16)
            a.add(
                "foot",
                tube(
                    np.stack([0 * z + x, 0 * z + y, z], 1),
                    size * (0.7 + 0.7 * np.sin(np.pi * t**1.5) ** 2),
                    around=16,
                ),
                FRAME,
            )
        else:
            splay = 0.03 if kind == "cone" else 0.0
            out = np.sign(x) * splay
            a.add(
                "foot",
                rod(
                    [x, y, p.low + 0.03],
                    [x + out, y + side * splay, 0],
                    size,
                    size * (0.5 if kind == "cone" else 1.0),
                    square=2.0 if kind == "cone" else 7.0,
                ),
                FRAME,
            )
