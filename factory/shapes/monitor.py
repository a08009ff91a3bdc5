"""Screens: flat and curved desk monitors, two on an arm, all-in-ones, televisions, laptops, tubes.

Segments: 1 screen; 2 casing and stand. The screen faces +x. Sizes are those of real ones, in
metres: 0.30–1.2 wide, 4:3 to 32:9.
"""

from functools import partial

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT, Surface
from factory.shapes.curves import rounded_path, smooth_path, superellipse
from factory.shapes.lofts import rod, slab, tube
from factory.shapes.mesh import Mesh
from factory.shapes.monitor_panel import CASE, add_panel, bend, draw_panel, panel
from factory.shapes.monitor_stands import stand
from factory.shapes.monitor_tubes import tube_monitor, tube_television
from factory.shapes.rounded_boxes import rounded_box

FAMILY_KEY = 4
ASPECTS = (4 / 3, 5 / 4, 16 / 10, 16 / 9, 16 / 9, 21 / 9, 32 / 9)


def build(seed: int) -> Mesh:
    """Return the monitor of a seed, a Mesh of category "monitor"."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAMILY_KEY,)))
    styles = (desk, curved, dual, all_in_one, television, laptop, tube_monitor, tube_television)
    style = styles[int(rng.choice(len(styles), p=[0.32, 0.12, 0.09, 0.09, 0.11, 0.11, 0.10, 0.06]))]
    a = Assembly()
    style(a, rng)
    return a.finish(f"monitor:{seed}", "monitor")


def desk(a: Assembly, rng: np.random.Generator) -> None:
    """Add a flat monitor on a stand; some are upright, some have a sound bar below."""
    aspect = float(rng.choice(ASPECTS[:6]))
    if rng.random() < 0.14:
        aspect = 1 / aspect
    wide, high, pieces = draw_panel(rng, rng.uniform(0.43, 0.7), aspect)
    lift = high / 2 + rng.uniform(0.05, 0.15)
    tilt = rng.uniform(0.0, 0.14)
    add_panel(a, pieces, lambda s: s.turned("y", -tilt).moved(0.02, 0, lift))
    stand(
        a,
        rng,
        rng.choice(
            ["plate", "disc", "v", "loop", "tripod", "arc"], p=[0.3, 0.18, 0.14, 0.14, 0.1, 0.14]
        ),
        lift,
        wide,
    )
    if rng.random() < 0.15 and high > 0.2:
        a.add(
            "sound bar",
            rounded_box([0.04, wide * 0.7, 0.035], 0.012, edge=2).moved(
                0.01, 0, lift - high / 2 - 0.018
            ),
            CASE,
        )


def curved(a: Assembly, rng: np.random.Generator) -> None:
    """Add a wide panel bent towards the viewer."""
    wide, high, pieces = draw_panel(
        rng,
        rng.uniform(0.75, 1.2),
        float(rng.choice([16 / 9, 21 / 9, 32 / 9])),
        thick=rng.uniform(0.02, 0.04),
    )
    lift, radius = high / 2 + rng.uniform(0.06, 0.14), rng.uniform(0.75, 1.6)
    add_panel(a, pieces, lambda s: bend(s, radius).moved(0.03, 0, lift))
    stand(a, rng, rng.choice(["plate", "v", "tripod", "disc", "arc"]), lift, wide * 0.7)


def dual(a: Assembly, rng: np.random.Generator) -> None:
    """Add two panels side by side, or one above the other, on one column."""
    aspect = float(rng.choice([16 / 10, 16 / 9, 5 / 4, 3 / 4]))
    wide, high, pieces = draw_panel(rng, rng.uniform(0.45, 0.6), aspect)
    if rng.random() < 0.7:
        lift, turn = high / 2 + rng.uniform(0.06, 0.14), rng.uniform(0.05, 0.35)

        def beside(p: Surface, s: float) -> Surface:
            moved = p.moved(0, s * (wide / 2 + 0.006), 0)
            return moved.turned("z", -s * turn).moved(0.04, 0, lift)

        for s in LEFT_RIGHT:
            add_panel(a, pieces, partial(beside, s=s))
            path = rounded_path(
                [
                    [-0.09, 0, lift],
                    [-0.1, s * wide * 0.25, lift],
                    [-0.01 + 0.5 * wide * np.sin(turn), s * wide * 0.5 * np.cos(turn), lift],
                ],
                0.04,
            )
            a.add(
                "arm",
                tube(path, np.array([0.022, 0.012]), around=14, square=3.0, side=(0, 0, 1.0)),
                CASE,
            )
    else:
        lift = high + rng.uniform(0.05, 0.1)
        tilt = rng.uniform(0.0, 0.12)

        def above(p: Surface, s: float) -> Surface:
            return p.turned("y", s * tilt).moved(0.03, 0, lift + s * (high / 2 + 0.01))

        for s in LEFT_RIGHT:
            add_panel(a, pieces, partial(above, s=s))
            a.add(
                "arm",
                rounded_box([0.1, 0.08, 0.08], 0.012, edge=2).moved(-0.05, 0, lift + s * high / 2),
                CASE,
            )
    a.add("column", rod([-0.1, 0, 0.01], [-0.1, 0, lift + high * 0.55], 0.018, around=18), CASE)
    a.add(
        "foot",
        slab(
            superellipse(48, rng.choice([2.0, 5.0])) * [0.13, rng.uniform(0.14, 0.22)], 0.016, 0.8
        ).moved(-0.04, 0, 0.008),
        CASE,
    )


def all_in_one(a: Assembly, rng: np.random.Generator) -> None:
    """Add a panel with a deep chin on a bent metal foot, or a tablet that leans on its stand."""
    if rng.random() < 0.6:
        _, high, pieces = draw_panel(
            rng,
            rng.uniform(0.55, 0.72),
            1.5,
            chin=rng.uniform(0.05, 0.09),
            thick=0.02,
            bulge=rng.uniform(0.02, 0.05),
            bezel=rng.uniform(0.015, 0.03),
        )
        lift = high / 2 + rng.uniform(0.08, 0.12)
        add_panel(a, pieces, lambda s: s.turned("y", -0.06).moved(0.05, 0, lift))
        path = rounded_path(
            [[0.12, 0, 0.006], [-0.12, 0, 0.006], [-0.02, 0, lift]], rng.uniform(0.03, 0.1), 8
        )
        a.add(
            "stand",
            tube(path, np.array([rng.uniform(0.07, 0.11), 0.005]), around=20, square=7.0),
            CASE,
        )
    else:
        aspect = float(rng.choice([4 / 3, 1.6, 0.75, 0.62]))
        _, high, pieces = draw_panel(
            rng,
            rng.uniform(0.24, 0.34),
            aspect,
            thick=0.009,
            bezel=rng.uniform(0.008, 0.016),
            chin=0.0,
            bulge=0.0,
            radius=0.014,
        )
        lean = rng.uniform(0.2, 0.45)
        rise = high / 2 * np.cos(lean) + 0.018
        add_panel(a, pieces, lambda s: s.turned("y", -lean).moved(0.0, 0, rise))
        a.add(
            "foot",
            slab(superellipse(40, 5.0) * [0.08, 0.07], 0.012, 0.8).moved(0.0, 0, 0.006),
            CASE,
        )
        path = smooth_path([[-0.07, 0, 0.008], [-0.08, 0, rise * 0.6], [-0.012, 0, rise]], 10)
        a.add("stand", tube(path, np.array([0.03, 0.006]), around=16, square=5.0), CASE)
        a.add(
            "ledge",
            rounded_box([0.03, 0.14, 0.014], 0.006, edge=2).moved(
                high / 2 * np.sin(lean) + 0.004, 0, 0.016
            ),
            CASE,
        )


def television(a: Assembly, rng: np.random.Generator) -> None:
    """Add a wide screen on feet or a plate, or on a low cabinet."""
    wide, high, pieces = draw_panel(
        rng, rng.uniform(0.9, 1.3), 16 / 9, chin=rng.choice([0.0, 0.02, 0.05])
    )
    lift = high / 2 + rng.uniform(0.04, 0.1)
    ground = 0.0
    if rng.random() < 0.4:
        ground = rng.uniform(0.3, 0.45)
        size = [0.36, wide * rng.uniform(0.9, 1.3), ground - 0.1]
        a.add(
            "cabinet",
            rounded_box(size, 0.012, edge=2, inner=4).moved(-0.02, 0, 0.1 + size[2] / 2),
            CASE,
        )
        for x in (0.1, -0.14):
            for s in LEFT_RIGHT:
                a.add(
                    "leg",
                    rod(
                        [x, s * size[1] * 0.42, 0.12],
                        [x * 1.15, s * size[1] * 0.45, 0],
                        0.018,
                        0.012,
                    ),
                    CASE,
                )
        for y in np.linspace(-0.5, 0.5, 2 * int(rng.integers(1, 3)) + 1)[1::2] * size[1] * 0.96:
            a.add(
                "door",
                rounded_box(
                    [0.02, size[1] * 0.44 / (1 + (abs(y) < size[1] * 0.3)), size[2] * 0.86],
                    0.006,
                    edge=2,
                ).moved(0.16, y, 0.1 + size[2] / 2),
                CASE,
            )
    b = Assembly()
    add_panel(a, pieces, lambda s: s.moved(0.02, 0, lift + ground))
    stand(b, rng, rng.choice(["feet", "plate", "disc", "arc"]), lift, wide)
    a.add("stand", b.surface().moved(z=ground), CASE)


def laptop(a: Assembly, rng: np.random.Generator) -> None:
    """Add a laptop with its lid open by 95–135 degrees."""
    wide = rng.uniform(0.28, 0.38)
    deep, thick = wide / rng.uniform(1.35, 1.55), rng.uniform(0.012, 0.024)
    corner = rng.uniform(5, 14)
    a.add(
        "base",
        slab(superellipse(64, corner) * [deep / 2, wide / 2], thick, 0.7).moved(z=thick / 2),
        CASE,
    )
    rows, columns = 5, 13
    for r in range(rows):
        for k in range(columns):
            if r == 0 and 3 < k < 9:
                continue
            y, x = (
                (k - (columns - 1) / 2) / columns * wide * 0.88,
                -deep * 0.38 + (rows - 1 - r) * deep * 0.098,
            )
            a.add(
                "key",
                rounded_box([deep * 0.08, wide * 0.055, 0.004], 0.0015, edge=1, inner=1).moved(
                    x, y, thick + 0.001
                ),
                CASE,
            )
    a.add(
        "space bar",
        rounded_box([deep * 0.08, wide * 0.33, 0.004], 0.0015, edge=1, inner=1).moved(
            -deep * 0.38 + 4 * deep * 0.098, 0, thick + 0.001
        ),
        CASE,
    )
    a.add(
        "touch pad",
        rounded_box(
            [deep * 0.26, wide * rng.uniform(0.26, 0.4), 0.003], 0.001, edge=1, inner=1
        ).moved(deep * 0.28, 0, thick),
        CASE,
    )
    pieces = panel(
        wide,
        deep * 0.98,
        thick=rng.uniform(0.006, 0.01),
        bezel=rng.uniform(0.006, 0.018),
        chin=rng.uniform(0.0, 0.015),
        radius=0.012,
    )
    lean = np.radians(rng.uniform(5, 42))
    add_panel(
        a,
        pieces,
        lambda s: s.moved(0, 0, deep * 0.49).turned("y", -lean).moved(-deep / 2 + 0.004, 0, thick),
    )
    a.add(
        "hinge",
        rod(
            [-deep / 2 + 0.004, -wide * 0.36, thick],
            [-deep / 2 + 0.004, wide * 0.36, thick],
            0.007,
            around=14,
        ),
        CASE,
    )
