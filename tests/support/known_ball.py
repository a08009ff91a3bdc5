"""Photographs of a ball, and a network that knows what is in them."""

import numpy as np
import torch
import torch.nn.functional as F

from learn.editing import photograph
from learn.layer import render
from learn.networks.prediction import Prediction
from manifests.materials import load_catalogue

SIZE, NETWORK = 96, 64


def label_of(name):
    """The label (1, 108) float32 that an edit into a material of the catalogue uses."""
    return load_catalogue()[name].calibrated_label.reshape(1, 108).astype(np.float32)


def ball(side, radius):
    """Normals (side, side, 3) of a ball in the middle of a picture, and its mask."""
    at = (np.arange(side) + 0.5 - side / 2) / radius
    x, y = np.meshgrid(at, -at)
    inside = x * x + y * y < 1
    z = np.sqrt(np.clip(1 - x * x - y * y, 1e-3, 1))
    n = np.stack([x, y, z], -1)
    return (n / np.linalg.norm(n, axis=-1, keepdims=True) * inside[..., None]).astype(
        np.float32
    ), inside


class Knowing(torch.nn.Module):
    """A network that says of every picture: a ball in its mask's square, of the given material, in
    even light.
    """

    def __init__(self, label):
        super().__init__()
        self.label = torch.from_numpy(label)

    def forward(self, image, mask, segments=None, regions=None):
        _, rows, _ = torch.nonzero(mask[:, 0], as_tuple=True)
        radius = (rows.max() - rows.min() + 1).item() / 2
        n, _ = ball(len(image[0, 0]), radius)
        x = torch.from_numpy(n).movedim(-1, 0)[None]
        x = torch.where(mask > 0, x, torch.tensor([0.0, 0.0, 1.0])[:, None, None])
        count = 1 if segments is None else regions
        light = torch.ones(1, 3, 64, 128)
        return Prediction(
            F.normalize(x + torch.tensor([0, 0, 1e-6])[:, None, None], dim=1),
            None,
            self.label.repeat(1, count, 1),
            None,
            light,
        )


def lit(label, scale):
    """A ball's picture (SIZE, SIZE, 3) in even light before a gradient, and its mask."""
    n, inside = ball(SIZE, 30)
    light = torch.ones(1, 64, 128, 3)
    radiance = (
        render(torch.from_numpy(n)[None], torch.from_numpy(label).exp(), light, method="exact")[
            0
        ].numpy()
        * scale
    )
    ground = np.linspace(0.1, 0.4, SIZE, dtype=np.float32)[:, None, None] * np.array(
        [1.0, 0.8, 0.6], np.float32
    )
    return np.where(inside[..., None], radiance, ground).astype(np.float32), inside


def opened(radiance, regions, exposure=None, balance=(1, 1, 1), cut_out=False):
    coverage = (regions > 0).astype(np.float32)
    return photograph.Photograph(
        "ball", radiance, coverage, regions, np.array(balance, np.float32), exposure, cut_out
    )
