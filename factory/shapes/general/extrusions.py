"""Outlines given depth: letters and digits, gears, stars, angle bars, free forms."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.general import fields
from factory.shapes.general.draws import (
    Generator,
    block_outline,
    log_uniform,
    round_outline,
    star_outline,
)
from factory.shapes.general.isosurface import surface_of

CHARACTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijkmnopqrstuvwxyz0123456789&?!@#"
FONTS = ("DejaVu Sans", "DejaVu Serif", "DejaVu Sans Mono")  # matplotlib brings them


def letter(a: Assembly, rng: Generator) -> None:
    """A letter, a digit or a sign with depth and bevelled edges; sometimes tapered or twisted."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    text = CHARACTERS[rng.integers(len(CHARACTERS))]
    font = FontProperties(
        family=str(rng.choice(FONTS)), weight=str(rng.choice(["normal", "bold"], p=[0.25, 0.75]))
    )
    polygons = TextPath((0, 0), text, size=1.0, prop=font).to_polygons()
    _extrude(a, rng, [np.asarray(polygon)[:-1] for polygon in polygons], thinnest=0.08)


def extrusion(a: Assembly, rng: Generator) -> None:
    """A gear, a star, an angle bar or a free form, with depth, bevels and perhaps holes."""
    kind = rng.choice(["star", "block", "round"], p=[0.35, 0.35, 0.3])
    if kind == "star":
        outline = star_outline(rng)
    elif kind == "block":
        outline = block_outline(rng)
    else:
        outline = round_outline(rng)
    outlines = [outline * [1.0, rng.uniform(0.6, 1.0)]]
    if rng.random() < 0.35:
        t = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        outlines.append(rng.uniform(0.12, 0.3) * np.stack([np.cos(t), np.sin(t)], 1))
    _extrude(a, rng, outlines, thinnest=0.2)


def _extrude(a, rng, outlines, thinnest):
    """Add the outlines with random depth. thinnest: of the outlines' strokes, as a share of 2."""
    corners = np.concatenate(outlines)
    low, high = corners.min(0), corners.max(0)
    scale = 1.7 / (high - low).max()
    outlines = [(outline - (low + high) / 2) * scale for outline in outlines]
    half_depth = log_uniform(rng, 0.08, 0.9)
    rounding = rng.uniform(0.1, 0.9) * min(thinnest / 2, 0.45 * half_depth)
    taper = rng.uniform(0, 0.5) if rng.random() < 0.25 else 0.0
    twist = rng.uniform(-1.0, 1.0) if rng.random() < 0.2 else 0.0
    field = fields.extruded(fields.Outline(outlines), half_depth, rounding, taper, twist)
    if rng.random() < 0.2:  # engraved into a plate, or raised from it
        plate = fields.moved(fields.box((0.12, 1.05, 1.05), 0.04), (-half_depth, 0, 0))
        field = fields.union([plate, field], 0.03)
    if taper or twist:
        field = fields.scaled_values(field, 1 / (1 + 0.6 * abs(twist) + 0.5 * taper))
    a.add("body", surface_of(field, 1.4), 1)
