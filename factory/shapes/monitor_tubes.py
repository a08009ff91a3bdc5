"""Monitors and television sets with a picture tube, styles of factory.shapes.monitor."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT, Surface, close_surface
from factory.shapes.curves import superellipse
from factory.shapes.lofts import loft, revolve, rod
from factory.shapes.monitor_panel import CASE, add_panel, panel
from factory.shapes.rounded_boxes import rounded_box


def tube_body(wide: float, high: float, depth: float, rear: float, sink: float) -> Surface:
    """Return the back of a tube's casing.

    It narrows from the front to the share `rear` of its size, and its top falls by `sink`.
    """
    rings = []
    for t in (0.0, 0.12, 0.25, 0.4, 0.55, 0.7, 0.85, 0.96, 1.0):
        ease = np.clip((t - 0.12) / 0.7, 0, 1)
        ease = ease * ease * (3 - 2 * ease)
        share = 1 - (1 - rear) * ease - (0.06 if t == 1.0 else 0.0)
        outline = superellipse(56, 8.0 - 3 * ease) * [wide / 2 * share, high / 2 * share]
        rings.append(
            np.column_stack([np.full(56, -t * depth), outline[:, 0], outline[:, 1] - sink * ease])
        )
    return loft(np.array(rings))


def tube_monitor(a: Assembly, rng: np.random.Generator) -> None:
    """Add a cathode-ray monitor: bulged screen, deep casing, swivel foot."""
    wide = rng.uniform(0.34, 0.46)
    high, depth = wide * rng.uniform(0.82, 0.92), wide * rng.uniform(0.85, 1.05)
    lift = high / 2 + rng.uniform(0.05, 0.08)
    pieces = panel(
        wide,
        high,
        thick=0.06,
        bezel=rng.uniform(0.028, 0.045),
        chin=rng.uniform(0.0, 0.04),
        radius=rng.uniform(0.012, 0.035),
        recess=0.012,
        crown=rng.uniform(0.006, 0.016),
    )
    tilt = rng.uniform(0.0, 0.1)
    add_panel(a, pieces, lambda s: s.turned("y", -tilt).moved(depth / 2, 0, lift))
    body = tube_body(
        wide * 0.97, high * 0.97, depth - 0.05, rng.uniform(0.5, 0.7), rng.uniform(0.0, 0.05)
    )
    a.add("casing", body.moved(-0.05, 0, 0).turned("y", -tilt).moved(depth / 2, 0, lift), CASE)
    foot = rng.uniform(0.11, 0.15)
    a.add(
        "foot",
        revolve(
            [
                [0.0, 0.0],
                [foot, 0.0],
                [foot, 0.012],
                [foot * 0.75, 0.022],
                [foot * 0.55, 0.05],
                [foot * 0.6, 0.1],
                [0.0, 0.11],
            ],
            40,
        ).moved(0.03, 0, 0),
        CASE,
    )
    for k in range(int(rng.integers(1, 6))):
        button = rod(
            [depth / 2 - 0.01, wide * 0.4 - 0.03 * k, lift - high * 0.455],
            [depth / 2 + 0.004, wide * 0.4 - 0.03 * k, lift - high * 0.455],
            0.006,
            around=12,
        )
        a.add("button", button.turned("y", 0.0), CASE)


def tube_television(a: Assembly, rng: np.random.Generator) -> None:
    """Add an old television: a wooden box on splayed legs, knobs and a grille beside the screen.

    Half of them have an aerial.
    """
    wide, high, deep = rng.uniform(0.5, 0.68), rng.uniform(0.4, 0.48), rng.uniform(0.3, 0.4)
    legs = rng.choice([0.0, rng.uniform(0.15, 0.45)])
    lift = legs + high / 2 + 0.012
    a.add(
        "box",
        rounded_box([deep, wide, high], rng.uniform(0.015, 0.06), (0.0, 0.02, 0.02), 4, 6).moved(
            0, 0, lift
        ),
        CASE,
    )
    a.add(
        "casing",
        tube_body(wide * 0.7, high * 0.75, 0.14, 0.6, 0.0).moved(-deep / 2 + 0.01, 0, lift),
        CASE,
    )
    tube_wide = wide * rng.uniform(0.6, 0.68)
    shift = -(wide - tube_wide) / 2 + 0.035
    pieces = panel(
        tube_wide,
        high * 0.84,
        thick=0.05,
        bezel=0.02,
        radius=rng.uniform(0.04, 0.09),
        recess=0.008,
        crown=0.022,
    )
    add_panel(
        a, pieces, lambda s: close_surface(s.vertices, s.faces).moved(deep / 2 + 0.016, shift, lift)
    )
    y = wide / 2 - (wide - tube_wide) / 2 + 0.012
    for k in range(2):
        knob = revolve([[0.0, 0.0], [0.03, 0.0], [0.027, 0.03], [0.0, 0.032]], 24).turned(
            "y", np.pi / 2
        )
        a.add("knob", knob.moved(deep / 2 - 0.004, y, lift + high * (0.3 - 0.2 * k)), CASE)
    for z in np.linspace(-0.36, -0.04, 7) * high:
        a.add(
            "grille",
            rod(
                [deep / 2 + 0.004, y - 0.045, lift + z],
                [deep / 2 + 0.004, y + 0.045, lift + z],
                0.005,
                around=10,
            ),
            CASE,
        )
    for x in (1, -1):
        for s in LEFT_RIGHT:
            top = [x * deep * 0.36, s * wide * 0.4, lift - high / 2 + 0.015]
            a.add(
                "leg",
                rod(
                    top,
                    [x * (deep * 0.36 + 0.15 * legs), s * (wide * 0.4 + 0.15 * legs), 0],
                    0.018,
                    0.011,
                ),
                CASE,
            )
    if rng.random() < 0.5:
        for s in LEFT_RIGHT:
            a.add(
                "aerial",
                rod(
                    [-0.03, s * 0.02, lift + high / 2 - 0.005],
                    [-0.05, s * rng.uniform(0.18, 0.3), lift + high / 2 + 0.36],
                    0.005,
                    0.003,
                    around=10,
                ),
                CASE,
            )
