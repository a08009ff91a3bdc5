"""Sofas: upholstered, on a frame, curved or with a chaise; one to four seats.

Segments: 1 upholstery; 2 feet and frame. Sizes are those of real sofas, in metres: a seat 0.55–0.80
wide, 0.50–0.65 deep, 0.38–0.46 high, the back to 0.68–1.0.
"""

from dataclasses import replace

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import rounded_path, smooth_path
from factory.shapes.lofts import ellipsoid, rod, tube
from factory.shapes.mesh import Mesh
from factory.shapes.rounded_boxes import rounded_box
from factory.shapes.sofa_parts import (
    FRAME,
    SOFT,
    Plan,
    arms,
    back_body,
    back_cushions,
    base,
    chaise_longue,
    feet,
    seat_cushions,
    throw_pillows,
)

FAMILY_KEY = 3


def build(seed: int) -> Mesh:
    """Return the sofa of a seed, a Mesh of category "sofa"."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAMILY_KEY,)))
    style = ("upholstered", "framed", "chesterfield", "curved")[
        int(rng.choice(4, p=[0.56, 0.18, 0.12, 0.14]))
    ]
    seats = int(rng.choice([1, 2, 3, 4], p=[0.12, 0.36, 0.42, 0.10]))
    if style == "curved":
        seats = max(seats, 2)
    plan = Plan(
        seats=seats,
        width=seats * rng.uniform(0.56, 0.76),
        depth=rng.uniform(0.54, 0.68),
        height=rng.uniform(0.38, 0.46),
        back=rng.uniform(0.70, 0.98),
        low=rng.uniform(0.04, 0.17),
        lean=rng.uniform(0.05, 0.24),
        thick=rng.uniform(0.11, 0.2),
    )
    a = Assembly()
    {"upholstered": upholstered, "framed": framed, "chesterfield": chesterfield, "curved": curved}[
        style
    ](a, rng, plan)
    return a.finish(f"sofa:{seed}", "sofa")


def upholstered(a: Assembly, rng: np.random.Generator, p: Plan) -> None:
    """Add base, back, arms, cushions and feet; some have a chaise on one side."""
    chaise = rng.choice([-1, 1]) if p.seats >= 2 and rng.random() < 0.3 else 0
    base(a, p)
    back_body(a, rng, p, rng.choice(["flat", "flat", "camel", "round"]))
    kind = rng.choice(
        ["box", "roll", "slope", "pad", "none", "flare"], p=[0.28, 0.2, 0.16, 0.16, 0.06, 0.14]
    )
    wide = arms(a, rng, p, kind, chaise)
    if chaise:
        chaise_longue(a, rng, p, chaise)
    seat_cushions(a, rng, p, int(rng.choice([1, p.seats])))
    back_cushions(
        a, rng, p, rng.choice(["box", "soft", "lumbar", "none"], p=[0.4, 0.3, 0.15, 0.15]), p.seats
    )
    throw_pillows(a, rng, p)
    feet(a, rng, p, wide, rng.choice(["cone", "block", "skirt", "sled", "turned"]))


def framed(a: Assembly, rng: np.random.Generator, p: Plan) -> None:
    """Add loose cushions in a frame of wood or steel tube."""
    steel, half = rng.random() < 0.45, p.width / 2 + 0.03
    size, square = (
        (rng.uniform(0.012, 0.02), 2.0)
        if steel
        else (rng.uniform(0.018, 0.028), rng.choice([3.0, 6.0]))
    )
    high, rear, x = p.height + rng.uniform(0.16, 0.24), -p.depth / 2 - 0.1, p.depth / 2
    seat_cushions(a, rng, p, p.seats)
    back_cushions(a, rng, p, "box", p.seats)
    under = p.height - 0.17
    a.add(
        "deck",
        rounded_box([p.depth + 0.08, p.width, 0.035], 0.012, edge=2, inner=3).moved(
            -0.04, 0, under
        ),
        FRAME,
    )
    for side in LEFT_RIGHT:
        y = side * half
        if steel:
            path = rounded_path(
                [[rear, y, size], [x, y, size], [x, y, high], [rear, y, high], [rear, y, size]],
                0.07,
                6,
            )[:-1]
            a.add("frame", tube(path, size, around=12, ring=True), FRAME)
        else:
            splay = rng.uniform(0.0, 0.08)
            a.add(
                "leg",
                rod(
                    [x - 0.02, y, high],
                    [x + splay, y, 0],
                    [size, size * 1.4],
                    size * 0.8,
                    square=square,
                ),
                FRAME,
            )
            a.add(
                "leg",
                rod(
                    [rear + 0.03, y, high + 0.02],
                    [rear - splay, y, 0],
                    [size, size * 1.4],
                    size * 0.8,
                    square=square,
                ),
                FRAME,
            )
            arm = smooth_path(
                [[rear, y, high + 0.02], [0, y, high + 0.01], [x + 0.03, y, high - 0.005]], 12
            )
            a.add(
                "arm",
                tube(arm, np.array([size * 2, size * 0.7]), around=16, square=4.0, bevel=0.9),
                FRAME,
            )
            a.add("rail", rod([x, y, under], [rear, y, under], size), FRAME)
    for at, z in ((x - 0.03, under), (rear + 0.02, under)):
        a.add("rail", rod([at, -half, z], [at, half, z], size * 0.8, square=square), FRAME)
    top, lean = p.back - 0.06, p.lean * (p.back - p.height)
    for z in np.linspace(p.height + 0.1, top, int(rng.integers(2, 5))):
        at = rear - lean * (z - p.height) / (top - p.height)
        a.add(
            "back rail",
            rod(
                [at, -half, z], [at, half, z], [size, size * (0.7 if steel else 1.3)], square=square
            ),
            FRAME,
        )
    for y in np.linspace(-half, half, p.seats + 1):
        a.add(
            "back post",
            rod([rear + 0.02, y, under], [rear - lean, y, top + 0.02], size * 0.8, square=square),
            FRAME,
        )
    throw_pillows(a, rng, p)


def chesterfield(a: Assembly, rng: np.random.Generator, p: Plan) -> None:
    """Add rolled arms as high as the back, buttons on the back, and turned feet."""
    back = p.height + rng.uniform(0.28, 0.36)
    p = replace(p, back=back, low=max(p.low, 0.08), lean=0.1, thick=0.16)
    base(a, p)
    seat_cushions(a, rng, p, int(rng.choice([1, p.seats])))
    back_body(a, rng, p, "flat")
    roll, top = rng.uniform(0.075, 0.1), p.back - 0.02
    rear = -p.depth / 2 - p.thick - 0.03
    half, x = p.width / 2 + 0.09, p.depth / 2
    path = rounded_path(
        [[x, -half, top], [rear, -half, top], [rear, half, top], [x, half, top]], 0.16, 8
    )
    path = np.concatenate(
        [
            np.linspace(path[0], path[1], 6)[:-1],
            path[1:9],
            np.linspace(path[9], path[-9], 9)[:-1],
            path[-9:-1],
            np.linspace(path[-2], path[-1], 6),
        ]
    )
    a.add(
        "roll",
        tube(
            path[np.append(True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-6)],
            roll,
            around=22,
            bevel=0.3,
            side=(0, 0, 1.0),
        ),
        SOFT,
    )
    for side in LEFT_RIGHT:
        box = rounded_box([p.depth + p.thick, 0.13, top - p.low], 0.04, edge=3, inner=5)
        a.add(
            "arm",
            box.moved(-p.thick / 2 - 0.01, side * (p.width / 2 + 0.065), (top + p.low) / 2),
            SOFT,
        )
    rows, columns = 2, 4 * p.seats
    for r in range(rows):
        for k in range(columns - r % 2):
            y = -p.width / 2 + (k + 0.5 + 0.5 * (r % 2)) * p.width / columns
            z = p.height + (0.1 + 0.55 * r / rows) * (top - p.height)
            at = -p.depth / 2 - p.lean * (z - (p.back + p.low) / 2 + 0.4 * (p.back - p.low)) + 0.012
            a.add("button", ellipsoid([0.03, 0.035, 0.035], 2.0, 8).moved(at, y, z), SOFT)
    feet(a, rng, p, half, "turned")


def curved(a: Assembly, rng: np.random.Generator, p: Plan) -> None:
    """Add an upholstered sofa bent so that its ends come forward."""
    base(a, p)
    back_body(a, rng, p, rng.choice(["flat", "round"]))
    arms(a, rng, p, kind := rng.choice(["none", "pad", "flare"]))
    seat_cushions(a, rng, p, int(rng.choice([1, p.seats])))
    back_cushions(a, rng, p, rng.choice(["box", "none"]), p.seats)
    feet(a, rng, p, p.width / 2 + (0.0 if kind == "none" else 0.08), "cone")
    a.bend(rng.uniform(0.6, 1.4) / p.width)
