"""Chairs: eight constructions with proportions drawn per seed.

Segments: 1 seat, back and cushions; 2 frame and legs. Sizes are those of real chairs, in metres:
seat 0.40–0.54 wide, 0.40–0.50 deep, 0.42–0.48 high (bar stools 0.65–0.80), back to 0.78–1.10.
"""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.chair_easy import armchair
from factory.shapes.chair_parts import (
    FRAME,
    SOFT,
    apron,
    arm_rests,
    between,
    four_legs,
    hoop_path,
    posts,
    seat_outline,
    sled,
    soft_pad,
    star_base,
    stretchers,
    trumpet_base,
    upright_bars,
)
from factory.shapes.mesh import Mesh
from factory.shapes.surfaces import (
    LEFT_RIGHT,
    cushion,
    rod,
    rounded_box,
    rounded_path,
    shell,
    slab,
    smooth_path,
    tube,
)

FAMILY_KEY = 2  # spawn key: the same seed gives another family other numbers


def build(seed: int) -> Mesh:
    """Return the chair of a seed, a Mesh of category "chair"."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAMILY_KEY,)))
    style = STYLES[int(rng.choice(len(STYLES), p=WEIGHTS))]
    a = Assembly()
    style(a, rng)
    return a.finish(f"chair:{seed}", "chair")


def dining(a: Assembly, rng: np.random.Generator) -> None:
    """Add a chair with four legs, posts, and a back of slats, rungs, a board, a splat or a pad."""
    w, d, h = rng.uniform(0.40, 0.50), rng.uniform(0.40, 0.47), rng.uniform(0.43, 0.47)
    rear, top, lean = rng.uniform(0.82, 1.0), h + rng.uniform(0.36, 0.62), rng.uniform(0.03, 0.12)
    stretchers(a, rng, four_legs(a, rng, w, d, h - 0.02, rear))
    apron(a, w, d, h, rear)
    if rng.random() < 0.5:
        a.add(
            "seat",
            soft_pad(w, d, rng.uniform(0.045, 0.08), rear, rng.uniform(4, 8)).moved(z=h),
            SOFT,
        )
    else:
        a.add(
            "seat",
            slab(
                seat_outline(w + 0.02, d + 0.02, rear, rng.uniform(5, 9)), 0.028, 0.8, -0.008
            ).moved(z=h),
            SOFT,
        )
    at = posts(a, rng, w, d, h, rear, top, lean)
    kind = rng.choice(["slats", "ladder", "board", "splat", "pad", "spindles"])
    rail, bow = rng.uniform(0.05, 0.09), rng.uniform(0.005, 0.035)
    if kind in ("slats", "splat", "spindles"):
        between(
            a,
            "top rail",
            at,
            top - rail,
            top + 0.005,
            0.022,
            1.04,
            bow,
            FRAME,
            crown=rng.choice([0.0, 0.03, 0.05]),
        )
        low = h + rng.uniform(0.0, 0.12)
        if low > h + 0.04:
            between(a, "low rail", at, low - 0.02, low + 0.02, 0.018, 1.0, bow, FRAME)
        if kind == "slats":
            count = int(rng.integers(3, 8))
            upright_bars(
                a,
                "slat",
                at,
                low - 0.02,
                top - rail / 2,
                count,
                np.array([0.26 / count, 0.006]),
                0.78,
                square=5.0,
            )
        elif kind == "spindles":
            upright_bars(
                a, "spindle", at, low - 0.02, top - rail / 2, int(rng.integers(5, 10)), 0.006, 0.8
            )
        else:
            z = np.linspace(low - 0.02, top - rail / 2, 15)
            t = np.linspace(0, 1, 15)
            girth = 0.05 + 0.03 * np.sin(2 * np.pi * t * rng.uniform(0.8, 1.5)) + 0.02 * t
            a.add(
                "splat",
                tube(
                    np.array([at(k, 0.0) - [bow * 0.7, 0, 0] for k in z]),
                    np.stack([girth, np.full(15, 0.006)], 1),
                    16,
                    4.0,
                ),
                SOFT,
            )
    elif kind == "ladder":
        count = int(rng.integers(2, 6))
        step = (top - h - 0.08) / count
        for k in range(count):
            low = h + 0.1 + k * step
            between(
                a,
                "rung",
                at,
                low,
                low + step * rng.uniform(0.45, 0.55),
                0.014,
                1.0,
                bow,
                SOFT,
                crown=0.012,
            )
    elif kind == "board":
        between(
            a,
            "back",
            at,
            h + rng.uniform(0.08, 0.2),
            top - 0.01,
            0.016,
            1.0,
            bow,
            SOFT,
            crown=rng.choice([0.0, 0.04]),
        )
    else:
        low = h + rng.uniform(0.03, 0.12)
        between(
            a,
            "back pad",
            at,
            low,
            top - 0.015,
            0.05,
            0.97,
            bow,
            SOFT,
            crown=rng.choice([0.0, 0.03]),
        )
    if rng.random() < 0.3:
        arm_rests(a, rng, w, d, h, at(h + 0.22, 1)[0])


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


def shell_chair(a: Assembly, rng: np.random.Generator) -> None:
    """Add one moulded shell on legs, runners, a star or a trumpet."""
    w, d, h = rng.uniform(0.42, 0.58), rng.uniform(0.42, 0.48), rng.uniform(0.42, 0.46)
    top, lean = h + rng.uniform(0.34, 0.48), rng.uniform(0.08, 0.18)
    side, arms = rng.uniform(0.03, 0.07), rng.choice([0.0, 0.0, 0.16])
    profile = np.array(
        [
            [d / 2 + 0.02, h - 0.03],
            [d * 0.36, h + 0.012],
            [0, h - 0.02],
            [-d * 0.36, h + 0.012],
            [-d / 2 - 0.02, h + 0.12],
            [-d / 2 - 0.02 - lean * 0.5, (h + top) / 2 + 0.06],
            [-d / 2 - lean, top],
        ]
    )
    path = smooth_path(profile, 11)
    t = np.linspace(0, 1, 11)
    waist = (
        1
        - rng.uniform(0.0, 0.25) * np.exp(-(((t - 0.52) / 0.12) ** 2))
        - rng.uniform(0.0, 0.35) * t**3
        - 0.12 * (1 - t) ** 4
    )
    across = np.linspace(-1, 1, 9)
    points = np.empty((11, 9, 3))
    lift = (side + arms * np.exp(-(((t - 0.5) / 0.2) ** 2)))[:, None] * np.abs(across) ** 2.5
    # on the seat the rim rises, on the back it comes forward
    forward = np.clip((t - 0.35) / 0.3, 0, 1)[:, None]
    points[..., 0] = path[:, :1] + lift * forward * 1.3
    points[..., 1] = across * (w / 2 * waist)[:, None]
    points[..., 2] = path[:, 1:] + lift * (1 - forward * 0.7)
    a.add("shell", shell(points, 0.012, 2), SOFT)
    if rng.random() < 0.4:
        a.add(
            "cushion",
            soft_pad(w * 0.72, d * 0.72, 0.035, 0.95, 3.5, 0.01).moved(0.02, 0, h + 0.015),
            SOFT,
        )
    base = rng.choice(["legs", "sled", "star", "trumpet", "wire"])
    if base == "legs":
        four_legs(a, rng, w * 0.7, d * 0.75, h)
        for k in LEFT_RIGHT:
            a.add(
                "cross bar",
                rod(
                    [k * d * 0.26, -w * 0.28, h - 0.045], [k * d * 0.26, w * 0.28, h - 0.045], 0.009
                ),
                FRAME,
            )
    elif base == "sled":
        sled(a, rng, w * 0.92, d * 0.95, h - 0.02)
    elif base == "star":
        star_base(a, rng, h)
    elif base == "trumpet":
        trumpet_base(a, rng, h)
    else:
        for front in (1, -1):
            for left in LEFT_RIGHT:
                foot = [front * d * 0.46, left * w * 0.42, 0.0]
                a.add("wire", rod([front * 0.12, left * 0.15, h - 0.01], foot, 0.007), FRAME)
                a.add(
                    "wire",
                    rod([front * 0.12, -left * 0.04, h - 0.01], [foot[0], foot[1], 0.02], 0.005),
                    FRAME,
                )
                a.add(
                    "wire",
                    rod(
                        [-front * 0.1, left * 0.15, h - 0.02],
                        [foot[0] * 0.95, foot[1] * 0.95, 0.05],
                        0.005,
                    ),
                    FRAME,
                )


def office(a: Assembly, rng: np.random.Generator) -> None:
    """Add a swivel chair: star base, padded seat, curved back on a spine.

    Arms and a head rest are drawn.
    """
    w, d, h = rng.uniform(0.46, 0.54), rng.uniform(0.44, 0.5), rng.uniform(0.43, 0.52)
    tall, thick = rng.uniform(0.38, 0.72), rng.uniform(0.05, 0.1)
    star_base(a, rng, h - thick / 2)
    a.add(
        "seat",
        soft_pad(w, d, thick, rng.uniform(0.88, 1.0), rng.uniform(3, 6), 0.015).moved(0, 0, h),
        SOFT,
    )
    a.add(
        "mechanism",
        rounded_box([0.24, 0.18, 0.05], 0.015).moved(-0.02, 0, h - thick / 2 - 0.02),
        FRAME,
    )
    low, lean, wrap = h + rng.uniform(0.05, 0.14), rng.uniform(0.05, 0.14), rng.uniform(0.02, 0.08)
    narrow, across, up = rng.uniform(0.7, 1.0), np.linspace(-1, 1, 9), np.linspace(0, 1, 9)
    points = np.empty((9, 9, 3))
    bulge = rng.uniform(0.02, 0.05) * np.sin(np.pi * np.clip(up * 1.6, 0, 1))
    points[..., 0] = (-d / 2 + 0.02 - lean * up**1.3 + bulge)[:, None] + wrap * across**2
    points[..., 1] = across * (w / 2 * (0.86 + (narrow - 0.86) * up))[:, None]
    points[..., 2] = (low + tall * up)[:, None] + 0.0 * across
    # Corners come in, so that the outline is rounded
    points[..., 1] *= (1 - 0.16 * np.abs(2 * up - 1) ** 6)[:, None]
    a.add("back", shell(points[::-1], rng.choice([0.03, 0.05, 0.09]), 2), SOFT)
    spine = smooth_path(
        [
            [-0.06, 0, h - thick / 2 - 0.02],
            [-d / 2 - 0.06, 0, h - 0.02],
            [-d / 2 - 0.045 - lean * 0.3, 0, low + tall * 0.4],
        ],
        14,
    )
    a.add("spine", tube(spine, np.array([0.028, 0.012]), around=14, square=4.0), FRAME)
    if rng.random() < 0.35:
        a.add(
            "head rest",
            cushion([0.07, 0.27, 0.14], 0.3, 5)
            .turned("y", -0.12)
            .moved(-d / 2 - lean + 0.02, 0, low + tall + 0.11),
            SOFT,
        )
        a.add(
            "head post",
            rod(
                [-d / 2 - lean - 0.01, 0, low + tall - 0.08],
                [-d / 2 - lean, 0, low + tall + 0.1],
                [0.02, 0.007],
            ),
            FRAME,
        )
    kind, rise = rng.choice(["none", "t", "loop"]), rng.uniform(0.18, 0.24)
    for side in LEFT_RIGHT if kind != "none" else ():
        y = side * (w / 2 + 0.04)
        if kind == "t":
            a.add(
                "arm pad",
                rounded_box([0.25, 0.08, 0.03], 0.014, (0, 0, 0.1)).moved(0.02, y, h + rise),
                FRAME,
            )
            arm = rounded_path(
                [
                    [0.0, side * 0.1, h - thick / 2],
                    [0.0, y, h - thick / 2 - 0.005],
                    [-0.01, y, h + rise],
                ],
                0.05,
            )
            a.add(
                "arm",
                tube(arm, np.array([0.022, 0.011]), around=12, square=4.0, side=(1.0, 0, 0)),
                FRAME,
            )
        else:
            arm = rounded_path(
                [
                    [0.14, y * 0.95, h - 0.03],
                    [0.17, y, h + rise],
                    [-d / 2 + 0.02, y, h + rise + 0.02],
                    [-d / 2 - 0.02, y * 0.9, h + 0.12],
                ],
                0.08,
                8,
            )
            a.add("arm", tube(arm, np.array([0.018, 0.012]), around=12, square=3.0), FRAME)


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


def cantilever(a: Assembly, rng: np.random.Generator) -> None:
    """Add a chair whose one bent steel tube carries seat and back, without rear legs."""
    w, d, h = rng.uniform(0.44, 0.5), rng.uniform(0.42, 0.48), rng.uniform(0.43, 0.46)
    top, lean, size = (
        h + rng.uniform(0.34, 0.46),
        rng.uniform(0.05, 0.12),
        rng.uniform(0.010, 0.014),
    )
    x, y = d / 2, w / 2
    right = rounded_path(
        [
            [-x + 0.02, -y, size],
            [x, -y, size],
            [x + 0.01, -y, h],
            [-x, -y, h],
            [-x - lean, -y, top],
        ],
        rng.uniform(0.07, 0.13),
        7,
    )
    left = right[::-1] * [1, -1, 1]
    floor = rounded_path([left[-1], [-x - 0.02, y, size], [-x - 0.02, -y, size], right[0]], 0.05, 4)
    a.add("tube", tube(np.concatenate([left[:-1], floor, right[1:]]), size, around=12), FRAME)
    a.add(
        "seat",
        soft_pad(w - 0.01, d - 0.05, rng.uniform(0.025, 0.07), 1.0, 6.0, 0.005).moved(
            -0.01, 0, h + 0.008
        ),
        SOFT,
    )
    high = rng.uniform(0.16, top - h - 0.08)
    back = rounded_box([rng.uniform(0.025, 0.06), w, high], 0.02, (0.25, 0.0, 0.0), 3, 6).turned(
        "y", -np.arctan(lean / (top - h))
    )
    t = (top - 0.02 - high / 2 - h) / (top - h)
    a.add("back", back.moved(-x - lean * t, 0, top - 0.02 - high / 2), SOFT)
    if rng.random() < 0.45:
        for s in LEFT_RIGHT:
            arm = rounded_path(
                [
                    [x + 0.01, s * y, h - 0.1],
                    [x - 0.02, s * (y + 0.012), h + 0.21],
                    [-x - lean * 0.5, s * (y + 0.008), h + 0.21],
                ],
                0.08,
                7,
            )
            a.add("arm", tube(arm, size * 0.9, around=12), FRAME)


def stool(a: Assembly, rng: np.random.Generator) -> None:
    """Add a bar stool: high seat, foot rest, low back or none."""
    w, h = rng.uniform(0.34, 0.42), rng.uniform(0.62, 0.8)
    round_seat = rng.random() < 0.6
    a.add(
        "seat",
        soft_pad(
            w, w * 0.95, rng.uniform(0.04, 0.09), 1.0, 2.0 if round_seat else 5.0, 0.012
        ).moved(z=h),
        SOFT,
    )
    circle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.stack([np.cos(circle), np.sin(circle), 0 * circle], 1)
    if rng.random() < 0.45:
        trumpet_base(a, rng, h)
        a.add(
            "foot ring",
            tube(ring * 0.15 + [0, 0, h * 0.4], 0.009, 10, ring=True, side=(0, 0, 1.0)),
            FRAME,
        )
        a.add("foot spoke", rod([-0.15, 0, h * 0.4], [0.15, 0, h * 0.4], 0.007), FRAME)
    else:
        ends = four_legs(a, rng, w * 0.8, w * 0.8, h)
        rest = {key: top + 0.68 * (foot - top) for key, (top, foot) in ends.items()}
        for one, other in (
            ((1, 1), (1, -1)),
            ((-1, 1), (-1, -1)),
            ((1, 1), (-1, 1)),
            ((1, -1), (-1, -1)),
        ):
            a.add("foot rest", rod(rest[one], rest[other], 0.009), FRAME)
    if rng.random() < 0.7:
        tall = rng.uniform(0.1, 0.32)
        angle = np.linspace(-1, 1, 25) * rng.uniform(0.7, 1.2)
        path = np.stack(
            [-w / 2 * np.cos(angle) - 0.03, w / 2 * np.sin(angle), np.full(25, h + tall)], 1
        )
        high = rng.uniform(0.03, min(0.11, tall * 0.6))
        a.add(
            "back",
            tube(path, np.array([high, 0.014]), around=20, square=4.0, bevel=0.8, side=(0, 0, 1.0)),
            SOFT,
        )
        for k in (3, 21):
            a.add(
                "back post",
                rod([path[k, 0] * 0.85, path[k, 1] * 0.85, h - 0.01], path[k], 0.009),
                FRAME,
            )


STYLES = (dining, windsor, shell_chair, office, bentwood, cantilever, armchair, stool)
WEIGHTS = np.array([0.24, 0.1, 0.15, 0.15, 0.09, 0.08, 0.11, 0.08])
