"""A batch of examples: what a network is shown, and the truth about it.

B pictures, S regions, H, W picture
"""

from dataclasses import dataclass, fields

import numpy as np
import torch


@dataclass(frozen=True)
class ExampleBatch:
    """Truth in learn.data.records's frames and units, channels first.

    image         (B, 3, H, W) linear radiance as a network sees it, augmented
    mask          (B, 1, H, W) float, as a network sees it
    n             (B, 3, H, W) unit normals, camera frame, 0 outside the object
    segments      (B, H, W) int64, 1 … S, 0 outside the object
    label         (B, S, 108) natural logarithms
    light         (B, 3, 64, 128) linear radiance of unit mean luminance, light frame
    target_label  (B, S, 108) another material for the same shape and light: what the target image O
    is made of
    names         what each picture is, for messages: shape, …, material, apart by spaces
    picture       (B, 3, H, W) the true I where it came from a renderer of its own; None: what the
    layer makes of the truth
    target        (B, 3, H, W) the true O, likewise
    """

    image: torch.Tensor
    mask: torch.Tensor
    n: torch.Tensor
    segments: torch.Tensor
    label: torch.Tensor
    light: torch.Tensor
    target_label: torch.Tensor
    names: tuple
    elevation: float
    picture: torch.Tensor | None = None
    target: torch.Tensor | None = None

    def to(self, device: torch.device | str, non_blocking: bool = False) -> "ExampleBatch":
        """The batch with its tensors on a device; the batch itself where they are there already."""
        return self._with_tensors(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> "ExampleBatch":
        """The batch in page-locked memory, from which copies to a CUDA device need not be waited
        for; DataLoader calls this.
        """
        return self._with_tensors(torch.Tensor.pin_memory)

    def _with_tensors(self, function):
        """The batch with each tensor replaced by function(tensor); the batch itself if none of them
        changes.
        """
        old = [getattr(self, field.name) for field in fields(self)]
        new = [function(value) if isinstance(value, torch.Tensor) else value for value in old]
        return self if all(a is b for a, b in zip(old, new, strict=True)) else ExampleBatch(*new)


def joined(examples, elevation):
    """A ExampleBatch of examples: tuples (image, mask, n, segments, label, light, target label, name),
    arrays channels last.

    An example may end in two more, picture and target, but then all must.
    """
    image, mask, n, segments, label, light, target, names, *true = zip(*examples, strict=True)

    def plain(arrays):
        return torch.stack([torch.as_tensor(np.ascontiguousarray(a)) for a in arrays])

    def pictures(arrays):
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
