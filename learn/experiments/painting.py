"""Rendered pictures of objects as if they were painted, in colours that no catalogue has.

Paint multiplies what a surface reflects by at most 1 in each channel. The picture is then that of a
material with lower lobes, exactly so but for what the object reflects into itself; printed paint
differs between points. Labels of what an object is edited into are not touched.
"""

from __future__ import annotations

import colorsys
import zlib

import numpy as np
import torch

from learn.data import patterns

NONE, COLOUR, PRINT = "as it was", "one colour", "a print"
KINDS = (NONE, COLOUR, PRINT)
SATURATION = (0.5, 0.95)  # of one colour: our choice; photographs' oranges and reds have this
DISPLAY_GAMMA = 2.2


def painted(kind: str, radiance: np.ndarray, n: np.ndarray, name: str) -> np.ndarray:
    """Return the radiance (H, W, 3) of an object that is painted.

    kind      of KINDS
    radiance  (H, W, 3); n (H, W, 3) normals in the camera frame, 0 beyond the object
    name      by which colours and print are drawn
    """
    rng = np.random.default_rng(zlib.crc32(f"{kind} {name}".encode()))
    if kind == NONE:
        return radiance
    if kind == COLOUR:
        hue, saturation = rng.random(), rng.uniform(*SATURATION)
        return radiance * _linear(hue, saturation, 1.0)
    inside = (n != 0).any(-1)
    segments = torch.from_numpy(inside.astype(np.int64))[None]
    points = patterns.surface_points(torch.from_numpy(n)[None], segments)[0]
    factor = np.ones_like(radiance)
    for weight in patterns.cover(rng, points, n, inside):
        ink = _linear(rng.random(), rng.uniform(0, 1), rng.uniform(0.15, 1))
        factor += weight[..., None] * (ink - 1)
    return radiance * factor


def _linear(hue: float, saturation: float, value: float) -> np.ndarray:
    """Return a colour (3,) float32 of display values as a factor on radiance."""
    shown = colorsys.hsv_to_rgb(float(hue), float(saturation), float(value))
    return (np.array(shown) ** DISPLAY_GAMMA).astype(np.float32)
