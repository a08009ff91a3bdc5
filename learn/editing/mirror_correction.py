"""Darkens edits into mirror-like materials, which predicted normals and light make too bright.

A network predicts the mean of the normals and lights that a picture may have. What a matte surface
shows of them is a mean over half the sphere, and comes out as bright as it should. A mirror shows
single directions, most of which are darker than the mean. How much brighter an edit is than its
truth therefore follows the part of the material's albedo that lies in narrow lobes
(`python -m learn.experiments photographed-edits`).
"""

import numpy as np

from learn.layer.albedo import narrow_share

STOPS = 0.8  # by which a material of nothing but narrow lobes is too bright, by that experiment


def factor(label: np.ndarray) -> float:
    """Return the factor ≤ 1 that corrects radiance in a target material (108,)."""
    return float(2 ** (-STOPS * narrow_share(label)))
