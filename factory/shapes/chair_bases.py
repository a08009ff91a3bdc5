"""What carries a chair's seat: legs with stretchers and aprons, stars, pedestals, sleds.

Each is added to an Assembly. Metres; the seat faces +x.

w, d  the seat's width (y) and depth (x)
h     the height of its top
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.chair_seats import FRAME
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import rounded_path, smooth_path
from factory.shapes.lofts import revolve, rod, tube

Ends: TypeAlias = dict[tuple[int, float], tuple[np.ndarray, np.ndarray]]


def four_legs(
    a: Assembly,
    rng: np.random.Generator,
    w: float,
    d: float,
    h: float,
    rear: float = 1.0,
    kinds: Sequence[str] = ("square", "round", "tapered", "turned"),
) -> Ends:
    """Add four legs at the corners; return their tops and feet.

    kinds    to draw from
    Returns  {(±1 front, ±1 left): (top, foot)}
    """
    kind = rng.choice(kinds)
    size, splay, inset = rng.uniform(0.015, 0.025), rng.uniform(0.0, 0.07), rng.uniform(0.03, 0.05)
    if kind == "turned":
        splay += 0.03
    ends = {}
    for front in (1, -1):
        for left in LEFT_RIGHT:
            half = (w if front > 0 else w * rear) / 2 - inset
            top = np.array([front * (d / 2 - inset), left * half, h - 0.02])
            foot = np.array([top[0] + front * splay, top[1] + left * splay * 0.8, 0.0])
            ends[front, left] = top, foot
            if kind == "turned":
                t = np.linspace(0, 1, 25)
                girth = size * (
                    0.75
                    + 0.35 * np.sin(np.pi * t) ** 2
                    + 0.22 * np.sin(6 * np.pi * t) * np.sin(np.pi * t)
                )
                a.add("leg", tube(top + t[:, None] * (foot - top), girth, around=14), FRAME)
            else:
                square = {"square": 7.0, "round": 2.0, "tapered": rng.choice([2.0, 5.0])}[kind]
                narrow = size * (0.55 if kind == "tapered" else 0.95)
                a.add("leg", rod(top, foot, size * 1.15, narrow, around=16, square=square), FRAME)
    return ends


def stretchers(a: Assembly, rng: np.random.Generator, ends: Ends) -> None:
    """Add rails between the legs: none, a box, an H, or two at the sides."""
    kind, t, size = (
        rng.choice(["none", "box", "h", "sides"]),
        rng.uniform(0.45, 0.75),
        rng.uniform(0.007, 0.011),
    )
    at = {key: top + t * (foot - top) for key, (top, foot) in ends.items()}
    if kind == "none":
        return
    for side in LEFT_RIGHT:
        a.add("stretcher", rod(at[1, side], at[-1, side], size, around=10, square=3.0), FRAME)
    if kind == "h":
        left, right = ((at[1, side] + at[-1, side]) / 2 for side in LEFT_RIGHT)
        a.add("stretcher", rod(left, right, size, around=10, square=3.0), FRAME)
    if kind == "box":
        for front in (1, -1):
            rise = np.array([0, 0, 0.04])
            a.add(
                "stretcher",
                rod(at[front, 1] + rise, at[front, -1] + rise, size, around=10, square=3.0),
                FRAME,
            )


def apron(a: Assembly, w: float, d: float, h: float, rear: float) -> None:
    """Add the four boards under a wooden seat."""
    inset = 0.045
    corner = {
        (f, s): np.array(
            [f * (d / 2 - inset), s * ((w if f > 0 else w * rear) / 2 - inset), h - 0.055]
        )
        for f in (1, -1)
        for s in LEFT_RIGHT
    }
    for one, other in (
        ((1, 1), (1, -1)),
        ((-1, 1), (-1, -1)),
        ((1, 1), (-1, 1)),
        ((1, -1), (-1, -1)),
    ):
        a.add(
            "apron",
            rod(
                corner[one],
                corner[other],
                (0.009, 0.028),
                around=16,
                square=8.0,
                side=np.cross(corner[other] - corner[one], [0, 0, 1.0]),
            ),
            FRAME,
        )


def star_base(a: Assembly, rng: np.random.Generator, h: float) -> None:
    """Add a gas column on a five-legged (or four-legged) star, with castors or glides."""
    arms, reach = int(rng.choice([4, 5, 5, 5])), rng.uniform(0.27, 0.34)
    wheel = rng.uniform(0.022, 0.03) if rng.random() < 0.8 else 0.0
    hub = 2 * wheel + rng.uniform(0.04, 0.09)
    a.add(
        "column",
        revolve(
            [
                [0, hub - 0.03],
                [0.035, hub - 0.03],
                [0.03, hub + 0.06],
                [0.024, hub + 0.08],
                [0.024, h * 0.65],
                [0.015, h * 0.66],
                [0.015, h - 0.03],
                [0, h - 0.03],
            ],
            20,
        ),
        FRAME,
    )
    for angle in np.arange(arms) * 2 * np.pi / arms + rng.uniform(0, 1):
        path = smooth_path(
            [[0.01, 0, hub], [reach * 0.5, 0, hub - 0.012], [reach, 0, 2 * wheel + 0.014]], 8
        )
        a.add(
            "star",
            tube(path, np.linspace([0.026, 0.02], [0.015, 0.011], 8), around=12, square=3.5).turned(
                "z", angle
            ),
            FRAME,
        )
        if wheel:
            for side in LEFT_RIGHT:
                turn = revolve(
                    [
                        [0, -0.008],
                        [wheel * 0.8, -0.009],
                        [wheel, -0.004],
                        [wheel, 0.004],
                        [wheel * 0.8, 0.009],
                        [0, 0.008],
                    ],
                    16,
                ).turned("x", np.pi / 2)
                a.add("castor", turn.moved(reach, side * 0.014, wheel).turned("z", angle), FRAME)


def trumpet_base(a: Assembly, rng: np.random.Generator, h: float) -> None:
    """Add a tulip chair's foot: a disc that narrows to a stem and widens under the seat."""
    foot, stem, top = rng.uniform(0.2, 0.27), rng.uniform(0.022, 0.04), rng.uniform(0.06, 0.12)
    t = np.linspace(0, 1, 28)
    radius = (
        stem + (foot - stem) * (1 - t) ** rng.uniform(5, 9) + (top - stem) * t ** rng.uniform(5, 9)
    )
    a.add(
        "pedestal",
        revolve(
            np.concatenate(
                [
                    [[0, 0], [foot, 0]],
                    np.stack([radius, 0.012 + (h - 0.03) * t], 1),
                    [[0, h - 0.015]],
                ]
            ),
            40,
        ),
        FRAME,
    )


def sled(a: Assembly, rng: np.random.Generator, w: float, d: float, h: float) -> None:
    """Add two bent-tube runners with a cross bar."""
    size, lean = rng.uniform(0.008, 0.012), rng.uniform(0.0, 0.06)
    for side in LEFT_RIGHT:
        y = side * (w / 2 - 0.03)
        path = rounded_path(
            [
                [d * 0.3, y * 0.8, h],
                [d / 2 - 0.04 + lean, y, size],
                [-d / 2 + 0.02 - lean, y, size],
                [-d * 0.3, y * 0.8, h],
            ],
            0.06,
        )
        a.add("sled", tube(path, size, around=10), FRAME)
    for x in (d * 0.3, -d * 0.3):
        a.add(
            "cross bar",
            rod([x, -w * 0.4, h - 0.005], [x, w * 0.4, h - 0.005], size, around=10),
            FRAME,
        )
