"""Wooden chairs: dining, Windsor and bentwood, three of the styles of factory.shapes.chair."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.chair_backs import BackPoint, arm_rests, between, hoop_path, posts, upright_bars
from factory.shapes.chair_bases import apron, four_legs, stretchers
from factory.shapes.chair_seats import FRAME, SOFT, seat_outline, soft_pad
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import smooth_path
from factory.shapes.lofts import slab, tube


def dining(a: Assembly, rng: np.random.Generator) -> None:
    """Add a chair with four legs, posts, and a back of slats, rungs, a board, a splat or a pad."""
    w, d, h = rng.uniform(0.40, 0.50), rng.uniform(0.40, 0.47), rng.uniform(0.43, 0.47)
    rear, top, lean = rng.uniform(0.82, 1.0), h + rng.uniform(0.36, 0.62), rng.uniform(0.03, 0.12)
    stretchers(a, rng, four_legs(a, rng, w, d, h - 0.02, rear))
    apron(a, w, d, h, rear)
    if rng.random() < 0.5:
        seat = soft_pad(w, d, rng.uniform(0.045, 0.08), rear, rng.uniform(4, 8))
    else:
        outline = seat_outline(w + 0.02, d + 0.02, rear, rng.uniform(5, 9))
        seat = slab(outline, 0.028, 0.8, -0.008)
    a.add("seat", seat.moved(z=h), SOFT)
    at = posts(a, rng, w, d, h, rear, top, lean)
    kind = rng.choice(["slats", "ladder", "board", "splat", "pad", "spindles"])
    rail, bow = rng.uniform(0.05, 0.09), rng.uniform(0.005, 0.035)
    if kind in ("slats", "splat", "spindles"):
        _add_railed_back(a, rng, at, h, top, kind, rail, bow)
    elif kind == "ladder":
        _add_rungs(a, rng, at, h, top, bow)
    elif kind == "board":
        low, crown = h + rng.uniform(0.08, 0.2), rng.choice([0.0, 0.04])
        between(a, "back", at, low, top - 0.01, 0.016, 1.0, bow, SOFT, crown)
    else:
        low, crown = h + rng.uniform(0.03, 0.12), rng.choice([0.0, 0.03])
        between(a, "back pad", at, low, top - 0.015, 0.05, 0.97, bow, SOFT, crown)
    if rng.random() < 0.3:
        arm_rests(a, rng, w, d, h, at(h + 0.22, 1)[0])


def _add_railed_back(
    a: Assembly,
    rng: np.random.Generator,
    at: BackPoint,
    h: float,
    top: float,
    kind: str,
    rail: float,
    bow: float,
) -> None:
    """Add a rail at the top of a back, perhaps one below, and slats, spindles or a splat between.

    h, top  heights of the seat and of the back
    rail    height of the top rail itself
    bow     by which rails are bowed backwards
    """
    crown = rng.choice([0.0, 0.03, 0.05])
    between(a, "top rail", at, top - rail, top + 0.005, 0.022, 1.04, bow, FRAME, crown)
    low = h + rng.uniform(0.0, 0.12)
    if low > h + 0.04:
        between(a, "low rail", at, low - 0.02, low + 0.02, 0.018, 1.0, bow, FRAME)
    low, high = low - 0.02, top - rail / 2
    if kind == "slats":
        count = int(rng.integers(3, 8))
        size = np.array([0.26 / count, 0.006])
        upright_bars(a, "slat", at, low, high, count, size, 0.78, square=5.0)
    elif kind == "spindles":
        upright_bars(a, "spindle", at, low, high, int(rng.integers(5, 10)), 0.006, 0.8)
    else:
        t = np.linspace(0, 1, 15)
        girth = 0.05 + 0.03 * np.sin(2 * np.pi * t * rng.uniform(0.8, 1.5)) + 0.02 * t
        path = np.array([at(z, 0.0) - [bow * 0.7, 0, 0] for z in np.linspace(low, high, 15)])
        a.add("splat", tube(path, np.stack([girth, np.full(15, 0.006)], 1), 16, 4.0), SOFT)


def _add_rungs(
    a: Assembly, rng: np.random.Generator, at: BackPoint, h: float, top: float, bow: float
) -> None:
    """Add the rungs of a ladder back; heights and bow as of `_add_railed_back`."""
    count = int(rng.integers(2, 6))
    step = (top - h - 0.08) / count
    for k in range(count):
        low = h + 0.1 + k * step
        high = low + step * rng.uniform(0.45, 0.55)
        between(a, "rung", at, low, high, 0.014, 1.0, bow, SOFT, crown=0.012)


def windsor(a: Assembly, rng: np.random.Generator) -> None:
    """Add a chair with turned, splayed legs, a saddle seat, and a bow with spindles."""
    w, d, h = rng.uniform(0.42, 0.52), rng.uniform(0.40, 0.46), rng.uniform(0.42, 0.46)
    top, lean = h + rng.uniform(0.42, 0.66), rng.uniform(0.08, 0.16)
    stretchers(
        a, rng, four_legs(a, rng, w * 0.86, d * 0.86, h, 0.85, ("round", "tapered", "turned"))
    )
    a.add(
        "seat",
        slab(seat_outline(w, d, 0.85, rng.uniform(2.3, 3.2)), 0.04, 0.9, -0.012, steps=4).moved(
            z=h
        ),
        SOFT,
    )

    def at(z, share):
        t = (z - h) / (top - h)
        return np.array(
            [
                -d / 2 + 0.05 + 0.07 * share**2 - lean * t,
                share * (w / 2 - 0.05) * (0.9 + 0.2 * t),
                z,
            ]
        )

    count, share = int(rng.integers(5, 10)), rng.uniform(0.7, 0.85)
    if rng.random() < 0.6:
        power = rng.uniform(0.35, 0.6)
        a.add(
            "bow",
            tube(hoop_path(at, h, top, 0.98, power=power), rng.uniform(0.009, 0.013), around=10),
            FRAME,
        )
        for s in np.linspace(-share, share, count):
            high = h + (top - h) * (1 - abs(s / 0.98) ** 2.5) ** (power / 2) - 0.002
            path = np.array(
                [
                    at(z, s * (0.75 + 0.25 * (z - h) / (high - h)))
                    for z in np.linspace(h - 0.01, high, 7)
                ]
            )
            a.add("spindle", tube(path, 0.006, around=8), SOFT)
    else:
        upright_bars(a, "spindle", at, h - 0.01, top - 0.03, count, 0.0065, share)
        between(
            a,
            "comb",
            at,
            top - rng.uniform(0.06, 0.1),
            top,
            0.02,
            1.08,
            -0.065,
            SOFT,
            crown=rng.uniform(0, 0.04),
        )
    if rng.random() < 0.4:
        arm_rests(a, rng, w + 0.04, d, h, at(h + 0.22, 1)[0] + 0.02)


def bentwood(a: Assembly, rng: np.random.Generator) -> None:
    """Add Thonet's café chair: round seat, bent hoops, a ring between the legs."""
    w, h = rng.uniform(0.39, 0.44), rng.uniform(0.44, 0.47)
    top, lean, size = h + rng.uniform(0.38, 0.5), rng.uniform(0.06, 0.13), rng.uniform(0.011, 0.015)
    circle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    ring = np.stack([np.cos(circle), np.sin(circle), 0 * circle], 1)
    a.add(
        "seat ring",
        tube(
            ring * w / 2 + [0, 0, h], np.array([0.016, 0.02]), 12, 3.0, ring=True, side=(0, 0, 1.0)
        ),
        FRAME,
    )
    a.add(
        "seat",
        slab(ring[:, :2] * (w / 2 - 0.008), 0.022, 0.8, rng.uniform(-0.01, 0.02)).moved(z=h),
        SOFT,
    )
    low = rng.uniform(0.5, 0.62)
    if rng.random() < 0.8:
        a.add(
            "leg ring",
            tube(
                ring * w * 0.43 + [0, 0, h * (1 - low)], size * 0.7, 10, ring=True, side=(0, 0, 1.0)
            ),
            FRAME,
        )

    def at(z, share):
        t = (z - h) / (top - h)
        return np.array(
            [
                -w / 2 * 0.8 - lean * t - 0.03 * (1 - share**2),
                share * w * 0.42 * (1 + 0.05 * np.sin(np.pi * np.clip(t, 0, 1))),
                z,
            ]
        )

    hoop = hoop_path(at, h, top, 1.0, 41, 0.55)
    feet = [[-w * 0.52, s * w * 0.46, 0.0] for s in LEFT_RIGHT]
    down = [np.linspace(feet[0], hoop[0], 9)[:-1], hoop, np.linspace(hoop[-1], feet[1], 9)[1:]]
    a.add("hoop", tube(np.concatenate(down), size, around=12), FRAME)
    for s in LEFT_RIGHT:
        path = smooth_path(
            [
                [w * 0.36, s * w * 0.33, h],
                [w * 0.37, s * w * 0.36, h * 0.6],
                [w * 0.5, s * w * 0.44, 0],
            ],
            14,
        )
        a.add("leg", tube(path, np.linspace(size * 1.1, size * 0.75, 14), around=12), FRAME)
    kind = rng.choice(["hoop", "two", "cane", "slats"])
    if kind in ("hoop", "two"):
        inner = hoop_path(
            at, h, h + (top - h) * rng.uniform(0.68, 0.84), rng.uniform(0.45, 0.62), 33, 0.6
        )
        a.add("inner hoop", tube(inner, size * 0.75, around=10), SOFT)
        if kind == "two":
            a.add(
                "inner hoop",
                tube(hoop_path(at, h, h + (top - h) * 0.5, 0.26, 33, 0.6), size * 0.65, around=10),
                SOFT,
            )
    elif kind == "cane":
        between(a, "back", at, h + 0.1, top - 0.12, 0.012, 0.86, 0.0, SOFT, 0.07)
    else:
        upright_bars(a, "slat", at, h, top - 0.03, 3, np.array([0.02, 0.006]), 0.5, square=4.0)
