"""Rendered pictures of objects as if they were painted, in colours that no catalogue has.

Dye multiplies what the widest lobe of a material reflects, which is its matte part, by at most 1 in
each channel; highlights keep their colour, as those of lacquer do. A material without a matte part,
as metals are, is tinted as a whole. The picture is then that of a material with lower lobes, but
for what the object reflects into itself. Printed dye differs between points.
"""

from __future__ import annotations

import colorsys
import zlib

import numpy as np
import torch

from learn.data import patterns
from learn.data.records import Sample
from learn.layer import predictions

NONE, COLOUR, PRINT = "as it was", "one colour", "a print"
KINDS = (NONE, COLOUR, PRINT)
SATURATION = (0.5, 0.95)  # of one colour: our choice; photographs' oranges and reds have this
DISPLAY_GAMMA = 2.2


def painted(kind: str, sample: Sample, name: str) -> np.ndarray:
    """Return the radiance (H, W, 3) of a sample's object, of one material, when it is painted.

    kind  of KINDS
    name  by which colours and print are drawn
    """
    radiance = sample.image.numpy()
    if kind == NONE:
        return radiance
    dye = dye_of(kind, sample.n.numpy(), name)
    return radiance * (1 + matte_share(sample) * (dye - 1))


def matte_share(sample: Sample) -> np.ndarray:
    """Return the share (H, W, 3) of an object's radiance that dye colours, 0 beyond the object.

    It is that of direct light; 1 where the material has no matte part.
    """
    inside, label = sample.mask.numpy(), sample.label[0].numpy()
    if not patterns.can_be_dyed(label):
        return np.broadcast_to(inside[..., None], sample.image.shape).astype(np.float32)
    whole, matte = (
        predictions.picture(
            sample.n.movedim(-1, 0)[None],
            torch.from_numpy(of)[None, None],
            sample.light.movedim(-1, 0)[None],
            torch.from_numpy(inside.astype(np.int64))[None],
            sample.elevation,
            predictions.SHOWN,
        )[0].numpy()
        for of in (label, patterns.widest_lobe(label))
    )
    return np.clip(matte / np.maximum(whole, 1e-6), 0, 1) * inside[..., None]


def dye_of(kind: str, n: np.ndarray, name: str) -> np.ndarray:
    """Return the factors (H, W, 3) of a dye, COLOUR or PRINT, on an object.

    n     (H, W, 3) normals in the camera frame, 0 beyond the object
    name  by which it is drawn
    """
    rng = np.random.default_rng(zlib.crc32(f"{kind} {name}".encode()))
    if kind == COLOUR:
        hue, saturation = rng.random(), rng.uniform(*SATURATION)
        return np.broadcast_to(_linear(hue, saturation, 1.0), n.shape)
    inside = (n != 0).any(-1)
    segments = torch.from_numpy(inside.astype(np.int64))[None]
    points = patterns.surface_points(torch.from_numpy(n)[None], segments)[0]
    factor = np.ones(n.shape, np.float32)
    for weight in patterns.cover(rng, points, n, inside):
        ink = _linear(rng.random(), rng.uniform(0, 1), rng.uniform(0.15, 1))
        factor += weight[..., None] * (ink - 1)
    return factor


def _linear(hue: float, saturation: float, value: float) -> np.ndarray:
    """Return a colour (3,) float32 of display values as a factor on radiance."""
    shown = colorsys.hsv_to_rgb(float(hue), float(saturation), float(value))
    return (np.array(shown) ** DISPLAY_GAMMA).astype(np.float32)
