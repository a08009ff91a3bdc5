"""What the layer makes of predictions, at all pixels of an object or at sampled ones.

Gradients of normals are bounded, pixel by pixel.
"""

from collections.abc import Callable

import torch

from learn.data.batch import ExampleBatch
from learn.layer import predictions
from manifests.training_runs import LayerMethod


def object_mask(batch: ExampleBatch) -> torch.Tensor:
    """Return (B, 1, H, W) float, 1 where the truth and the network's mask show the object."""
    return ((batch.segments > 0) & (batch.mask[:, 0] > 0))[:, None].float()


def render_frames(
    n: torch.Tensor,
    label: torch.Tensor,
    light: torch.Tensor,
    batch: ExampleBatch,
    gradient_bound: float = 0.0,
    method: LayerMethod = "auto",
) -> torch.Tensor:
    """Return radiance (B, 3, H, W) at all pixels of `object_mask`, 0 outside.

    n (B, 3, H, W), label (B, S, 108), light (B, 3, Hl, Wl)
    batch           whose mask, segments and elevation are used
    gradient_bound  as of `bound_gradient`, for all pixels together
    method          as losses.layer_method: "auto" is FRAME_LOSS, "quadrature" INTEGRAL_LOSS
    """
    shown = object_mask(batch) > 0
    normals = (
        torch.where(shown, n, n.new_tensor([0.0, 0.0, 1.0])[:, None, None])
        .movedim(1, -1)
        .contiguous()
    )
    if normals.requires_grad:
        normals.register_hook(bound_gradient(gradient_bound / shown.sum().clamp(min=1)))
    picture = predictions.radiance(
        normals,
        label,
        light,
        batch.segments.clamp(min=1),
        shown[:, 0],
        batch.elevation,
        predictions.FRAME_LOSS if method == "auto" else predictions.INTEGRAL_LOSS,
    )
    return picture.movedim(-1, 1)


def sample_pixels(
    batch: ExampleBatch, pixels: int, rng: torch.Generator
) -> tuple[torch.Tensor, int]:
    """Return flat indices (B, P) of different pixels of each object, and their number.

    They lie at equal distances in the order of rows, after a random first one, so that each pixel
    is equally likely. An index is −1 where an object has fewer pixels.
    """
    shown = (object_mask(batch) > 0).flatten(1)
    count = shown.sum(1, keepdim=True)
    part = torch.arange(min(pixels, shown.shape[1]), device=shown.device)
    first = torch.rand(len(shown), 1, generator=rng, dtype=torch.float64).to(shown.device)
    place = ((part + first) * (count / len(part)).clamp(min=1)).long()
    seen = part < count
    index = torch.searchsorted(shown.cumsum(1), place.clamp(max=shown.shape[1] - 1) + 1)
    return index.masked_fill(~seen, -1), int(seen.sum())


def render_pixels(
    n: torch.Tensor,
    label: torch.Tensor,
    light: torch.Tensor,
    batch: ExampleBatch,
    where: torch.Tensor,
    gradient_bound: float = 0.0,
    method: LayerMethod = "auto",
) -> torch.Tensor:
    """Return radiance (B, P, 3) at flat indices `where` (B, P), 0 where they are −1.

    n (B, 3, H, W), label (B, S, 108), light (B, 3, Hl, Wl)
    batch           whose segments and elevation are used
    gradient_bound  as of `bound_gradient`, for all pixels together
    method          as losses.layer_method: "auto" is PIXEL_LOSS, "quadrature" INTEGRAL_LOSS
    """
    region = batch.segments.flatten(1).gather(1, where.clamp(min=0))
    mask = where >= 0
    normals = torch.where(mask[..., None], gather_pixels(n, where), n.new_tensor([0.0, 0.0, 1.0]))
    if normals.requires_grad:
        normals.register_hook(bound_gradient(gradient_bound / mask.sum().clamp(min=1)))
    picture = predictions.radiance(
        normals[:, None],
        label,
        light,
        region.clamp(min=1)[:, None],
        mask[:, None],
        batch.elevation,
        predictions.PIXEL_LOSS if method == "auto" else predictions.INTEGRAL_LOSS,
    )
    return picture[:, 0]


def gather_pixels(values: torch.Tensor, where: torch.Tensor) -> torch.Tensor:
    """Return (B, P, 3) of values (B, 3, H, W) at flat indices (B, P); undefined at −1."""
    return values.flatten(2).gather(2, where.clamp(min=0)[:, None].expand(-1, 3, -1)).movedim(1, -1)


def bound_gradient(gradient_bound: float | torch.Tensor) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return a hook that shortens each pixel's gradient (…, 3) to at most `gradient_bound`.

    A glossy material's picture changes abruptly once a normal is off by more than a lobe's width,
    and its gradient is then of no use: without a bound it drives normals away from the truth.
    """

    def hook(gradient: torch.Tensor) -> torch.Tensor:
        length = gradient.norm(dim=-1, keepdim=True)
        return gradient * (gradient_bound / length.clamp(min=1e-30)).clamp(max=1)

    return hook
