"""Normals that are the mean of two networks', material and light by one of them.

Networks with other encoders err in other places, so that the mean of their normals is better than
those of either. One is the compact network. The other learns normals alone, and its encoder is
EfficientNet-Lite0, which has seen photographs (learn.networks.pretrained). Material and light are
the compact network's. Each network is trained by itself; learn.networks.joining makes one file of
both.

B pictures, H, W multiples of 32.
"""

from collections.abc import Sequence

import torch
from torch.nn import functional as F

from learn.networks.coding import Ranges, picture_code
from learn.networks.compact import CompactWrapped
from learn.networks.prediction import Prediction
from learn.networks.pretrained import CompactPretrained

OF_NORMALS = "of_normals"  # the module that predicts normals alone
# modules of CompactPretrained that normals do not need
NOT_OF_NORMALS = ("reflectance", "material", "illumination", "widen", "light", "narrow")


class NormalsPretrained(CompactPretrained):
    """The part of the pretrained network that predicts normals."""

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        for name in NOT_OF_NORMALS:
            delattr(self, name)
        del self.label_centre, self.label_half

    def of(self, code: torch.Tensor) -> torch.Tensor:
        """Return unit normals (B, 3, H, W) of a picture code (B, 4, H, W)."""
        return self.normals_of(self.features_of(code))

    def features_of(self, code: torch.Tensor) -> list[torch.Tensor]:
        """Return the encoder's features (B, C, h, w) at H/2, H/4, … H/32."""
        return self._features(code)

    def normals_of(self, features: list[torch.Tensor]) -> torch.Tensor:
        """Return unit normals (B, 3, H, W) of `features_of`."""
        return self._normals(features)


class TwoEncoders(CompactWrapped):
    """The compact network, whose normals are averaged with another network's; see Prediction.

    Material and light are read by the compact network's own normals, with which it learned to.
    """

    name = "two-encoders"

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        self.of_normals = NormalsPretrained(ranges)

    def forward(
        self,
        image: torch.Tensor,
        mask: torch.Tensor,
        segments: torch.Tensor | None = None,
        parts: Sequence[str] = ("normals", "material", "light"),
        n: torch.Tensor | None = None,
        regions: int | None = None,
    ) -> Prediction:
        """Return a Prediction of the requested parts; arguments as of Compact."""
        result = super().forward(image, mask, segments, parts, n, regions)
        if result.n is None:
            return result
        other = self.of_normals.of(picture_code(image, mask))
        return result._replace(n=F.normalize(result.n + other, dim=1))
