"""Fixed scenes on which each method's card is measured, and scenes where methods break."""

import math

import numpy as np
import torch

from learn import methods
from shaders import envmap
from shaders.frames import view_vectors

UNIT = torch.nn.functional.normalize
SIZE = (24, 48)


def names_for_a_view_per_pixel():
    """The methods that render perspective. test_cards.py sees the others refuse it."""
    return [name for name in methods.NAMES if "orthographic" not in methods.load(name).CARD.needs]


def sphere(size=14, dtype=torch.float32):
    """Normals (1, size, size, 3) of a sphere that nearly fills the picture; 0 outside."""
    x = (torch.arange(size, dtype=torch.float64) + 0.5) / size * 2 - 1
    y, x = torch.meshgrid(-x, x, indexing="ij")
    z2 = 1 - (x * x + y * y) / 0.9
    n = torch.stack([x / math.sqrt(0.9), y / math.sqrt(0.9), z2.clamp(min=0).sqrt()], -1)
    return torch.where((z2 > 1e-3)[..., None], n, 0.0)[None].to(dtype)


def perspective(size=14, dtype=torch.float32):
    return torch.as_tensor(view_vectors(size, size, math.radians(30)), dtype=dtype)[None]


def material(kappas, gammas, dtype=torch.float32):
    """(1, 108): κ and γ of each lobe, κ a little different in each channel, γ rising by a fifth
    towards grazing θ_d.
    """
    m = torch.empty(3, 3, 2, 6, dtype=torch.float64)
    m[:, :, 0] = (
        torch.tensor(kappas, dtype=torch.float64)[:, None]
        * torch.tensor([1.0, 0.8, 0.6])[:, None, None]
    )
    m[:, :, 1] = torch.tensor(gammas, dtype=torch.float64)[:, None] * torch.linspace(1.0, 1.2, 6)
    return m.reshape(1, 108).to(dtype)


MATERIALS = {
    "matte": ((0.1, 0.05, 0.01), (0.01, 0.3, 1.0)),
    "satin": ((0.1, 0.3, 0.3), (0.2, 5.0, 25.0)),
    "glossy": ((0.05, 0.4, 1.0), (0.3, 20.0, 400.0)),
}


def light(name, dtype=torch.float32):
    """(1, *SIZE, 3) of solid-angle mean 1."""
    w, solid_angle = envmap.directions(*SIZE)
    if name == "sky":
        L = 0.3 + np.clip(w[..., 1:2], 0, 1) * [0.6, 0.8, 1.2] + 0.2 * np.sin(5 * w[..., :1]) ** 2
    elif name == "lamps":
        L = 0.05 + sum(
            np.exp(30 * (w @ a / np.linalg.norm(a) - 1))[..., None] * c
            for a, c in (((1, 1, 1), 5.0), ((-2, 1, 0), 3.0))
        )
        L = L * np.ones(3)
    else:  # a sun in one texel, with half of all light
        L = np.ones((*SIZE, 3))
        L[7, 10] = 4 * np.pi / solid_angle[7, 10]
    return torch.as_tensor(envmap.unit_mean(L)[0], dtype=dtype)[None]


LIGHTS = ("sky", "lamps", "sun")
