"""Two encoders that learn together: the compact network's, and one that has seen photographs.

Normals are the mean of both networks', as in learn.networks.two_encoders, but both learn from the
error of the mean. Material and light read the reflectance map by this mean, and the deepest
features of both encoders. The hidden units of their heads are SiLU, of which none can die.

B pictures, H, W multiples of 32.
"""

import torch
from torch import nn
from torch.nn import functional as F

from learn.networks.coding import Ranges
from learn.networks.compact import CELLS, LIGHT_WIDTHS, WIDTHS, CompactWrapped
from learn.networks.pretrained import GROUPS
from learn.networks.two_encoders import NormalsPretrained

HIDDEN = 512  # units of the heads of material and light
DEEP = 2 * WIDTHS[-1]  # channels of the deepest features of both encoders


class JointEncoders(CompactWrapped):
    """Normals, material and light by two encoders; see Prediction."""

    name = "joint-encoders"
    # what it does not take over when a run begins with weights of `two-encoders`
    begins_new = ("narrow", "material", "illumination", "label_centre", "label_half")

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        self.of_normals = NormalsPretrained(ranges)
        self.narrow = nn.Conv2d(GROUPS[-1][1], WIDTHS[-1], 1)
        seen = 128 * (CELLS // 8) ** 2
        self.material = nn.Sequential(
            nn.Linear(seen + 2 * DEEP, HIDDEN),
            nn.SiLU(),
            nn.Dropout(0.1),
            nn.Linear(HIDDEN, HIDDEN),
            nn.SiLU(),
            nn.Linear(HIDDEN, 108),
        )
        self.illumination = nn.Sequential(
            nn.Linear(seen + DEEP, HIDDEN),
            nn.SiLU(),
            nn.Dropout(0.1),
            nn.Linear(HIDDEN, LIGHT_WIDTHS[0] * 32),
            nn.SiLU(),
        )

    def _encoded(self, x):
        own, deep = super()._encoded(x)
        others = self.of_normals.features_of(x)
        beside = F.silu(self.narrow(others[-1]))
        return (own, others), torch.cat([deep, F.interpolate(beside, deep.shape[-2:])], 1)

    def _normals(self, features):
        own, others = features
        return F.normalize(super()._normals(own) + self.of_normals.normals_of(others), dim=1)
