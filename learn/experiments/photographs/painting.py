"""Rendered pictures of objects as if they were painted, in colours that no catalogue has.

Dye multiplies what the widest lobe of a material reflects, which is its matte part, by at most 1 in
each channel; highlights keep their colour, as those of lacquer do. A material without a matte part,
as metals are, is tinted as a whole. The picture is then that of a material with lower lobes, but
for what the object reflects into itself. Printed dye differs between points. With a label, dye of
one colour leaves a rectangle undyed, on which black bars are printed.
"""

from __future__ import annotations

import colorsys
import zlib

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from learn.data import patterns
from learn.data.records import Sample
from learn.layer import predictions

NONE, COLOUR, PRINT, LABEL = "as it was", "one colour", "a print", "a colour with a label"
KINDS = (NONE, COLOUR, PRINT, LABEL)
SATURATION = (0.5, 0.95)  # of one colour: our choice; photographs' oranges and reds have this
DISPLAY_GAMMA = 2.2
LENGTHS, HEIGHTS = (0.24, 0.5), (0.12, 0.3)  # of a label; the object's area is 1
BAR, BLACK = 0.06, 0.08  # pitch of the bars that are printed on it, and their dye


def painted(kind: str, sample: Sample, name: str) -> np.ndarray:
    """Return the radiance (H, W, 3) of a sample's object, of one material, when it is painted.

    kind  of KINDS
    name  by which colours and print are drawn
    """
    radiance = sample.image.numpy()
    if kind == NONE:
        return radiance
    if kind == LABEL:
        dye = dye_with_label(sample.label[0].numpy(), sample.n.numpy(), name)
    else:
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
    for weight in patterns.draw_pattern(rng, points, n, inside):
        ink = _linear(rng.random(), rng.uniform(0, 1), rng.uniform(0.15, 1))
        factor += weight[..., None] * (ink - 1)
    return factor


def dye_with_label(material: np.ndarray, n: np.ndarray, name: str) -> np.ndarray:
    """Return the factors (H, W, 3) of a dye of one colour that leaves out a label with black bars.

    The label is grey, and as bright as its material's darkest channel.

    material  (108,) of the object; n and name as `dye_of` takes them
    """
    rng = np.random.default_rng(zlib.crc32(f"{LABEL} {name}".encode()))
    inside = (n != 0).any(-1)
    dye = np.array(dye_of(COLOUR, n, name))
    if not inside.any():
        return dye
    rows, columns = np.nonzero(inside)
    candidates = rng.integers(len(rows), size=8)
    depth = distance_transform_edt(inside)[rows, columns]
    middle = candidates[depth[candidates].argmax()]
    size, angle = np.sqrt(inside.sum()), rng.uniform(0, np.pi)
    y, x = np.mgrid[: len(n), : n.shape[1]]
    right, down = (x - columns[middle]) / size, (y - rows[middle]) / size
    along = np.cos(angle) * right + np.sin(angle) * down
    across = np.cos(angle) * down - np.sin(angle) * right
    length, height = rng.uniform(*LENGTHS) / 2, rng.uniform(*HEIGHTS) / 2
    on = (abs(along) < length) & (abs(across) < height)
    bars = (abs(along) < 0.6 * length) & (abs(across) < 0.6 * height)
    bars &= np.floor(along / (BAR / 2)) % 2 == 0
    whole, widest = (each[0] for each in patterns.albedos(material[None]))
    albedo = widest if patterns.can_be_dyed(material) else whole
    dye[on] = albedo.min() / albedo
    dye[bars] *= BLACK
    return dye


def _linear(hue: float, saturation: float, value: float) -> np.ndarray:
    """Return a colour (3,) float32 of display values as a factor on radiance."""
    shown = colorsys.hsv_to_rgb(float(hue), float(saturation), float(value))
    return (np.array(shown) ** DISPLAY_GAMMA).astype(np.float32)
