"""The panel of a screen: a casing with a screen let into it.

Metres; the screen faces +x. Segment SCREEN shows the picture, CASE is everything else.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import Surface
from factory.shapes.lofts import loft

SCREEN, CASE = 1, 2
Piece: TypeAlias = tuple[Surface, int]


def rounded_rectangle(
    wide: float, high: float, radius: float, steps: int = 6, along: int = 12
) -> np.ndarray:
    """Return the outline (N, 2) of a rectangle with rounded corners, in the y–z plane.

    Straight runs are subdivided so that they can be bent.
    """
    points: list[np.ndarray] = []
    radius = min(radius, 0.49 * min(wide, high))
    for k, (sy, sz) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = np.linspace(k * np.pi / 2, (k + 1) * np.pi / 2, steps + 1)
        arc = np.stack(
            [
                sy * (wide / 2 - radius) + radius * np.cos(angle),
                sz * (high / 2 - radius) + radius * np.sin(angle),
            ],
            1,
        )
        if points:
            points += list(
                points[-1] + np.linspace(0, 1, along + 1)[1:-1, None] * (arc[0] - points[-1])
            )
        points += list(arc)
    return np.array(
        points
        + list(points[-1] + np.linspace(0, 1, along + 1)[1:-1, None] * (points[0] - points[-1]))
    )


def panel(
    wide: float,
    high: float,
    *,
    thick: float,
    bezel: float,
    chin: float = 0.0,
    radius: float = 0.01,
    bulge: float = 0.0,
    recess: float = 0.003,
    crown: float = 0.0,
) -> list[Piece]:
    """Return a casing and the screen let into its front, as [(Surface, segment)].

    The front is at x = 0, centred on the whole casing.

    chin   how much wider the lower bezel is
    bulge  m that the middle of the back stands out
    crown  m that a tube's screen bulges
    """
    full, inner = (
        rounded_rectangle(wide, high, radius),
        rounded_rectangle(wide - 2 * bezel, high - 2 * bezel - chin, max(radius - bezel, 0.003)),
    )
    inner[:, 1] += chin / 2
    bevel = min(0.35 * thick, 0.006, 0.6 * bezel)

    def ring(outline, share, x, centre=(0.0, 0.0)):
        flat = np.asarray(centre) + (outline - centre) * share
        return np.column_stack([np.full(len(flat), x), flat])

    def inset(outline, d):
        return outline * (1 - 2 * d / np.array([wide, high]))

    rings = [
        ring(inset(full, bevel * (1 - np.sin(t))), 1.0, -thick + bevel * (1 - np.cos(t)))
        for t in np.linspace(0, np.pi / 2, 4)
    ]
    back = (
        [
            ring(full, share, -thick - bulge * (1 - share**4) ** 0.7)
            for share in (0.05, 0.35, 0.6, 0.8, 0.93)
        ]
        if bulge
        else [ring(full, 0.3, -thick), ring(full, 0.7, -thick)]
    )
    front = [
        ring(inset(full, bevel * (1 - np.cos(t))), 1.0, -bevel * (1 - np.sin(t)))
        for t in np.linspace(0, np.pi / 2, 4)
    ]
    floor = recess + min(0.4 * thick, 0.008)
    face = [ring(inner, 1.0, 0.0), ring(inner, 1.0, -floor)]
    shares = (1.0, 0.86, 0.7, 0.5, 0.3, 0.12)
    middle = inner.mean(0)
    lowered = [ring(inner, s, -floor, middle) for s in shares[1:]]
    case = loft(np.array(back + rings + front + face + lowered))

    def plate(share, x, rise):
        """Return one ring of the screen; a tube's screen is a dome in both directions."""
        points = ring(inner, share * 0.999, x, middle)
        across = (points[:, 1:] - middle) / np.ptp(inner, axis=0) * 2
        points[:, 0] += rise * np.prod(1 - across**2, axis=1)
        return points

    # The screen: a thin plate in the recess, its edge hidden in the casing
    glass = [plate(s, -floor + 0.001, 0.0) for s in shares[::-1]] + [
        plate(s, -recess, crown) for s in shares
    ]
    return [(case, CASE), (loft(np.array(glass)), SCREEN)]


def add_panel(a: Assembly, pieces: Sequence[Piece], place: Callable[[Surface], Surface]) -> None:
    """Add a panel's casing and screen, each through the function `place`."""
    for surface, segment in pieces:
        a.add("screen" if segment == SCREEN else "casing", place(surface), segment)


def bend(surface: Surface, radius: float) -> Surface:
    """Return the surface bent about a vertical axis `radius` m in front: a curved monitor."""
    x, y, z = surface.vertices.T
    angle, reach = y / radius, radius - x
    return Surface(
        np.stack([radius - reach * np.cos(angle), reach * np.sin(angle), z], 1), surface.faces
    )


def draw_panel(
    rng: np.random.Generator, diagonal: float, aspect: float, **fixed: float
) -> tuple[float, float, list[Piece]]:
    """Return width, height and a panel of a diagonal and an aspect."""
    wide, high = diagonal * aspect / np.hypot(aspect, 1), diagonal / np.hypot(aspect, 1)
    thin = rng.random() < 0.5
    options = dict(
        thick=rng.uniform(0.012, 0.022) if thin else rng.uniform(0.03, 0.055),
        bezel=rng.uniform(0.005, 0.012) if thin else rng.uniform(0.014, 0.032),
        chin=rng.choice([0.0, rng.uniform(0.008, 0.03)]),
        radius=rng.uniform(0.004, 0.022),
        bulge=rng.choice([0.0, rng.uniform(0.015, 0.04)]),
    )
    return wide, high, panel(wide, high, **{**options, **fixed})
