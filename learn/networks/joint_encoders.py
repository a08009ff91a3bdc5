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
from learn.networks.compact import WIDTHS, CompactWrapped
from learn.networks.pretrained import GROUPS
from learn.networks.two_encoders import NormalsPretrained


class JointEncoders(CompactWrapped):
    """Normals, material and light by two encoders; see Prediction."""

    name = "joint-encoders"
    hidden = 512
    unit = nn.SiLU
    deep = 2 * WIDTHS[-1]  # of both encoders
    # what it does not take over when a run begins with weights of `two-encoders`
    begins_new: tuple[str, ...] = (
        "narrow",
        "material",
        "illumination",
        "label_centre",
        "label_half",
    )

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        self.of_normals = NormalsPretrained(ranges)
        self.narrow = nn.Conv2d(GROUPS[-1][1], WIDTHS[-1], 1)

    def _encode(self, x):
        own, deep = super()._encode(x)
        others = self.of_normals.features_of(x)
        beside = F.silu(self.narrow(others[-1]))
        return (own, others), torch.cat([deep, F.interpolate(beside, deep.shape[-2:])], 1)

    def _normals(self, features):
        own, others = features
        return F.normalize(super()._normals(own) + self.of_normals.normals_of(others), dim=1)


class JointWide(JointEncoders):
    """The same with a compact encoder of half as many channels again, and of more blocks.

    16.0 M parameters, about as many as 32 MiB of half precision hold. A step of 16 pictures takes
    one thread 2 s, so that it is for training on a GPU.
    """

    name = "joint-wide"
    widths = (48, 96, 192, 384)
    blocks = (2, 2, 1, 1)
    refined = True
    deep = widths[-1] + WIDTHS[-1]
    begins_new = (*JointEncoders.begins_new, "down", "deepen", "up", "normals")
