"""Layers for light maps, whose left and right edges meet, and whose rows end at the two poles.

A convolution that pads a map with zeros sees a dark frame, and predicts maps with a frame.

x  (B, C, H, W) features of a map: row 0 at the upper pole, columns along the azimuth, W even
"""

import torch
from torch import nn
from torch.nn import functional as F


def pad(x: torch.Tensor) -> torch.Tensor:
    """Return a map with one more row or column at each edge, (B, C, H + 2, W + 2).

    Columns continue around the circle. The row beyond a pole is the row next to the pole, turned by
    half a circle.
    """
    half = x.shape[-1] // 2
    beyond = [x[:, :, row].roll(half, -1)[:, :, None] for row in (0, -1)]
    x = torch.cat([beyond[0], x, beyond[1]], 2)
    return torch.cat([x[..., -1:], x, x[..., :1]], 3)


def enlarge(x: torch.Tensor) -> torch.Tensor:
    """Return a map with twice as many rows and columns, interpolated linearly."""
    larger = F.interpolate(pad(x), scale_factor=2.0, mode="bilinear")
    return larger[:, :, 2:-2, 2:-2]


class MapConvolution(nn.Conv2d):
    """A 3 × 3 convolution of a map."""

    def __init__(self, before: int, after: int, bias: bool = True):
        super().__init__(before, after, 3, bias=bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return features (B, after, H, W)."""
        return super().forward(pad(x))


def map_convolution(before: int, after: int) -> nn.Sequential:
    """Return a MapConvolution with normalisation and ReLU."""
    return nn.Sequential(
        MapConvolution(before, after, bias=False), nn.BatchNorm2d(after), nn.ReLU(inplace=True)
    )
