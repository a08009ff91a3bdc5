"""Baseline 1 of Section 4.5: an encoder and decoder from a picture to the edited picture.

Nothing between them has a meaning but the material.

    f = (f_m, f_o)   features of the picture: a vector for the material, a map for the rest
    m' = R(f_m)      the input's material, so that f_m describes the material and nothing else
    O' = D(e(m_t), f_o, I)   f_m replaced by the target material's features, with skip connections
                             from the picture itself

The paper gives no sizes and does not say where the target material's features come from. Ours: e is
two layers on the label's code, and R(e(m_t)) must return m_t, so that e and f_m share one space;
features enter every layer of the decoder as scale and shift.

B pictures, H, W multiples of 16; widths as learn.networks.separate.WIDTHS
"""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F

from learn.networks.coding import BRIGHTNESS, Ranges, picture_code
from learn.networks.compact import convolution
from learn.networks.prediction import Coded
from learn.networks.separate import WIDTHS, Encoder, make_head

FEATURES = 64  # of f_m
HIDDEN = 128


class Edited(NamedTuple):
    """The material that the network reads, and the picture that it draws.

    code, label  (B, 1, 108) of the input's material, as in learn.networks.prediction.Prediction
    embedded     (B, 1, 108) R(e(m_t)): the target material's code, read from its own features
    picture      (B, 3, H, W) O', compressed (learn.networks.coding.compress), ≥ 0; undefined
                 outside the mask
    n, light_code, light   None: parts of a Prediction that this network does not know
    """

    code: torch.Tensor
    label: torch.Tensor
    embedded: torch.Tensor
    picture: torch.Tensor
    n: None = None
    light_code: None = None
    light: None = None


class EncoderDecoder(Coded):
    """Edited pictures of masked pictures and target labels."""

    name = "encoder-decoder"

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        self.encode = Encoder()
        self.read = make_head(FEATURES)
        self.regress = nn.Sequential(
            nn.ReLU(), nn.Linear(FEATURES, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 108)
        )
        self.embed = nn.Sequential(nn.Linear(108, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, FEATURES))
        self.up = nn.ModuleList(convolution(a + b, a) for a, b in pairwise(WIDTHS))
        self.swap = nn.ModuleList(nn.Linear(FEATURES, 2 * width) for width in WIDTHS)
        self.last = nn.Conv2d(WIDTHS[0] + 16, 12, 3, 1, 1)

    def forward(self, image: torch.Tensor, mask: torch.Tensor, target: torch.Tensor) -> Edited:
        """Return the picture in the target material.

        image   (B, 3, H, W) linear radiance; mask (B, 1, H, W) float, 1 on the object
        target  (B, 1, 108) label, natural logarithms
        """
        x = picture_code(image, mask)
        features = self.encode(x)
        f_m, f_t = self.read(features[-1]), self.embed(self.ranges.code(target)[:, 0])
        code, embedded = (torch.tanh(self.regress(f).float())[:, None] for f in (f_m, f_t))
        picture = F.softplus(self._decode(f_t, features, F.pixel_unshuffle(x, 2)))
        return Edited(code, self.ranges.label(code), embedded, picture)

    def _decode(self, f_t, features, picture):
        x = self._swap_statistics(len(features) - 1, features[-1], f_t)
        for level in reversed(range(len(features) - 1)):
            x = self.up[level](torch.cat([features[level], F.interpolate(x, scale_factor=2.0)], 1))
            x = self._swap_statistics(level, x, f_t)
        return F.pixel_shuffle(self.last(torch.cat([x, picture.to(x)], 1)), 2).float()

    def _swap_statistics(self, level, x, f_t):
        """Return features (B, C, h, w) scaled and shifted per channel by the target material's."""
        scale, shift = self.swap[level](f_t)[..., None, None].chunk(2, 1)
        return x * (1 + scale) + shift


def radiance(picture: torch.Tensor) -> torch.Tensor:
    """Return linear radiance of a compressed picture, the inverse of coding.compress."""
    return torch.expm1(picture * torch.log(torch.tensor(1 + BRIGHTNESS))) / BRIGHTNESS
