"""The paper's three networks (Section 3.2 and its supplement), with layer widths of our own.

normals   Eigen and Fergus' multi-scale network: a coarse scale that sees the whole picture through
          two fully connected layers, two that refine it, a fourth of two convolutions at full size,
          then unit length
light     7 halving convolutions, 2 fully connected layers, each with dropout, deconvolutions to
          64×128
material  7 halving convolutions, 3 fully connected layers, tanh, 108 outputs; dropout follows the
          first two, since after the last one it would set coefficients to the middle of their range

Weights start uniform in ±0.08. In a deep network that alone would let activations grow or vanish,
so batch normalisation follows each convolution: ours.
"""

from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional as F

from learn.networks.coding import Ranges
from learn.networks.compact import convolution
from learn.networks.prediction import ThreeNetworks

HALVINGS = (32, 64, 128, 256, 256, 512, 512)
START = 0.08
COARSE = 8  # height and width of what the fully connected layers of the coarse scale read
COARSE_CODE = 512  # Eigen and Fergus: 4096, which would take 75 million weights more
COARSE_WIDTH = 64  # channels of the coarse scale's map, twice COARSE high and wide


def _halving():
    """(B, 4, 256, 256) → (B, 512 · 2 · 2)."""
    widths = (4, *HALVINGS)
    return nn.Sequential(
        *(convolution(a, b, 2) for a, b in pairwise(widths)), nn.AdaptiveAvgPool2d(2), nn.Flatten()
    )


def _deconvolution(before, after):
    return nn.Sequential(
        nn.ConvTranspose2d(before, after, 4, 2, 1, bias=False),
        nn.BatchNorm2d(after),
        nn.ReLU(inplace=True),
    )


class Scale(nn.Module):
    """One refining scale, which reads the coarser scale's result and the picture at this size."""

    def __init__(self, before: int, width: int):
        super().__init__()
        self.layers = nn.Sequential(
            convolution(before + 4, width), convolution(width, width), convolution(width, width)
        )

    def forward(
        self, x: torch.Tensor, picture: torch.Tensor, size: tuple[int, int]
    ) -> torch.Tensor:
        """Return features (B, width, *size) of coarser ones and a picture code."""
        return self.layers(
            torch.cat(
                [
                    F.interpolate(x, size, mode="bilinear"),
                    F.interpolate(picture, size, mode="area"),
                ],
                1,
            )
        )


class Paper(ThreeNetworks):
    """Normals, material and light of masked pictures by the paper's networks."""

    name = "paper"

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        drop = lambda: nn.Dropout(0.5)  # noqa: E731 -- one per place
        self.coarse = nn.Sequential(
            convolution(4, 48, 2),
            convolution(48, 96, 2),
            convolution(96, 192, 2),
            convolution(192, 256, 2),
            convolution(256, 256, 2),
            nn.AdaptiveAvgPool2d(COARSE),
            nn.Flatten(),
            nn.Linear(256 * COARSE**2, COARSE_CODE),
            nn.ReLU(),
            drop(),
            nn.Linear(COARSE_CODE, COARSE_WIDTH * 4 * COARSE**2),
            nn.ReLU(),
            nn.Unflatten(1, (COARSE_WIDTH, 2 * COARSE, 2 * COARSE)),
        )
        self.second, self.third = Scale(COARSE_WIDTH, 96), Scale(96, 64)
        self.fourth = nn.Sequential(
            nn.Conv2d(64 + 4, 32, 3, 1, 1), nn.ReLU(inplace=True), nn.Conv2d(32, 3, 3, 1, 1)
        )
        self.material = nn.Sequential(
            _halving(),
            nn.Linear(2048, 1024),
            nn.ReLU(),
            drop(),
            nn.Linear(1024, 512),
            nn.ReLU(),
            drop(),
            nn.Linear(512, 108),
        )
        self.illumination = nn.Sequential(
            _halving(),
            nn.Linear(2048, 1024),
            nn.ReLU(),
            drop(),
            nn.Linear(1024, 128 * 32),
            nn.ReLU(),
            drop(),
        )
        self.light = nn.Sequential(
            *(_deconvolution(a, b) for a, b in ((128, 96), (96, 64), (64, 32))),
            nn.ConvTranspose2d(32, 3, 4, 2, 1),
        )
        for parameter in self.parameters():
            if parameter.ndim > 1:
                nn.init.uniform_(parameter, -START, START)

    def _normals(self, x):
        H, W = x.shape[-2:]
        y = self.third(self.second(self.coarse(x), x, (H // 8, W // 8)), x, (H // 4, W // 4))
        return self.fourth(torch.cat([F.interpolate(y, (H, W), mode="bilinear"), x], 1))

    def _code(self, x):
        return self.material(x)

    def _light(self, x):
        return self.light(self.illumination(x).reshape(-1, 128, 4, 8))
