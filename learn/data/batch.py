"""A batch of examples: the pictures that a network sees, and the truth about them.

Shapes have B for pictures, S for regions, and H and W for height and width.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch


@dataclass(frozen=True)
class ExampleBatch:
    """Pictures and their truth, in the frames and units of learn.data.records, channels first.

    image         (B, 3, H, W) linear radiance as the network sees it, that is, after augmentation
    mask          (B, 1, H, W) float, likewise
    n             (B, 3, H, W) unit normals, camera frame, 0 outside the object
    segments      (B, H, W) int64, 1 … S, 0 outside the object
    label         (B, S, 108) natural logarithms, one row for each region
    light         (B, 3, 64, 128) linear radiance of unit mean luminance, light frame
    target_label  (B, S, 108) the material of the target image O, for the same shape and light
    names         what messages call the pictures: shape, …, material, separated by spaces
    elevation     of all pictures' camera, radians
    picture       (B, 3, H, W) the true picture I if another renderer made it; None: the layer's
                  rendering of the truth
    target        (B, 3, H, W) the true target O, likewise
    clipped       (B, 3, H, W) in [0, 1]: the share of each pixel and channel of `image` that the
                  file shows as white, so that its value is a lower bound; None: nothing is clipped
    """

    image: torch.Tensor
    mask: torch.Tensor
    n: torch.Tensor
    segments: torch.Tensor
    label: torch.Tensor
    light: torch.Tensor
    target_label: torch.Tensor
    names: tuple[str, ...]
    elevation: float
    picture: torch.Tensor | None = None
    target: torch.Tensor | None = None
    clipped: torch.Tensor | None = None

    def to(self, device: torch.device | str, non_blocking: bool = False) -> "ExampleBatch":
        """Return the batch on a device; the batch itself if its tensors are there already."""
        return self._with_tensors(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> "ExampleBatch":
        """Return the batch in page-locked memory, from which copies to a GPU are asynchronous.

        DataLoader calls this.
        """
        return self._with_tensors(torch.Tensor.pin_memory)

    def _with_tensors(self, function: Callable[[torch.Tensor], torch.Tensor]) -> "ExampleBatch":
        """Return the batch of function(tensor); the batch itself if no tensor changes."""
        old = {field.name: getattr(self, field.name) for field in fields(self)}
        new: dict[str, Any] = {
            name: function(value) for name, value in old.items() if isinstance(value, torch.Tensor)
        }
        if all(value is old[name] for name, value in new.items()):
            return self
        return replace(self, **new)


def shape_and_material(name: str) -> tuple[str, str]:
    """Return the shape and the material of a picture from its name in `ExampleBatch.names`."""
    shape, *_, material = name.split(" ")
    return shape, material


def collate(examples: Sequence[tuple], elevation: float) -> ExampleBatch:
    """Return the batch of examples whose arrays have their channels last.

    examples   tuples (image, mask, n, segments, label, light, target label, name); picture and
               target may follow, in all of them or in none
    elevation  of the camera, radians
    """
    image, mask, n, segments, label, light, target, names, *true = zip(*examples, strict=True)

    def plain(arrays: Sequence[Any]) -> torch.Tensor:
        return torch.stack([torch.as_tensor(np.ascontiguousarray(a)) for a in arrays])

    def pictures(arrays: Sequence[Any]) -> torch.Tensor:
        return plain(arrays).movedim(-1, 1).contiguous()

    return ExampleBatch(
        pictures(image),
        plain(mask)[:, None].float(),
        pictures(n),
        plain(segments),
        plain(label),
        pictures(light),
        plain(target),
        names,
        elevation,
        *(pictures(arrays) for arrays in true),
    )
