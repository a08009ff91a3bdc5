"""What every network of this package predicts, whichever its layers are."""

from typing import NamedTuple

import torch

from learn.networks.coding import Ranges
from shaders.envmap import row_solid_angles


class Prediction(NamedTuple):
    """B pictures, S segments; None for what was not asked for.

    n           (B, 3, H, W) unit normals, camera frame, n_z > 0; meaningless outside the mask
    code        (B, S, 108) material codes in (−1, 1); learn.networks.coding.Ranges reads them
    label       (B, S, 108) natural logarithms of κ and γ control values
    light_code  (B, 3, 64, 128) log(1 + L) before scaling
    light       (B, 3, 64, 128) linear radiance ≥ 0 of unit mean luminance, light frame
    """

    n: torch.Tensor | None
    code: torch.Tensor | None
    label: torch.Tensor | None
    light_code: torch.Tensor | None
    light: torch.Tensor | None


class Coded(torch.nn.Module):
    """A network that knows the ranges of its material codes (learn.networks.coding.Ranges), which are kept with its weights."""

    def __init__(self, ranges: Ranges):
        super().__init__()
        self.register_buffer("label_centre", ranges.centre.clone())
        self.register_buffer("label_half", ranges.half.clone())
        self.register_buffer("row_solid_angle", torch.as_tensor(row_solid_angles(64, 128), dtype=torch.float32), persistent=False)

    @property
    def ranges(self):
        return Ranges(self.label_centre, self.label_half)
