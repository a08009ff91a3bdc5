"""Seats of chairs, and the two segments that a chair has.

Metres; the seat faces +x.

w, d  the seat's width (y) and depth (x)
"""

import numpy as np

from factory.shapes.closed_surface import Surface
from factory.shapes.curves import superellipse
from factory.shapes.lofts import slab

SOFT, FRAME = 1, 2  # seat, back and cushions; the construction that carries them


def seat_outline(w: float, d: float, rear: float, square: float, around: int = 48) -> np.ndarray:
    """Return the outline (N, 2) of a seat seen from above.

    It is a superellipse whose rear is narrowed to the share `rear` of its front.
    """
    x, y = superellipse(around, square).T
    return np.stack([x * d / 2, y * w / 2 * (1 + rear + (1 - rear) * x) / 2], 1)


def soft_pad(
    w: float, d: float, thick: float, rear: float = 1.0, square: float = 4.5, dome: float = 0.02
) -> Surface:
    """Return an upholstered seat, its middle raised."""
    return slab(seat_outline(w, d, rear, square), thick, 0.95, dome, steps=5)
