"""Parts of chairs: legs, bases, backs and arms, each added to an Assembly.

Metres; the seat faces +x, the back stands at −x.

w, d  the seat's width (y) and depth (x)
h     the height of its top
at    a function (height, y share) → point on the back's middle surface

Segment SOFT is seat, back and cushions, FRAME the construction that carries them.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT, Surface
from factory.shapes.curves import rounded_path, smooth_path, superellipse
from factory.shapes.lofts import revolve, rod, slab, tube

SOFT, FRAME = 1, 2
BackPoint: TypeAlias = Callable[[float, float], np.ndarray]
Ends: TypeAlias = dict[tuple[int, float], tuple[np.ndarray, np.ndarray]]


def seat_outline(w: float, d: float, rear: float, square: float, around: int = 48) -> np.ndarray:
    """Return the outline (N, 2) of a seat seen from above.

    It is a superellipse whose rear is narrowed to the share `rear` of its front.
    """
    x, y = superellipse(around, square).T
    return np.stack([x * d / 2, y * w / 2 * (1 + rear + (1 - rear) * x) / 2], 1)


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


def apron(a: Assembly, w: float, d: float, h: float, rear: float, inset: float = 0.045) -> None:
    """Add the four boards under a wooden seat."""
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


def posts(
    a: Assembly,
    rng: np.random.Generator,
    w: float,
    d: float,
    h: float,
    rear: float,
    top: float,
    lean: float,
    square: float = 5.0,
) -> BackPoint:
    """Add two rear posts that extend upwards from the seat; return `at` of their back."""
    size, curve = rng.uniform(0.014, 0.021), rng.uniform(-0.02, 0.05)

    def at(z, share):
        t = (z - h) / (top - h)
        return np.array(
            [
                -d / 2 + 0.025 - lean * t - curve * np.sin(np.pi * np.clip(t, 0, 1)),
                share * (w * rear / 2 - 0.025) * (1 + 0.04 * t),
                z,
            ]
        )

    for side in LEFT_RIGHT:
        path = np.array([at(z, side) for z in np.linspace(h - 0.04, top, 12)])
        a.add(
            "post",
            tube(
                path, np.linspace(size * 1.1, size * 0.8, 12), around=14, square=square, bevel=0.8
            ),
            FRAME,
        )
    return at


def between(
    a: Assembly,
    part: str,
    at: BackPoint,
    low: float,
    high: float,
    thick: float,
    share: float = 1.0,
    bow: float = 0.02,
    segment: int = SOFT,
    crown: float = 0.0,
) -> None:
    """Add a board across the back from height low to high (m).

    It is bowed backwards by `bow`, and its upper rim is raised in the middle by `crown`.
    """
    y = np.linspace(-share, share, 17)
    middle = np.array([at((low + high) / 2, s) for s in y])
    middle[:, 0] -= bow * (1 - (y / share) ** 2)
    rise = crown * np.cos(y / share * np.pi / 2) ** 2
    middle[:, 2] += rise / 2
    half = np.stack([np.full(17, thick / 2), (high - low) / 2 + rise / 2], 1)
    tilt = at(high, 0) - at(low, 0)
    side = np.array([tilt[2], 0, -tilt[0]]) / np.hypot(tilt[0], tilt[2])
    a.add(part, tube(middle, half, around=24, square=6.0, bevel=0.3, side=side), segment)


def upright_bars(
    a: Assembly,
    part: str,
    at: BackPoint,
    low: float,
    high: float,
    count: int,
    size: ArrayLike,
    share: float,
    fan: float = 1.0,
    segment: int = SOFT,
    square: float = 2.0,
) -> None:
    """Add `count` bars from the seat (height low) to the top rail (high).

    fan  how much wider they stand at the top
    """
    for s in np.linspace(-share, share, count):
        path = np.array(
            [
                at(z, s * (1 + (fan - 1) * t))
                for t, z in zip(np.linspace(0, 1, 9), np.linspace(low, high, 9), strict=True)
            ]
        )
        a.add(part, tube(path, size, around=10, square=square), segment)


def arm_rests(
    a: Assembly, rng: np.random.Generator, w: float, d: float, h: float, back_x: float
) -> None:
    """Add wooden arms on front posts."""
    rise, size = rng.uniform(0.19, 0.26), rng.uniform(0.012, 0.02)
    reach, wide = d / 2 - rng.uniform(0.03, 0.1), w / 2 + rng.uniform(-0.015, 0.02)
    for side in LEFT_RIGHT:
        y = side * wide
        drop = rng.uniform(0.0, 0.03)
        path = smooth_path(
            [
                [back_x, y * 0.97, h + rise + drop],
                [0, y * 1.03, h + rise],
                [reach + 0.03, y * 1.02, h + rise - drop],
            ],
            12,
        )
        a.add(
            "arm",
            tube(path, np.array([size * 1.7, size * 0.75]), around=16, square=3.5, bevel=0.9),
            FRAME,
        )
        a.add(
            "arm post",
            rod(
                [reach - 0.02, side * (w / 2 - 0.03), h - 0.03],
                [reach, y, h + rise],
                size,
                size * 0.8,
                around=12,
                square=3.0,
            ),
            FRAME,
        )


def soft_pad(
    w: float, d: float, thick: float, rear: float = 1.0, square: float = 4.5, dome: float = 0.02
) -> Surface:
    """Return an upholstered seat, its middle raised."""
    return slab(seat_outline(w, d, rear, square), thick, 0.95, dome, steps=5)


def hoop_path(
    at: BackPoint, low: float, high: float, share: float, count: int = 33, power: float = 0.6
) -> np.ndarray:
    """Return a bow (count, 3) from one side of the seat over the top to the other side."""
    angle = np.linspace(0, np.pi, count)
    rise = np.sin(angle) ** power
    side = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.8
    return np.array(
        [at(low + (high - low) * r, share * s) for r, s in zip(rise, side, strict=True)]
    )
