"""Normals by a network of their own, material and light by the compact one.

A network that learns normals alone gives them all of its weights, and its encoder may be another
one: EfficientNet-Lite0, which has seen photographs (learn.networks.pretrained). Material and light
are read as by learn.networks.compact: from the picture, and from its pixels binned by the
predicted normals. Each network is trained by itself; learn.networks.joining makes one file of both.

B pictures, H, W multiples of 32.
"""

import torch

from learn.networks.coding import Ranges
from learn.networks.compact import CompactWrapped
from learn.networks.pretrained import CompactPretrained

OF_NORMALS = "of_normals"  # the module that predicts normals
NOT_OF_NORMALS = ("reflectance", "material", "illumination", "widen", "light", "narrow")
# modules of CompactPretrained that normals do not need; those of CompactWrapped that only they need
ONLY_OF_NORMALS = ("up", "normals")


class NormalsPretrained(CompactPretrained):
    """The part of the pretrained network that predicts normals."""

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        for name in NOT_OF_NORMALS:
            delattr(self, name)
        del self.label_centre, self.label_half

    def of(self, code: torch.Tensor) -> torch.Tensor:
        """Return unit normals (B, 3, H, W) of a picture code (B, 4, H, W)."""
        return self._normals(self._features(code))


class TwoEncoders(CompactWrapped):
    """The compact network with another network's normals; see Prediction."""

    name = "two-encoders"

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        for name in ONLY_OF_NORMALS:
            delattr(self, name)
        self.of_normals = NormalsPretrained(ranges)

    def _encoded(self, x):
        return x, super()._encoded(x)[1]

    def _normals(self, features):
        return self.of_normals.of(features)
