"""LPIPS (Zhang et al. 2018), where a user has its weights; nothing is downloaded.

Weights are one .safetensors file of AlexNet's five convolutions and LPIPS' five linear layers:
`features.K.weight`, `features.K.bias` (K = 0, 3, 6, 8, 10, as torchvision numbers them) and
`lin0.weight` … `lin4.weight`. Its checksum stands beside the figures in
a report.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional as F

from learn.metrics.pictures import Perceptual
from learn.networks import tensor_file
from manifests.errors import InputError

# of AlexNet's kernels
SHAPES = ((64, 3, 11, 11), (192, 64, 5, 5), (384, 192, 3, 3), (256, 384, 3, 3), (256, 256, 3, 3))
# number, stride, padding, whether max pooling comes before
LAYERS = ((0, 4, 2, False), (3, 1, 2, True), (6, 1, 1, True), (8, 1, 1, False), (10, 1, 1, False))
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


def load(path: str | Path | None) -> Perceptual | None:
    """Return LPIPS as a function of two pictures, with the weights of a file; None for no file.

    The pictures are display values (H, W, 3) in [0, 255]; equal ones have a distance of 0.
    Raises  InputError
    """
    if path is None:
        return None
    requested: dict[str, tuple[int, ...]] = {}
    for (k, *_), shape in zip(LAYERS, SHAPES, strict=True):
        requested |= {f"features.{k}.weight": shape, f"features.{k}.bias": shape[:1]}
    requested |= {f"lin{i}.weight": (1, shape[0], 1, 1) for i, shape in enumerate(SHAPES)}
    remedy = "convert LPIPS' AlexNet weights under these names"
    with tensor_file.open_tensor_file(
        path, "LPIPS' weights in a .safetensors file", remedy
    ) as stored:
        missing = [name for name in requested if name not in stored.shapes]
        if missing:
            names = list(requested)
            raise InputError(
                path, f"tensors {', '.join(names[:2])} … {names[-1]}", f"no {missing[0]}", remedy
            )
        stored.require(requested, "LPIPS' AlexNet", alone=False)
        tensors = {name: stored.tensor(name) for name in requested}
    return lambda shown, right: distance(tensors, shown, right)


def distance(tensors: Mapping[str, torch.Tensor], shown: np.ndarray, right: np.ndarray) -> float:
    """Return LPIPS of two pictures of display values (H, W, 3)."""
    with torch.no_grad():
        features = [stages(tensors, prepare(picture)) for picture in (shown, right)]
        total = 0.0
        for i, (a, b) in enumerate(zip(*features, strict=True)):
            squared = (unit(a) - unit(b)) ** 2
            total += float(F.conv2d(squared, tensors[f"lin{i}.weight"].float()).mean())
    return total


def prepare(display: np.ndarray) -> torch.Tensor:
    """Return display values (H, W, 3) as (1, 3, H, W), centred and scaled as for AlexNet."""
    x = torch.as_tensor(display, dtype=torch.float32).movedim(-1, 0)[None] / 127.5 - 1
    return (x - x.new_tensor(SHIFT)[:, None, None]) / x.new_tensor(SCALE)[:, None, None]


def stages(tensors: Mapping[str, torch.Tensor], x: torch.Tensor) -> list[torch.Tensor]:
    """Return the features after each of the five convolutions."""
    results = []
    for number, stride, padding, pooled in LAYERS:
        x = F.max_pool2d(x, 3, 2) if pooled else x
        x = F.relu(
            F.conv2d(
                x,
                tensors[f"features.{number}.weight"].float(),
                tensors[f"features.{number}.bias"].float(),
                stride,
                padding,
            )
        )
        results.append(x)
    return results


def unit(x: torch.Tensor) -> torch.Tensor:
    """Return features scaled to unit length at each place."""
    return x / (x.norm(dim=1, keepdim=True) + 1e-10)
