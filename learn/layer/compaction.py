"""The rendering layer's checked arguments, compacted to the pixels that are seen."""

import numpy as np
import torch

from learn.engines import pixel_selection
from learn.layer.inputs import Inputs
from learn.methods import HORIZON, Batch
from shaders.dsbrdf import SHAPE
from shaders.frames import camera_from_light


def unit_vectors(vectors: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Return unit vectors (N, 3) of vectors (B, H, W, 3) at flat pixel indices (N,)."""
    return pixel_selection.unit(vectors.reshape(-1, 3), index)


def compact_pixels(inputs: Inputs) -> tuple[Batch, torch.Tensor]:
    """Return the pixels inside the mask that face the viewer, sorted by image and segment.

    Returns  a learn.methods.Batch of P pixels; index (P,) of each among the B·H·W pixels
    """
    # pixels that face the viewer first, so that the graph holds one selection only
    if inputs.seen is None:
        index = inputs.mask.reshape(-1).nonzero().squeeze(-1)
        with torch.no_grad():
            n = unit_vectors(inputs.n, index)
            facing = (
                n[:, 2] if inputs.view is None else (n * unit_vectors(inputs.view, index)).sum(-1)
            )
            index = index[facing > HORIZON]
    else:
        index = torch.from_numpy(np.flatnonzero(inputs.seen.numpy()))
    pixels = inputs.mask.shape[1:].numel()
    segments = inputs.m.shape[1]
    if inputs.segments is None:  # by image, as they lie
        ends = torch.arange(len(inputs.mask) + 1, device=index.device) * pixels
        counts = torch.searchsorted(index, ends).diff()
        present = counts.nonzero().squeeze(-1)
        counts = counts[present]
    else:
        group = index // pixels * segments + inputs.segments.reshape(-1)[index] - 1
        if segments > 1:
            order = torch.argsort(group, stable=True)
            index, group = index[order], group[order]
        present, counts = torch.unique_consecutive(group, return_counts=True)
    batch = Batch(
        n=unit_vectors(inputs.n, index),
        view=None if inputs.view is None else unit_vectors(inputs.view, index),
        m=inputs.m.flatten(0, 1).unflatten(-1, SHAPE)[present],
        light=inputs.light,
        counts=tuple(counts.tolist()),
        light_of=tuple((present // max(segments, 1)).tolist()),
        camera_from_light=torch.as_tensor(camera_from_light(inputs.elevation)),
        one_material=segments == 1 and inputs.m.stride(0) == 0,
    )
    return batch, index
