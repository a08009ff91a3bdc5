"""Chairs of shells, tubes and columns, and stools: styles of factory.shapes.chair."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.chair_bases import four_legs, sled, star_base, trumpet_base
from factory.shapes.chair_seats import FRAME, SOFT, soft_pad
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import rounded_path, smooth_path
from factory.shapes.lofts import rod, tube
from factory.shapes.rounded_boxes import cushion, rounded_box
from factory.shapes.shells import shell


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
