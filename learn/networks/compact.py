"""The compact network: one encoder, three heads, 5 M parameters; trainable on two processor cores.

Under a distant viewer radiance depends on the normal alone. The picture's pixels, binned by their
predicted normals, are therefore a sample of the reflectance map. Material and light are read from
this map as well as from the picture, since separating them by deconvolution needs no shape.

B pictures, H, W multiples of 16, S segments. Widths WIDTHS at H/2, H/4, H/8, H/16; features at H/16
are averaged over each segment.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional as F

from learn.networks.coding import Ranges, compress, decode_light, picture_code, unit_mean
from learn.networks.light_maps import MapConvolution, enlarge, map_convolution
from learn.networks.prediction import Coded, Prediction, region_masks, require_part

WIDTHS = (32, 64, 128, 256)
CELLS = 32  # of the reflectance map, along a side
LIGHT_WIDTHS = (96, 64, 48, 32)  # at 4×8, 8×16, 16×32, 32×64; its 12 outputs are 64×128 texels of 3


class Convolution(nn.Conv2d):
    """A 3 × 3 convolution with zeros around, without a bias."""

    def __init__(self, before: int, after: int, stride: int = 1):
        super().__init__(before, after, 3, stride, 1, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return features (B, after, …) of x (B, before, h, w)."""
        if x.shape[-1] == 1:
            # oneDNN leaves the weights' gradient in bfloat16 uninitialised (torch 2.13, stride 2)
            return F.conv2d(F.pad(x, (1, 1)), self.weight, None, self.stride, (1, 0))
        return super().forward(x)


def convolution(before: int, after: int, stride: int = 1) -> nn.Sequential:
    """Return a 3 × 3 convolution from `before` to `after` channels with normalisation and ReLU."""
    return nn.Sequential(
        Convolution(before, after, stride),
        nn.BatchNorm2d(after),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """Two convolutions beside the identity."""

    def __init__(self, width: int):
        super().__init__()
        self.first = convolution(width, width)
        self.second = nn.Sequential(
            nn.Conv2d(width, width, 3, 1, 1, bias=False), nn.BatchNorm2d(width)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return features of the same shape (B, width, h, w)."""
        return F.relu(x + self.second(self.first(x)))


class Compact(Coded):
    """Normals, material and light of masked pictures; see Prediction.

    ranges  of the training materials' labels; they are stored with the weights
    widths  channels of the encoder at H/2, H/4, H/8, H/16; blocks: residual blocks at each of them
    refined  whether a residual block follows each convolution of the decoder
    hidden  units of the hidden layers of the heads of material and light; unit: their activation
    deep    channels of the deepest features, which the heads read
    wraps   whether the light head continues its maps around the circle and across the poles. With
            zeros beyond the map's edges instead, every predicted map has a frame
    """

    name = "compact"
    widths: tuple[int, ...] = WIDTHS
    blocks: tuple[int, ...] = (1, 1, 1, 1)
    refined = False
    hidden = 256
    unit: type[nn.Module] = nn.ReLU
    deep = WIDTHS[-1]
    wraps = False

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        self.down = nn.ModuleList(
            convolution(a, b, 1 if i == 0 else 2)
            for i, (a, b) in enumerate(zip((16, *self.widths), self.widths, strict=False))
        )
        self.deepen = nn.ModuleList(
            Residual(width)
            if count == 1
            else nn.Sequential(*(Residual(width) for _ in range(count)))
            for width, count in zip(self.widths, self.blocks, strict=True)
        )
        self.up = nn.ModuleList(
            nn.Sequential(convolution(a + b, a), Residual(a))
            if self.refined
            else convolution(a + b, a)
            for a, b in pairwise(self.widths)
        )
        self.normals = nn.Conv2d(self.widths[0], 12, 3, 1, 1)
        self.reflectance = nn.Sequential(
            convolution(4, 32),
            convolution(32, 64, 2),
            Residual(64),
            convolution(64, 96, 2),
            convolution(96, 128, 2),
        )
        seen = 128 * (CELLS // 8) ** 2
        self.material = nn.Sequential(
            nn.Linear(seen + 2 * self.deep, self.hidden),
            self.unit(),
            nn.Dropout(0.1),
            nn.Linear(self.hidden, self.hidden),
            self.unit(),
            nn.Linear(self.hidden, 108),
        )
        self.illumination = nn.Sequential(
            nn.Linear(seen + self.deep, self.hidden),
            self.unit(),
            nn.Dropout(0.1),
            nn.Linear(self.hidden, LIGHT_WIDTHS[0] * 32),
            self.unit(),
        )
        widened = map_convolution if self.wraps else convolution
        self.widen = nn.ModuleList(widened(a, b) for a, b in pairwise(LIGHT_WIDTHS))
        self.light = (
            MapConvolution(LIGHT_WIDTHS[-1], 12)
            if self.wraps
            else nn.Conv2d(LIGHT_WIDTHS[-1], 12, 3, 1, 1)
        )

    def forward(
        self,
        image: torch.Tensor,
        mask: torch.Tensor,
        segments: torch.Tensor | None = None,
        parts: Sequence[str] = ("normals", "material", "light"),
        n: torch.Tensor | None = None,
        regions: int | None = None,
    ) -> Prediction:
        """Return a Prediction of the requested parts.

        image     (B, 3, H, W) linear radiance
        mask      (B, 1, H, W) float, 1 on the object
        segments  (B, H, W) 1 … S; None: the mask is one segment
        n         (B, 3, H, W) normals by which pixels are binned; None: the predicted ones
        regions   S; None: the highest of segments. A region that no pixel shows is read from the
                  rest of the picture
        """
        features, deep = self._encode(picture_code(image, mask))
        predicted = code = light_code = None
        if n is None or "normals" in parts:
            predicted = self._normals(features)
        binned_by = require_part(predicted).detach() if n is None else n
        if "material" in parts:
            each = region_masks(mask, segments, regions).split(1, 1)
            code = torch.stack(
                [self._code(image, region, mask, binned_by, deep) for region in each], 1
            )
        if "light" in parts:
            light_code = self._light(
                torch.cat([self._reflectance(image, mask, binned_by), _mean_over(mask, deep)], 1)
            )
        label = None if code is None else self.ranges.label(code)
        light = (
            None
            if light_code is None
            else unit_mean(decode_light(light_code), self.row_solid_angle)
        )
        return Prediction(predicted if "normals" in parts else None, code, label, light_code, light)

    def _encode(self, x):
        features, x = [], F.pixel_unshuffle(x, 2)
        for down, deepen in zip(self.down, self.deepen, strict=True):
            x = deepen(down(x))
            features.append(x)
        return features, x

    def _normals(self, features):
        x = features[-1]
        for up, beside in zip(reversed(self.up), reversed(features[:-1]), strict=True):
            x = up(torch.cat([beside, F.interpolate(x, scale_factor=2.0)], 1))
        x = F.pixel_shuffle(self.normals(x), 2).float()
        return F.normalize(torch.cat([x[:, :2], F.softplus(x[:, 2:]) + 1e-3], 1), dim=1)

    def _reflectance(
        self, image: torch.Tensor, mask: torch.Tensor, n: torch.Tensor
    ) -> torch.Tensor:
        """Return features (B, C) of the reflectance map."""
        return self.reflectance(reflectance_map(image, mask, n)).flatten(1)

    def _code(self, image, region, mask, n, deep):
        parts = (
            self._reflectance(image, region, n),
            _mean_over(region, deep),
            _mean_over(mask, deep),
        )
        return torch.tanh(self.material(torch.cat(parts, 1)).float())

    def _light(self, x):
        x = self.illumination(x).reshape(-1, LIGHT_WIDTHS[0], 4, 8)
        for widen in self.widen:
            larger = (
                enlarge(x) if self.wraps else F.interpolate(x, scale_factor=2.0, mode="bilinear")
            )
            x = widen(larger)
        return F.softplus(F.pixel_shuffle(self.light(x), 2).float())


class CompactWrapped(Compact):
    """The compact network with a light head that continues its maps around the circle."""

    name = "compact-wrapped"
    wraps = True


def _mean_over(mask: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
    """Return means (B, C) of features (B, C, h, w) over a mask (B, 1, H, W); 0 if it is empty."""
    weight = F.interpolate(mask, features.shape[-2:], mode="area").to(features)
    return (features * weight).sum((2, 3)) / weight.sum((2, 3)).clamp(min=1e-3)


def reflectance_map(image: torch.Tensor, mask: torch.Tensor, n: torch.Tensor) -> torch.Tensor:
    """Return a picture's pixels binned by their normals, (B, 4, CELLS, CELLS).

    Channels are the compressed radiance, averaged over the pixels whose normals fall into a cell,
    and the confidence of a cell, count/(count + 4).

    Cells divide the equal-area disk p = (n_x, −n_y)/√(1 + n_z); row 0 is up, as in the picture.
    Empty cells hold 0.
    """
    with torch.autocast(image.device.type, enabled=False):
        B = len(image)
        p = n[:, :2].float() * torch.rsqrt(1.0 + n[:, 2:].float().clamp(min=0))
        disk = torch.stack([p[:, 0], -p[:, 1]], 1)
        cell = ((disk + 1) * (CELLS / 2)).long().clamp(0, CELLS - 1)
        index = (cell[:, 1] * CELLS + cell[:, 0]).reshape(B, 1, -1)
        values = torch.cat([(compress(image.float()) - 0.5) * mask, mask.float()], 1).reshape(
            B, 4, -1
        )
        sums = values.new_zeros(B, 4, CELLS * CELLS).scatter_add(2, index.expand(-1, 4, -1), values)
        count = sums[:, 3:]
        seen = torch.cat([sums[:, :3] / count.clamp(min=1), count / (count + 4)], 1)
        return seen.reshape(B, 4, CELLS, CELLS)
