"""Wheels of cars, the arches about them, and the underbody between."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.car_body import DARK, PAINT, Form
from factory.shapes.closed_surface import Surface, close_surface, grid_faces
from factory.shapes.lofts import revolve, rod, tube
from factory.shapes.rounded_boxes import rounded_box


def wheel(kind: str, spokes: int, radius: float, width: float) -> list[tuple[str, Surface]]:
    """Return a wheel's tyre, rim and spokes as [(part, Surface)].

    The wheel stands about the y axis, its outer side towards +y.
    """
    rim, half = radius * 0.68, width / 2
    tyre = [
        [rim - 0.02, -half * 0.7],
        [rim, -half * 0.9],
        [radius * 0.9, -half],
        [radius * 0.975, -half * 0.82],
        [radius, -half * 0.5],
    ]
    profile = np.array(tyre + [[r, -z] for r, z in tyre[::-1]] + [[rim - 0.02, -half * 0.7]])
    angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    rings = profile[:-1, :1, None] * circle + profile[:-1, 1:, None] * np.array([0, 0, 1.0])
    solid = close_surface(rings.reshape(-1, 3), grid_faces(len(rings), 36, True, True))
    dish = half * 0.15
    lip = revolve(
        [
            [0, -half * 0.6],
            [rim - 0.015, -half * 0.6],
            [rim - 0.012, half * 0.82],
            [rim - 0.03, half * 0.86],
            [rim - 0.045, half * 0.8],
            [rim - 0.05, dish - 0.03],
            [0, dish - 0.03],
        ],
        44,
    )
    pieces = [
        ("tyre", solid),
        ("rim", lip),
        (
            "hub",
            revolve(
                [
                    [0, dish - 0.03],
                    [0.055, dish - 0.03],
                    [0.05, dish + 0.03],
                    [0.03, dish + 0.04],
                    [0, dish + 0.04],
                ],
                20,
            ),
        ),
    ]
    if kind == "disc":
        pieces.append(
            (
                "hub cap",
                revolve(
                    [
                        [0, dish - 0.02],
                        [rim - 0.05, dish - 0.02],
                        [rim - 0.06, dish + 0.02],
                        [rim * 0.5, dish + 0.035],
                        [rim * 0.3, dish + 0.02],
                        [0, dish + 0.045],
                    ],
                    36,
                ),
            )
        )
    for k in range(spokes if kind != "disc" else 0):
        offsets = (-0.09, 0.09) if kind == "double" else (0.0,)
        for offset in offsets:
            size = (0.5 if kind == "double" else 1.0) * min(0.045, 0.19 / spokes)
            arm = rod(
                [0.03, 0, dish + 0.012],
                [rim - 0.035, offset * rim, half * 0.66],
                [size, 0.014],
                [size * 1.25, 0.012],
                around=6,
                square=4.0,
            )
            pieces.append(("spoke", arm.turned("z", 2 * np.pi * k / spokes)))
    return [(part, piece.turned("x", -np.pi / 2)) for part, piece in pieces]


def wheels(a: Assembly, rng: np.random.Generator, form: Form) -> None:
    """Add four wheels, their arches' lips, and the dark underbody between them."""
    kind = rng.choice(["spokes", "spokes", "double", "disc"])
    spokes = int(rng.integers(5, 11 if kind == "spokes" else 7))
    width = rng.uniform(0.19, 0.24)
    cladding = DARK if form.clearance > 0.2 and rng.random() < 0.5 else PAINT
    for axle in form.axles:
        offset = form.side(axle, form.wheel) - 0.015
        for part, piece in wheel(kind, spokes, form.wheel, width):
            a.pair(part, piece.moved(axle, offset - width / 2, form.wheel), DARK)
        angle = np.linspace(0.04, np.pi - 0.04, 23)
        x, z = axle + form.arch * np.cos(angle), form.wheel + form.arch * np.sin(angle)
        y = np.array([form.side(*place) for place in zip(x, z, strict=True)]) - 0.006
        lip = 0.035 if cladding == DARK else 0.016
        a.pair(
            "arch",
            tube(np.stack([x, y, z], 1), np.array([0.022, lip]), around=8, square=2.5),
            cladding,
        )
    low, high = form.clearance + 0.03, form.wheel + 0.95 * form.arch
    box = rounded_box(
        [form.axles[0] - form.axles[1] + 1.9 * form.arch, form.width - 2 * width - 0.2, high - low],
        0.05,
        edge=1,
    )
    a.add("underbody", box.moved(sum(form.axles) / 2, 0, (low + high) / 2), DARK)
