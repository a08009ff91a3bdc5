"""What the rendering layer accepts: checked at the border, then compacted to the pixels that are seen.

Each rule raises a ValueError that names the argument, the rule and what was found. Letters as in learn/layer.py.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from learn import layer_pixels
from learn.methods import HORIZON, Batch
from shaders.dsbrdf import SHAPE, SIZE
from shaders.frames import camera_from_light

LENGTH_TOLERANCE = 1e-2  # of unit vectors: half-float files are within 1e-3; an unnormalised network output is far outside


@dataclass(frozen=True)
class Inputs:
    """The layer's arguments in the dtype they are summed in: m (B, S, 108), mask (B, H, W) bool, segments (B, H, W) or None.

    seen  (B, H, W) bool: inside the mask and facing the viewer; None: not known yet
    """

    n: torch.Tensor
    m: torch.Tensor
    light: torch.Tensor
    view: torch.Tensor | None
    segments: torch.Tensor | None
    mask: torch.Tensor
    elevation: float
    seen: torch.Tensor | None = None


def refuse(argument, rule, found):
    raise ValueError(f"{argument}: {rule} expected, found {found}")


def require_shape(argument, tensor, rule, right):
    if not right:
        refuse(argument, rule, tuple(tensor.shape))


def require_alike(tensors):
    """One floating dtype and one device over all the arguments given."""
    for argument, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor):
            refuse(argument, "a torch tensor", type(tensor).__name__)
        if not tensor.is_floating_point():
            refuse(argument, "a floating dtype", tensor.dtype)
        for what in ("dtype", "device"):
            first = getattr(tensors["n"], what)
            if getattr(tensor, what) != first:
                refuse(argument, f"the {what} of n, {first},", getattr(tensor, what))


def require_values(argument, values, rule, right):
    """`right` marks the values (any shape) that keep the rule; NaN keeps none. The message shows the worst one's value."""
    if not bool(right.all()):
        wrong = values.detach()[~right]
        refuse(argument, rule, f"{wrong[0].item():g} ({wrong.numel()} of {values.numel()} values)")


def checked(n, material, light, view, segments, mask, tolerance, elevation):
    """The arguments of `render` as `Inputs`, or a ValueError."""
    require_alike({"n": n, "material": material, "light": light} | ({} if view is None else {"view": view}))
    require_shape("n", n, "shape (B, H, W, 3)", n.ndim == 4 and n.shape[3] == 3)
    images, picture = n.shape[0], n.shape[:3]
    layers = material.ndim - 1
    rule = f"shape ({images}, {SIZE}), or ({images}, S, {SIZE}) with segments,"
    require_shape("material", material, rule, layers in (1, 2) and material.shape[0] == images and material.shape[-1] == SIZE)
    right = light.ndim == 4 and light.shape[0] == images and light.shape[3] == 3 and min(light.shape[1:3]) > 0
    require_shape("light", light, f"shape ({images}, Hl, Wl, 3)", right)
    if view is not None:
        require_shape("view", view, f"the shape of n, {tuple(n.shape)},", view.shape == n.shape)
    if mask is not None:
        require_shape("mask", mask, f"shape {tuple(picture)}", mask.shape == picture)
        if mask.dtype != torch.bool:
            refuse("mask", "dtype torch.bool", mask.dtype)
    if layers == 2 and material.shape[1] != 1 and segments is None:
        refuse("segments", f"ids (B, H, W) for the {material.shape[1]} materials of each image", None)
    if segments is not None:
        check_segments(segments, picture, material.shape[1] if layers == 2 else 1)
    for argument, value, right in (
        ("tolerance", tolerance, lambda x: 0 < x < math.inf),
        ("elevation", elevation, lambda x: abs(x) <= math.pi / 2),
    ):
        if not right(value):
            refuse(argument, "a positive number" if argument == "tolerance" else "radians in [-π/2, π/2]", value)
    if segments is not None:
        mask = ((n.detach() != 0).any(-1) if mask is None else mask) & (segments > 0)
    dtype = torch.promote_types(n.dtype, torch.float32)
    m = material.reshape(images, -1, SIZE).to(dtype)
    check_values(material.detach(), light.detach())
    n, light, view = n.to(dtype), light.to(dtype), None if view is None else view.to(dtype)
    mask, seen = found_by_kernel(n, view, mask) if layer_pixels.has_kernels(n) else (mask, None)
    if seen is None:  # no kernel, or something is wrong and has to be named
        mask = (n.detach() != 0).any(-1) if mask is None else mask
        check_lengths(n.detach(), None if view is None else view.detach(), mask)
    return Inputs(n, m, light, view, segments, mask, elevation, seen)


def found_by_kernel(n, view, mask):
    """mask (as given, or where n is not 0) and seen (B, H, W) bool; seen is None if a length inside the mask is wrong."""
    states = layer_pixels.states(n, view, mask, LENGTH_TOLERANCE, HORIZON).reshape(n.shape[:3])
    if states.size and states.max() == layer_pixels.WRONG:
        return mask, None
    mask = torch.from_numpy(states > layer_pixels.OUTSIDE) if mask is None else mask
    return mask, torch.from_numpy(states == layer_pixels.SEEN)


def check_segments(segments, picture, materials):
    require_shape("segments", segments, f"shape {tuple(picture)}", segments.shape == picture)
    if segments.is_floating_point() or segments.dtype == torch.bool:
        refuse("segments", "an integer dtype", segments.dtype)
    if segments.numel():
        low, high = segments.min().item(), segments.max().item()
        if low < 0 or high > materials:
            refuse("segments", f"ids 0 (background) … {materials} (the materials given)", f"{low} … {high}")


def check_lengths(n, view, mask):
    """n, view: (B, H, W, 3), or view None; what lies outside the mask may be anything."""
    for argument, vectors in (("n", n), ("view", view)):
        if vectors is not None:
            length = vectors.float().norm(dim=-1)
            right = (length - 1).abs() <= LENGTH_TOLERANCE
            if not bool((right | ~mask).all()):
                rule = f"unit vectors inside the mask (length 1 ± {LENGTH_TOLERANCE})"
                require_values(argument, length[mask], rule, right[mask])


def check_values(material, light):
    kappa, gamma = material.reshape(*material.shape[:-1], *SHAPE).unbind(-2)
    if within(light) and within(kappa) and within(gamma, above=True):
        return
    require_values("light", light, "finite radiance ≥ 0", (light >= 0) & light.isfinite())
    require_values("material", kappa, "finite κ ≥ 0 (control values, not logarithms)", (kappa >= 0) & kappa.isfinite())
    require_values("material", gamma, "finite γ > 0 (control values, not logarithms)", (gamma > 0) & gamma.isfinite())


def within(values, above=False):
    """Whether all values are finite and at least 0, or above it; NaN is neither."""
    if not values.numel():
        return True
    if values.stride(0) == 0:  # one tensor expanded over the batch
        values = values[:1]
    low, high = (x.item() for x in values.aminmax())
    return (low > 0 if above else low >= 0) and high < math.inf


def unit(vectors, index):
    """(N, 3) unit vectors of pictures (B, H, W, 3) at flat places index (N,); None of None."""
    return None if vectors is None else layer_pixels.unit(vectors.reshape(-1, 3), index)


def compact(inputs):
    """The pixels inside the mask that face the viewer, sorted by image and segment.

    Returns  a learn.methods.Batch of P pixels; index (P,) of each among the B·H·W pixels
    """
    if inputs.seen is None:  # who faces the viewer is found first, so that the graph holds one selection only
        index = inputs.mask.reshape(-1).nonzero().squeeze(-1)
        with torch.no_grad():
            n, view = unit(inputs.n, index), unit(inputs.view, index)
            index = index[(n[:, 2] if view is None else (n * view).sum(-1)) > HORIZON]
    else:
        index = torch.from_numpy(np.flatnonzero(inputs.seen.numpy()))
    pixels = inputs.mask[0].numel()
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
        n=unit(inputs.n, index),
        view=unit(inputs.view, index),
        m=inputs.m.reshape(-1, *SHAPE)[present],
        light=inputs.light,
        counts=tuple(counts.tolist()),
        light_of=tuple((present // segments).tolist()),
        camera_from_light=torch.as_tensor(camera_from_light(inputs.elevation)),
        one_material=segments == 1 and inputs.m.stride(0) == 0,
    )
    return batch, index
