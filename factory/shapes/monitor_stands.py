"""Stands of screens: legs, tripods, loops and feet with a neck.

Metres; the screen faces +x.

lift    height of the panel's middle above the desk
wide    the panel's width
column  x of the stand's upright, behind the panel
size    half the width of what stands upright
"""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import rounded_path, smooth_path, superellipse
from factory.shapes.lofts import rod, slab, tube
from factory.shapes.monitor_panel import CASE
from factory.shapes.rounded_boxes import rounded_box


def stand(
    a: Assembly,
    rng: np.random.Generator,
    kind: str,
    lift: float,
    wide: float,
    behind: float = -0.03,
) -> None:
    """Add the support of a panel.

    kind    "v", "feet", "tripod", "loop", "disc", "arc", or anything else for a plate
    behind  x of the panel's back
    """
    column = behind - rng.uniform(0.03, 0.06)
    size = rng.uniform(0.018, 0.035)
    if kind == "v":
        _add_splayed_legs(a, lift, wide, column)
    elif kind == "feet":
        _add_feet(a, lift, wide)
    else:
        if kind == "tripod":
            _add_tripod(a, lift, column, size)
        elif kind == "loop":
            _add_loop(a, rng, lift, column)
        else:
            _add_foot(a, rng, kind, column)
            _add_neck(a, rng, lift, column, size)
        _add_mount(a, lift, column)


def _add_splayed_legs(a: Assembly, lift: float, wide: float, column: float) -> None:
    """Add two bent legs that meet behind the panel and stand apart in front."""
    for s in LEFT_RIGHT:
        path = rounded_path(
            [
                [0.12, s * 0.2 * wide * 2, 0.008],
                [column, s * 0.05, 0.05],
                [column, s * 0.02, lift],
            ],
            0.05,
        )
        a.add("stand", tube(path, np.array([0.016, 0.009]), around=14, square=4.0), CASE)


def _add_feet(a: Assembly, lift: float, wide: float) -> None:
    """Add two pairs of short legs below the panel's sides."""
    for s in LEFT_RIGHT:
        y = s * wide * 0.36
        for x in (0.11, -0.13):
            a.add(
                "foot",
                rod(
                    [-0.012, y, lift * 0.55],
                    [x, y + s * 0.02, 0.006],
                    [0.012, 0.008],
                    around=14,
                    square=4.0,
                ),
                CASE,
            )


def _add_tripod(a: Assembly, lift: float, column: float, size: float) -> None:
    """Add three legs and a column."""
    for angle in (0.75, -0.75, np.pi):
        foot = [column + 0.02 + 0.24 * np.cos(angle), 0.24 * np.sin(angle), 0.006]
        a.add(
            "leg",
            tube(
                smooth_path(
                    [[column, 0, 0.06], [(column + foot[0]) / 2, foot[1] / 2, 0.035], foot], 9
                ),
                np.linspace([0.016, 0.012], [0.01, 0.006], 9),
                around=14,
                square=3.0,
            ),
            CASE,
        )
    a.add("column", rod([column, 0, 0.03], [column, 0, lift + 0.02], size * 0.8, size * 0.6), CASE)


def _add_loop(a: Assembly, rng: np.random.Generator, lift: float, column: float) -> None:
    """Add a bent rod that lies on the desk and rises on both sides."""
    w = rng.uniform(0.08, 0.16)
    path = rounded_path(
        [
            [0.13, w, 0.008],
            [column, w, 0.008],
            [column, w * 0.8, lift],
            [column, -w * 0.8, lift],
            [column, -w, 0.008],
            [0.13, -w, 0.008],
        ],
        0.05,
        6,
    )
    a.add("stand", tube(path, 0.008, around=12), CASE)


def _add_foot(a: Assembly, rng: np.random.Generator, kind: str, column: float) -> None:
    """Add a disc, a plate, or a small plate with an arc in front."""
    depth, reach = rng.uniform(0.17, 0.26), rng.uniform(0.2, 0.34)
    if kind == "disc":
        outline = superellipse(48) * [depth / 2, depth / 2]
    elif kind == "arc":
        turn = np.linspace(-1.2, 1.2, 25)
        path = np.stack(
            [
                column - 0.05 + 0.2 * np.cos(turn) - 0.02,
                0.2 * np.sin(turn) * reach / 0.24,
                np.full(25, 0.009),
            ],
            1,
        )
        a.add("foot", tube(path, np.array([0.03, 0.009]), around=16, square=5.0), CASE)
        outline = superellipse(32, 4.0) * [0.09, 0.045]
    else:
        outline = superellipse(48, rng.uniform(3, 9)) * [depth / 2, reach / 2]
    a.add(
        "foot",
        slab(outline, rng.uniform(0.01, 0.018), 0.8, rng.choice([0.0, 0.008])).moved(
            0.0 if kind != "arc" else column + 0.06, 0, 0.008
        ),
        CASE,
    )


def _add_neck(
    a: Assembly, rng: np.random.Generator, lift: float, column: float, size: float
) -> None:
    """Add the neck between the foot and the panel."""
    lean = rng.uniform(-0.02, 0.05)
    flat = rng.choice([True, False])
    path = smooth_path(
        [
            [column + lean, 0, 0.01],
            [column + lean * 0.3, 0, lift * 0.5],
            [column, 0, lift + 0.03],
        ],
        12,
    )
    a.add(
        "neck",
        tube(
            path,
            np.array([size * (1.6 if flat else 0.8), size * (0.5 if flat else 0.8)]),
            around=18,
            square=rng.choice([2.5, 6.0]),
        ),
        CASE,
    )


def _add_mount(a: Assembly, lift: float, column: float) -> None:
    """Add the block between the upright and the panel."""
    a.add(
        "mount",
        rounded_box([0.016 - column, 0.1, 0.1], 0.012, edge=2).moved((column - 0.004) / 2, 0, lift),
        CASE,
    )
