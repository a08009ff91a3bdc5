"""Cars: nine bodies with proportions drawn per seed.

Segments: 1 painted body; 2 wheels, glass, lights and trim. Sizes are those of real cars, in metres:
3.5–5.6 long, 1.6–2.0 wide, 1.2–2.0 high.
"""

from dataclasses import replace

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.car_body import DARK, PAINT, Form, cabin, lower_body
from factory.shapes.car_details import (
    cockpit,
    front,
    lights,
    mirrors_and_handles,
    roof_details,
    seams,
)
from factory.shapes.car_wheels import wheels
from factory.shapes.mesh import Mesh

FAMILY_KEY = 1

# Ranges per kind: length, width, height, clearance, nose, cowl − nose, tail; then shares of the
# length from the nose: foot of the windscreen, roof's front, roof's rear, foot of the rear window;
# wheel radius; tumblehome
# fmt: off
RANGES = {
    "sedan": (
        (4.4, 5.0), (1.76, 1.9), (1.4, 1.5), (0.16, 0.2), (0.72, 0.82), (0.16, 0.24),
        (0.96, 1.06), (0.26, 0.31), (0.4, 0.45), (0.64, 0.7), (0.8, 0.86), (0.31, 0.35),
        (0.1, 0.17),
    ),
    "hatch": (
        (3.6, 4.3), (1.66, 1.8), (1.44, 1.56), (0.15, 0.19), (0.74, 0.84), (0.16, 0.24),
        (0.92, 1.02), (0.22, 0.28), (0.37, 0.43), (0.8, 0.88), (0.93, 0.965), (0.29, 0.33),
        (0.08, 0.15),
    ),
    "wagon": (
        (4.5, 4.95), (1.76, 1.88), (1.44, 1.54), (0.16, 0.21), (0.74, 0.84), (0.16, 0.22),
        (0.96, 1.04), (0.26, 0.3), (0.39, 0.44), (0.84, 0.9), (0.94, 0.97), (0.31, 0.35),
        (0.09, 0.15),
    ),
    "suv": (
        (4.2, 4.95), (1.82, 2.0), (1.64, 1.86), (0.21, 0.28), (0.9, 1.05), (0.12, 0.2),
        (1.06, 1.18), (0.24, 0.29), (0.35, 0.41), (0.82, 0.9), (0.93, 0.97), (0.36, 0.41),
        (0.09, 0.16),
    ),
    "coupe": (
        (4.2, 4.65), (1.8, 1.95), (1.24, 1.36), (0.12, 0.15), (0.68, 0.78), (0.16, 0.24),
        (0.88, 0.98), (0.3, 0.38), (0.45, 0.51), (0.58, 0.66), (0.82, 0.93), (0.32, 0.35),
        (0.14, 0.22),
    ),
    "pickup": (
        (5.1, 5.6), (1.84, 2.0), (1.74, 1.9), (0.24, 0.32), (0.98, 1.1), (0.08, 0.14),
        (1.08, 1.18), (0.24, 0.28), (0.33, 0.37), (0.49, 0.58), (0.53, 0.61), (0.37, 0.42),
        (0.1, 0.16),
    ),
    "van": (
        (4.3, 5.0), (1.78, 1.95), (1.78, 2.02), (0.17, 0.22), (0.9, 1.02), (0.1, 0.18),
        (1.0, 1.1), (0.11, 0.17), (0.27, 0.34), (0.9, 0.95), (0.955, 0.975), (0.31, 0.35),
        (0.08, 0.14),
    ),
    "retro": (
        (3.3, 4.1), (1.55, 1.7), (1.42, 1.54), (0.17, 0.22), (0.72, 0.84), (0.12, 0.2),
        (0.8, 0.92), (0.28, 0.34), (0.38, 0.44), (0.6, 0.7), (0.8, 0.92), (0.29, 0.33),
        (0.12, 0.2),
    ),
    "roadster": (
        (3.7, 4.4), (1.66, 1.86), (1.2, 1.3), (0.13, 0.17), (0.68, 0.76), (0.14, 0.22),
        (0.84, 0.94), (0.36, 0.44), (0.45, 0.5), (0.58, 0.62), (0.66, 0.74), (0.3, 0.34),
        (0.1, 0.2),
    ),
}
# fmt: on
KINDS = tuple(RANGES)
WEIGHTS = np.array([0.16, 0.14, 0.10, 0.14, 0.12, 0.09, 0.08, 0.08, 0.09])


def build(seed: int) -> Mesh:
    """Return the car of a seed, a Mesh of category "car"."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAMILY_KEY,)))
    kind = KINDS[int(rng.choice(len(KINDS), p=WEIGHTS))]
    form = draw_form(rng, kind)
    a = Assembly()
    a.add("body", lower_body(form), PAINT)
    if kind == "roadster":
        cockpit(a, rng, form)
    else:
        glasshouse, glass = cabin(form)
        a.add("cabin", glasshouse, np.where(glass, DARK, PAINT))
    wheels(a, rng, form)
    lights(a, rng, form)
    front(a, rng, form)
    mirrors_and_handles(a, rng, form)
    seams(a, form)
    roof_details(a, rng, form, kind)
    return a.finish(f"car:{seed}", "car")


def draw_form(rng: np.random.Generator, kind: str) -> Form:
    """Return the form of one car of a kind."""
    (
        length,
        width,
        height,
        clearance,
        nose,
        rise,
        tail,
        cowl,
        roof_front,
        roof_rear,
        glass_rear,
        wheel,
        tumblehome,
    ) = (rng.uniform(*span) for span in RANGES[kind])
    ahead = rng.uniform(0.155, 0.195) if kind != "van" else rng.uniform(0.17, 0.2)
    behind = rng.uniform(0.77, 0.82) if kind != "pickup" else rng.uniform(0.74, 0.78)

    def place(share):
        return length * (0.5 - share)

    corners = {"retro": (3.2, 4.2), "suv": (5.0, 9.0), "pickup": (7.0, 11.0), "van": (6.0, 10.0)}
    corner = rng.uniform(*corners.get(kind, (4.2, 6.5)))
    bed = (place(0.972), place(glass_rear + 0.022)) if kind == "pickup" else None
    if kind == "roadster":
        bed = (place(glass_rear), place(cowl) - 0.12)
    shoulder = rng.uniform(2.6, 3.0) if kind == "retro" else rng.uniform(3.2, 5.5)
    form = Form(
        length=length,
        width=width,
        height=height,
        clearance=clearance,
        nose=nose,
        cowl=nose + rise,
        tail=tail,
        cowl_at=place(cowl),
        roof_front_at=place(roof_front),
        roof_rear_at=place(roof_rear),
        glass_rear_at=place(glass_rear),
        axles=(place(ahead), place(behind)),
        wheel=wheel,
        corner=corner,
        shoulder=shoulder,
        tumblehome=tumblehome,
        bow=rng.uniform(0.08, 0.2),
        bed=bed,
        bed_floor=-0.28 if kind == "roadster" else 0.02,
    )
    while form.arch < 1.08 * form.wheel:  # a low bonnet leaves room for smaller wheels only
        form = replace(form, wheel=0.98 * form.wheel)
    return form
