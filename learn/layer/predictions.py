"""Pictures of what networks predict: the one adapter from their tensors to `render`.

Networks, batches and baselines keep channels first and materials as logarithms; `render` takes
channels last and the materials themselves. B pictures, S regions:

label     (B, S, 108) natural logarithms
light     (B, 3, Hl, Wl) linear radiance, light frame
segments  (B, H, W) integers 1 … S, 0 in the background

Two errors of pictures can be compared only if both pictures were rendered by one policy, that is
by one method and one tolerance. The policies differ because their purposes do:

MEASURED     every display L2 in the report of an evaluation: edits and re-renderings
SHOWN        what people look at: edited photographs, predictions, material spheres
VALIDATION   figures during training, which must cost less than the steps between two validations,
             and in the card of the weights, which holds the same figures
ABLATION     figures of refinement's ablation, which renders thousands of pictures
PIXEL_LOSS   training losses at sampled pixels, where the sum over texels costs least
FRAME_LOSS   training losses of whole frames
INTEGRAL_LOSS  both in a run whose losses ask for the integral
TEXEL_SUM    the paper's sum over texels itself, for comparisons with it
"""

from typing import NamedTuple

import torch

from learn.layer.display_method import method_for
from learn.layer.rendering import render


class Policy(NamedTuple):
    """A method of the layer, "" for the one that suits the material, and its tolerance."""

    method: str
    tolerance: float


# The converged integral, not the sum over texels: of a mirror-like lobe the sum alone is 200
# display L2 off. At a tolerance of 1e-2 one of 75 true edits was 0.7 off, at 5e-3 none 0.1.
MEASURED = Policy("quadrature", 5e-3)
SHOWN = Policy("", 1e-2)
VALIDATION = Policy("hybrid", 2e-2)
ABLATION = Policy("auto", 2e-2)
PIXEL_LOSS = Policy("exact", 1e-2)
# all pixels at 2e-2 would take a quarter longer
FRAME_LOSS = Policy("auto", 5e-2)
INTEGRAL_LOSS = Policy("quadrature", 2e-2)
TEXEL_SUM = Policy("exact", 1e-2)


def radiance(
    n: torch.Tensor,
    label: torch.Tensor,
    light: torch.Tensor,
    segments: torch.Tensor,
    mask: torch.Tensor | None,
    elevation: float,
    policy: Policy,
) -> torch.Tensor:
    """Return radiance (B, H, W, 3), differentiable in normals, label and light.

    n      (B, H, W, 3), channels last: training replaces or bounds the gradient of each normal
    mask   (B, H, W) bool; None: where n is not 0
    label, light, segments  as above; segments are read only if there are several regions
    """
    several = label.shape[1] > 1
    return render(
        n,
        (label if several else label[:, 0]).exp().to(n.dtype),
        light.movedim(1, -1),
        segments=segments if several else None,
        mask=mask,
        method=policy.method or method_for(label),
        tolerance=policy.tolerance,
        elevation=elevation,
    )


def picture(
    n: torch.Tensor,
    label: torch.Tensor,
    light: torch.Tensor,
    segments: torch.Tensor,
    elevation: float,
    policy: Policy = MEASURED,
) -> torch.Tensor:
    """Return radiance (B, H, W, 3) of predicted parts without derivatives, 0 in the background.

    n  (B, 3, H, W) unit normals, camera frame; label, light, segments as above
    """
    with torch.no_grad():
        return radiance(
            n.movedim(1, -1).contiguous().float(),
            label.float(),
            light.float(),
            segments,
            segments > 0,
            elevation,
            policy,
        )
