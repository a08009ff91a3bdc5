"""Codes of pictures, materials and light, as networks take and give them.

image   (B, 3, H, W) linear radiance I  →  log(1 + 8 I)/log 9 − ½ inside the mask, 0 outside: half
        of the range is below I = ¼
label   (B, S, 108) natural logarithms  →  code in (−1, 1): ±REACH at the ends of the training
        materials' range, so that tanh reaches them
light   (B, 3, Hl, Wl) linear radiance L ≥ 0  →  log(1 + L)
"""

import math
from dataclasses import dataclass

import torch

from shaders.arrays import like
from shaders.dsbrdf import SIZE
from shaders.tone import LUMINANCE

REACH = 0.95
BRIGHTNESS = 8.0
LARGEST_LOG_LIGHT = 11.0  # log(1 + 6e4): half floats end there
LARGEST_KAPPA = 4.4  # logarithm of κ: exp of κ itself must be finite; the catalogue's go up to 2.2
SMALLEST_LABEL = -80.0  # its exp is a float32 above 0
NARROWEST = 1e-3  # of a label's range, where all training materials agree


def compress(image: torch.Tensor) -> torch.Tensor:
    """Return log(1 + 8 I)/log 9 of linear radiance ≥ 0; losses compare pictures by it too."""
    return torch.log1p(BRIGHTNESS * image.clamp(min=0)) / math.log(1 + BRIGHTNESS)


def picture_code(image: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return (B, 4, H, W): the picture compressed and centred, and the mask − ½."""
    return torch.cat([(compress(image) - 0.5) * mask, mask - 0.5], 1)


@dataclass(frozen=True)
class Ranges:
    """Centre and half range (108,) of the training materials' labels, margin included."""

    centre: torch.Tensor
    half: torch.Tensor

    @classmethod
    def of(cls, labels: torch.Tensor, margin: float = 0.05) -> "Ranges":
        """Return the ranges of labels (M, 108), widened by `margin` at each end.

        They are the same for the three channels, which augmentation permutes.
        """
        by_channel = labels.reshape(-1, 3, SIZE // 3)
        low, high = by_channel.amin((0, 1)), by_channel.amax((0, 1))
        half = ((high - low) * (0.5 + margin)).clamp(min=NARROWEST)
        return cls(((high + low) / 2).repeat(3), half.repeat(3))

    def code(self, label: torch.Tensor) -> torch.Tensor:
        """Return the code of a label; outside the range it lies outside ±REACH."""
        return (label - self.centre) / self.half * REACH

    def label(self, code: torch.Tensor) -> torch.Tensor:
        """Return the label of a code."""
        return code / REACH * self.half + self.centre


def decode_light(code: torch.Tensor) -> torch.Tensor:
    """Return L of log(1 + L), clamped to the range of half floats."""
    return torch.expm1(code.clamp(0, LARGEST_LOG_LIGHT))


def unit_mean(light: torch.Tensor, solid_angle: torch.Tensor) -> torch.Tensor:
    """Return maps (B, 3, Hl, Wl) scaled to a mean luminance of 1 over the sphere.

    This fixes light's scale, which a picture alone cannot tell from the material's.

    solid_angle  (Hl,) of a texel of each row
    """
    weight = solid_angle / (solid_angle.sum() * light.shape[-1])
    luminance = torch.einsum("bchw,c,h->b", light, like(LUMINANCE, light), weight.to(light))
    return light / luminance.clamp(min=1e-6)[:, None, None, None]
