"""Removes the green or magenta cast of a predicted light, which real lights hardly ever have.

Lamps and skies are reddish or bluish, as black bodies are, but differ little from magenta to green.
Predicted lights do differ there. The material that was read has the opposite cast, so
that the object looks right in it and has the light's cast in every other material
(`python -m learn.experiments photographed-edits` measures both).
"""

from typing import TYPE_CHECKING

import numpy as np
import torch

from learn.data.devices import to_numpy
from shaders import envmap
from shaders.dsbrdf import scale_label
from shaders.tone import LUMINANCE

if TYPE_CHECKING:
    from learn.editing.decomposition import Parts

MOST = 1.0  # stops of green or magenta that are removed at most: a coloured lamp keeps the rest


def green_of(colour: np.ndarray) -> float:
    """Return how many stops greener than magenta a colour (3,), linear and above 0, is."""
    r, g, b = np.log2(colour)
    return float(g - (r + b) / 2)


def remove_green(parts: "Parts") -> "Parts":
    """Return parts of a batch of one whose light is neither green nor magenta on the whole.

    The mean luminance of the light stays, and the material takes on what the light loses.
    """
    mean = envmap.mean_radiance(to_numpy(parts.light[0].movedim(0, -1)))
    if not (mean > 0).all():
        return parts
    factor = 2 ** (np.array([1.0, -2.0, 1.0]) * np.clip(green_of(mean), -MOST, MOST) / 3)
    factor *= (mean @ LUMINANCE) / (mean * factor @ LUMINANCE)
    scale = torch.as_tensor(factor, dtype=parts.light.dtype, device=parts.light.device)
    return parts._replace(
        light=parts.light * scale[:, None, None], label=scale_label(parts.label, 1 / scale)
    )
