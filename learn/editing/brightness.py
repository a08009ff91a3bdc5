"""Mirror-like materials are rendered too bright by predicted normals and light: a correction.

A network predicts the mean of the normals and lights that a picture may have. What a matte surface
shows of them is a mean over half the sphere, and comes out as bright as it should. A mirror shows
single directions, most of which are darker than the mean. How much brighter an edit is than its
truth therefore follows the part of the material's albedo that lies in narrow lobes
(`python -m learn.experiments photographed-edits`).
"""

import numpy as np
import torch

from learn.layer.albedo import lobe_albedos
from shaders.dsbrdf import MAX_EXPONENT, SHAPE, lobe_sharpness
from shaders.tone import LUMINANCE

STOPS = 0.8  # by which a material of nothing but narrow lobes is too bright, by that experiment
HALF = 10.0  # sharpness of a lobe of which half counts as narrow; 3 and 30 explain as much


def narrow_share(label: np.ndarray) -> float:
    """Return the share, 0 to 1, of a material's albedo that lies in narrow lobes.

    label  (108,) natural logarithms
    """
    lobes = torch.as_tensor(np.asarray(label, np.float64).reshape(-1))
    kappa, gamma = np.exp(lobes.numpy()).reshape(SHAPE)[..., 0].transpose(2, 0, 1)
    sharpness = lobe_sharpness(np.minimum(kappa, MAX_EXPONENT), gamma)
    albedo = lobe_albedos(lobes).numpy() * np.asarray(LUMINANCE)[:, None]
    return float((albedo * sharpness / (sharpness + HALF)).sum() / max(albedo.sum(), 1e-9))


def factor(label: np.ndarray) -> float:
    """Return the factor by which radiance in a target material (108,) is multiplied."""
    return float(2 ** (-STOPS * narrow_share(label)))
