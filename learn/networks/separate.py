"""Baseline 2 of Section 4.5: three networks, each trained by its own L2 loss, without the layer.

Each has its own encoder, of the compact network's family, and reads the masked picture alone. There
is no reflectance map, which would give the normals' result to the other two. They are in one module
because they see the same batches; they share no weights, and no gradient passes between them.

B pictures, S segments; features of widths WIDTHS at H/2, H/4, H/8, H/16. Material and light begin
at H/4, with pixels rearranged into channels, for they need no sharp edges; that saves two thirds of
their cost.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional as F

from learn.networks.coding import Ranges
from learn.networks.compact import LIGHT_WIDTHS, Residual, convolution
from learn.networks.prediction import ThreeNetworks

WIDTHS = (32, 64, 128, 192)
CELLS = 4  # along a side of the features that the two heads read, which keep the place roughly
HIDDEN = 256


class Encoder(nn.Module):
    """Features of a picture code (B, 4, H, W), one size for each width: H/first, H/(2 first), …"""

    def __init__(self, widths: Sequence[int] = WIDTHS, first: int = 2):
        super().__init__()
        self.first = first
        before = (4 * first**2, *widths)
        self.down = nn.ModuleList(
            convolution(a, b, 1 if i == 0 else 2) for i, (a, b) in enumerate(pairwise(before))
        )
        self.deepen = nn.ModuleList(Residual(width) for width in widths)

    def forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        """Return features (B, width, h, w), the finest first."""
        features, x = [], F.pixel_unshuffle(x, self.first)
        for down, deepen in zip(self.down, self.deepen, strict=True):
            x = deepen(down(x))
            features.append(x)
        return features


class Decoder(nn.Module):
    """Three channels at the picture's size, from features at all four sizes."""

    def __init__(self, widths: Sequence[int] = WIDTHS):
        super().__init__()
        self.up = nn.ModuleList(convolution(a + b, a) for a, b in pairwise(widths))
        self.last = nn.Conv2d(widths[0], 12, 3, 1, 1)

    def forward(self, features: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return (B, 3, H, W) of an Encoder's features."""
        x = features[-1]
        for up, beside in zip(reversed(self.up), reversed(features[:-1]), strict=True):
            x = up(torch.cat([beside, F.interpolate(x, scale_factor=2.0)], 1))
        return F.pixel_shuffle(self.last(x), 2).float()


def make_head(outputs: int) -> nn.Sequential:
    """Return layers from the deepest features to `outputs` numbers.

    One more halving, CELLS² cells, two fully connected layers with dropout.
    """
    return nn.Sequential(
        convolution(WIDTHS[-1], 128, 2),
        nn.AdaptiveAvgPool2d(CELLS),
        nn.Flatten(),
        nn.Linear(128 * CELLS * CELLS, HIDDEN),
        nn.ReLU(),
        nn.Dropout(0.1),
        nn.Linear(HIDDEN, outputs),
    )


class Separate(ThreeNetworks):
    """Normals, material and light of masked pictures by three networks."""

    name = "separate"

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        self.normals = nn.ModuleList([Encoder(), Decoder()])
        self.material = nn.ModuleList([Encoder(WIDTHS[1:], 4), make_head(108)])
        self.light = nn.ModuleList([Encoder(WIDTHS[1:], 4), make_head(LIGHT_WIDTHS[0] * 32)])
        self.widen = nn.ModuleList(convolution(a, b) for a, b in pairwise(LIGHT_WIDTHS))
        self.last = nn.Conv2d(LIGHT_WIDTHS[-1], 12, 3, 1, 1)

    def _normals(self, x):
        encode, decode = self.normals
        return decode(encode(x))

    def _code(self, x):
        encode, read = self.material
        return read(encode(x)[-1])

    def _light(self, x):
        encode, read = self.light
        x = F.relu(read(encode(x)[-1])).reshape(-1, LIGHT_WIDTHS[0], 4, 8)
        for widen in self.widen:
            x = widen(F.interpolate(x, scale_factor=2.0, mode="bilinear"))
        return F.pixel_shuffle(self.last(x), 2)
