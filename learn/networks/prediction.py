"""The prediction of a network, and what all networks of this package have in common."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional as F

from learn.networks.coding import Ranges, decode_light, picture_code, unit_mean
from shaders.envmap import row_solid_angles


class Prediction(NamedTuple):
    """Normals, material and light of B pictures with S segments; None for parts not requested.

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


def require_part(part: torch.Tensor | None) -> torch.Tensor:
    """Return a part of a prediction, or of a batch, that must be there. Raises ValueError."""
    if part is None:
        raise ValueError("prediction: expected normals, material and light, found a part missing")
    return part


def region_masks(
    mask: torch.Tensor, segments: torch.Tensor | None = None, regions: int | None = None
) -> torch.Tensor:
    """Return a mask for each region, (B, S, H, W) float.

    mask      (B, 1, H, W); segments (B, H, W) 1 … S, None: the mask is one region
    regions   S, where a picture at the network's size may no longer show the last ones; None: the
              highest of segments
    """
    if segments is None:
        return mask
    count = max(int(segments.max()), 1) if regions is None else regions
    return F.one_hot(segments, count + 1)[..., 1:].movedim(-1, 1).to(mask) * mask


class Coded(torch.nn.Module):
    """A network with the ranges of its material codes, which are stored with its weights.

    name             under which learn.networks.weights.NETWORKS lists it
    training_labels  (M, 108) of the data set's materials that it was trained on, if its weights
                     hold them; None: the built-in materials
    """

    name: str
    label_centre: torch.Tensor
    label_half: torch.Tensor
    row_solid_angle: torch.Tensor
    training_labels: np.ndarray | None = None

    def __init__(self, ranges: Ranges):
        super().__init__()
        self.register_buffer("label_centre", ranges.centre.clone())
        self.register_buffer("label_half", ranges.half.clone())
        self.register_buffer(
            "row_solid_angle",
            torch.as_tensor(row_solid_angles(64, 128), dtype=torch.float32),
            persistent=False,
        )

    @property
    def ranges(self) -> Ranges:
        """Ranges of the labels of the training materials."""
        return Ranges(self.label_centre, self.label_half)


class ThreeNetworks(Coded):
    """Normals, material and light by networks that share nothing.

    Each of `_normals`, `_code` and `_light` reads a picture code of its own. Arguments and result
    of the forward pass are those of learn.networks.compact.Compact; `n` is not read, for nothing is
    binned by normals.

    _normals  picture code (B, 4, H, W) → (B, 3, H, W), of any length, before n_z is made positive
    _code     picture code of one region → (B, 108) before tanh
    _light    picture code → (B, 3, 64, 128) before softplus
    """

    def forward(
        self,
        image: torch.Tensor,
        mask: torch.Tensor,
        segments: torch.Tensor | None = None,
        parts: Sequence[str] = ("normals", "material", "light"),
        n: torch.Tensor | None = None,
        regions: int | None = None,
    ) -> Prediction:
        """Return a Prediction of the requested parts."""
        x = picture_code(image, mask)
        normals = code = light_code = label = light = None
        if "normals" in parts:
            raw = self._normals(x).float()
            normals = F.normalize(torch.cat([raw[:, :2], F.softplus(raw[:, 2:]) + 1e-3], 1), dim=1)
        if "material" in parts:
            each = region_masks(mask, segments, regions).split(1, 1)
            code = torch.stack(
                [torch.tanh(self._code(picture_code(image, region)).float()) for region in each], 1
            )
            label = self.ranges.label(code)
        if "light" in parts:
            light_code = F.softplus(self._light(x).float())
            light = unit_mean(decode_light(light_code), self.row_solid_angle)
        return Prediction(normals, code, label, light_code, light)

    def _normals(self, x: torch.Tensor) -> torch.Tensor:
        raise NotImplementedError

    def _code(self, x: torch.Tensor) -> torch.Tensor:
        raise NotImplementedError

    def _light(self, x: torch.Tensor) -> torch.Tensor:
        raise NotImplementedError
