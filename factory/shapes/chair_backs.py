"""Backs and arms of chairs, each added to an Assembly.

Metres; the seat faces +x, the back stands at −x.

w, d  the seat's width (y) and depth (x)
h     the height of its top
at    a function (height, y share) → point on the back's middle surface
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from factory.shapes.assembly import Assembly
from factory.shapes.chair_seats import FRAME, SOFT
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import smooth_path
from factory.shapes.lofts import rod, tube

BackPoint: TypeAlias = Callable[[float, float], np.ndarray]


def posts(
    a: Assembly,
    rng: np.random.Generator,
    w: float,
    d: float,
    h: float,
    rear: float,
    top: float,
    lean: float,
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
            tube(path, np.linspace(size * 1.1, size * 0.8, 12), around=14, square=5.0, bevel=0.8),
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
    square: float = 2.0,
) -> None:
    """Add `count` bars from the seat (height low) to the top rail (high)."""
    for s in np.linspace(-share, share, count):
        path = np.array([at(z, s) for z in np.linspace(low, high, 9)])
        a.add(part, tube(path, size, around=10, square=square), SOFT)


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
