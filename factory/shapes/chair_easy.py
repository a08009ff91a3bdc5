"""The upholstered easy chair, one of the styles of factory.shapes.chair.

w, d  the seat's width (y) and depth (x), m
h     the height of its top
"""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.chair_seats import FRAME, SOFT
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import smooth_path
from factory.shapes.lofts import rod, tube
from factory.shapes.rounded_boxes import cushion, rounded_box


def armchair(a: Assembly, rng: np.random.Generator) -> None:
    """Add an upholstered easy chair: club, tub or wing."""
    w, d, h = rng.uniform(0.52, 0.64), rng.uniform(0.5, 0.6), rng.uniform(0.38, 0.45)
    top, thick, arm_high = (
        h + rng.uniform(0.36, 0.66),
        rng.uniform(0.09, 0.17),
        rng.uniform(0.14, 0.24),
    )
    low = rng.uniform(0.1, 0.17)
    lean = rng.uniform(0.05, 0.16)
    a.add(
        "base",
        rounded_box([d + 0.05, w + thick, h - 0.12 - low + 0.04], 0.03, edge=3, inner=4).moved(
            -0.02, 0, (h - 0.12 + low) / 2
        ),
        SOFT,
    )
    a.add(
        "seat cushion",
        cushion([d + 0.02, w - 0.01, 0.16], rng.uniform(0.1, 0.35), 8).moved(0.03, 0, h - 0.06),
        SOFT,
    )
    tall = top - low
    back = rounded_box(
        [0.15, w + thick * 1.2, tall],
        rng.uniform(0.04, 0.07),
        (0.12, 0.0, rng.uniform(0, 0.08)),
        4,
        8,
    )
    a.add(
        "back",
        back.turned("y", -lean).moved(-d / 2 - 0.05 - lean * tall * 0.3, 0, (top + low) / 2),
        SOFT,
    )
    if rng.random() < 0.6:
        a.add(
            "back cushion",
            cushion([0.13, w - 0.03, top - h - 0.08], 0.3, 8)
            .turned("y", -lean)
            .moved(-d / 2 + 0.06 - lean * 0.2, 0, (top + h) / 2),
            SOFT,
        )
    _add_arms(a, rng, w, d, h, thick, arm_high, low)
    if top - h > 0.5 and rng.random() < 0.7:
        _add_wings(a, w, d, h, arm_high, top, lean)
    _add_legs(a, rng, w, d, low)


def _add_arms(
    a: Assembly,
    rng: np.random.Generator,
    w: float,
    d: float,
    h: float,
    thick: float,
    arm_high: float,
    low: float,
) -> None:
    """Add two arms: boxes, boxes with a roll on top, or arms that slope up to the back.

    thick     width of an arm
    arm_high  its height above the seat
    low       height of the base's lower side
    """
    kind = rng.choice(["box", "roll", "slope"])
    for s in LEFT_RIGHT:
        y = s * (w / 2 + thick / 2)
        if kind == "roll":
            a.add(
                "arm",
                rounded_box(
                    [d + 0.08, thick * 0.75, h + arm_high - low - 0.03], 0.025, edge=3, inner=4
                ).moved(0, y, (h + arm_high + low) / 2 - 0.03),
                SOFT,
            )
            a.add(
                "arm roll",
                rod(
                    [-d / 2 - 0.05, y, h + arm_high - 0.03],
                    [d / 2 + 0.05, y, h + arm_high - 0.03],
                    thick * 0.62,
                    around=20,
                    bevel=0.3,
                ),
                SOFT,
            )
        else:
            path = smooth_path(
                [
                    [d / 2 + 0.03, y, h + arm_high],
                    [0, y, h + arm_high + 0.01],
                    [-d / 2 - 0.06, y, h + arm_high + (0.16 if kind == "slope" else 0.01)],
                ],
                9,
            )
            half = np.stack([np.full(9, thick / 2), (path[:, 2] - low) / 2], 1)
            path[:, 2] = (path[:, 2] + low) / 2
            a.add("arm", tube(path, half, around=28, square=rng.uniform(4, 7), bevel=0.35), SOFT)


def _add_wings(
    a: Assembly, w: float, d: float, h: float, arm_high: float, top: float, lean: float
) -> None:
    """Add a wing on each side of the back, above the arms; top: the back's height."""
    for s in LEFT_RIGHT:
        a.add(
            "wing",
            rounded_box([0.24, 0.07, top - h - arm_high + 0.05], 0.034, (0, 0.3, 0), 4, 5)
            .turned("y", -lean)
            .moved(-d / 2 + 0.05 - lean * 0.3, s * (w / 2 + 0.04), (top + h + arm_high) / 2 - 0.01),
            SOFT,
        )


def _add_legs(a: Assembly, rng: np.random.Generator, w: float, d: float, low: float) -> None:
    """Add four short legs, splayed and tapered."""
    size = rng.uniform(0.018, 0.03)
    square = rng.choice([2.0, 6.0])
    for front in (1, -1):
        for s in LEFT_RIGHT:
            x, y = front * (d / 2 - 0.04), s * (w / 2)
            a.add(
                "leg",
                rod(
                    [x, y, low + 0.03],
                    [x + front * 0.03, y + s * 0.02, 0],
                    size,
                    size * 0.6,
                    square=square,
                ),
                FRAME,
            )
