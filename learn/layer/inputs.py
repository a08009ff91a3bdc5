"""Checks the rendering layer's arguments.

Each check raises a ValueError that names the argument, the rule and the value.
learn/layer/rendering.py explains the letters.
"""

import math
import numbers
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NoReturn, cast

import torch

from learn.engines import pixel_selection
from learn.engines.layout import OUTSIDE, SEEN, WRONG
from learn.methods import HORIZON
from shaders.dsbrdf import SHAPE, SIZE

# of unit vectors: those of half-float files are within 1e-3, and an unnormalised output of a
# network is far outside
LENGTH_TOLERANCE = 1e-2
FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
INTEGERS = (
    torch.uint8,
    torch.int8,
    torch.int16,
    torch.int32,
    torch.int64,
    torch.uint16,
    torch.uint32,
    torch.uint64,
)
LEAST_TOLERANCE = 1e-12  # smaller tolerances, beyond float64's digits, are treated as this
# in one call: each pixel takes 12 bytes or more, and each texel about 200
MOST_PIXELS, MOST_TEXELS = 2**28, 2**25


@dataclass(frozen=True)
class Inputs:
    """The layer's arguments in the dtype they are summed in.

    m          (B, S, 108)
    segments   (B, H, W) or None; mask: (B, H, W) bool
    tolerance  as passed to the methods
    seen       (B, H, W) bool: inside the mask and facing the viewer; None: not known yet
    """

    n: torch.Tensor
    m: torch.Tensor
    light: torch.Tensor
    view: torch.Tensor | None
    segments: torch.Tensor | None
    mask: torch.Tensor
    tolerance: float
    elevation: float
    seen: torch.Tensor | None = None


def refuse(argument: str, rule: str, found: object) -> NoReturn:
    """Raise the ValueError of a broken rule."""
    raise ValueError(f"{argument}: expected {rule}, found {found}")


def require_shape(argument: str, tensor: torch.Tensor, rule: str, right: bool) -> None:
    """Refuse the tensor by its shape, unless it is right."""
    if not right:
        refuse(argument, rule, tuple(tensor.shape))


def require_dense(argument: str, tensor: object) -> None:
    """Refuse anything but a dense torch tensor."""
    if not isinstance(tensor, torch.Tensor):
        refuse(argument, "a torch tensor", type(tensor).__name__)
    if tensor.is_nested:
        refuse(argument, "a dense tensor", "a nested one")
    if tensor.layout != torch.strided:
        refuse(argument, "a dense tensor", f"layout {tensor.layout}")


def require_alike(tensors: Mapping[str, torch.Tensor]) -> None:
    """Refuse tensors of other than one floating dtype and one device with memory."""
    for argument, tensor in tensors.items():
        require_dense(argument, tensor)
        if tensor.dtype not in FLOATS:
            refuse(
                argument,
                (
                    "a floating dtype of at least 16 bits"
                    if tensor.is_floating_point()
                    else "a floating dtype"
                ),
                tensor.dtype,
            )
        for what in ("dtype", "device"):
            first = getattr(tensors["n"], what)
            if getattr(tensor, what) != first:
                refuse(argument, f"the {what} of n, {first}", getattr(tensor, what))
        if tensor.is_meta:
            refuse(argument, "a tensor with values", "device meta")


def require_beside(argument: str, tensor: torch.Tensor, n: torch.Tensor) -> None:
    """Refuse anything but a dense tensor on the device of `n`."""
    require_dense(argument, tensor)
    if tensor.device != n.device:
        refuse(argument, f"the device of n, {n.device}", tensor.device)


def require_number(
    argument: str, value: object, rule: str, right: Callable[[float], bool]
) -> float:
    """Return the value as a float. Refuse what is no real number or breaks the rule.

    A tensor of one element is not a number here, nor is a bool.
    """
    # to the compiler numpy's numbers are tensors
    is_real = isinstance(value, numbers.Real) or (
        torch.compiler.is_compiling() and hasattr(value, "dtype")
    )
    if not is_real or isinstance(value, bool):
        refuse(
            argument,
            rule,
            repr(value) if isinstance(value, str | bool | None) else type(value).__name__,
        )
    try:
        converted = float(cast("float", value))
    except OverflowError:  # an integer or a fraction beyond 1e308
        converted = math.inf
    if not right(converted):
        refuse(argument, rule, converted if converted in (math.inf, -math.inf) else value)
    return converted


def make_readable(tensor: torch.Tensor) -> torch.Tensor:
    """Return the tensor as kernels can read it.

    It has no pending negation, and is not from inference mode where a graph is recorded.
    """
    if torch.compiler.is_compiling():  # which knows neither
        return tensor
    tensor = tensor.resolve_neg()
    return tensor.clone() if tensor.is_inference() and torch.is_grad_enabled() else tensor


def require_values(argument: str, values: torch.Tensor, rule: str, right: torch.Tensor) -> None:
    """Refuse values (any shape) unless all keep the rule; NaN keeps none.

    right  marks those that do; the message shows the first of the others
    """
    if not bool(right.all()):
        wrong = values.detach()[~right]
        refuse(argument, rule, f"{wrong[0].item():g} ({wrong.numel()} of {values.numel()} values)")


def check_settings(tolerance: object, elevation: object) -> tuple[float, float]:
    """Return the tolerance, LEAST_TOLERANCE at least, and the elevation in radians, as floats."""
    tolerance = require_number(
        "tolerance", tolerance, "a positive number", lambda x: 0 < x < math.inf
    )
    return max(tolerance, LEAST_TOLERANCE), require_number(
        "elevation", elevation, "radians in [-π/2, π/2]", lambda x: abs(x) <= math.pi / 2
    )


def check_inputs(
    n: torch.Tensor,
    material: torch.Tensor,
    light: torch.Tensor,
    view: torch.Tensor | None,
    segments: torch.Tensor | None,
    mask: torch.Tensor | None,
    tolerance: float,
    elevation: float,
) -> Inputs:
    """Return the arguments of `render` as `Inputs`. Raises ValueError for what breaks a rule."""
    tolerance, elevation = check_settings(tolerance, elevation)
    require_alike(
        {"n": n, "material": material, "light": light} | ({} if view is None else {"view": view})
    )
    check_shapes(n, material, light, view, mask)
    several = material.ndim == 3
    if several and material.shape[1] != 1 and segments is None:
        refuse(
            "segments", f"ids (B, H, W) for the {material.shape[1]} materials of each image", None
        )
    if segments is not None:
        require_beside("segments", segments, n)
        segments = check_segments(segments, n.shape[:3], material.shape[1] if several else 1)
    n, material, light = make_readable(n), make_readable(material), make_readable(light)
    view = None if view is None else make_readable(view)
    if segments is not None:
        mask = ((n.detach() != 0).any(-1) if mask is None else mask) & (segments > 0)
    dtype = torch.promote_types(n.dtype, torch.float32)
    m = (material if several else material[:, None]).to(dtype)
    check_values(material.detach(), light.detach())
    n, light, view = n.to(dtype), light.to(dtype), None if view is None else view.to(dtype)
    mask, seen = find_seen_pixels(n, view, mask) if pixel_selection.has_kernels(n) else (mask, None)
    mask = (n.detach() != 0).any(-1) if mask is None else mask
    if seen is None:  # no kernel, or a wrong length that the message has to name
        check_lengths(n.detach(), None if view is None else view.detach(), mask)
    return Inputs(n, m, light, view, segments, mask, tolerance, elevation, seen)


def check_shapes(
    n: torch.Tensor,
    material: torch.Tensor,
    light: torch.Tensor,
    view: torch.Tensor | None,
    mask: torch.Tensor | None,
) -> None:
    """Refuse shapes that do not fit together or are too large, and a mask that is not boolean."""
    require_shape("n", n, "shape (B, H, W, 3)", n.ndim == 4 and n.shape[3] == 3)
    images, picture = n.shape[0], n.shape[:3]
    if picture.numel() > MOST_PIXELS:
        refuse(
            "n",
            f"at most {MOST_PIXELS} pixels in one call",
            f"{tuple(n.shape)}; render the batch in parts",
        )
    rule = f"shape ({images}, {SIZE}), or ({images}, S, {SIZE}) with segments"
    require_shape(
        "material",
        material,
        rule,
        material.ndim in (2, 3) and material.shape[0] == images and material.shape[-1] == SIZE,
    )
    right = (
        light.ndim == 4
        and light.shape[0] == images
        and light.shape[3] == 3
        and min(light.shape[1:3]) > 0
    )
    require_shape("light", light, f"shape ({images}, Hl, Wl, 3)", right)
    if light.shape[1] * light.shape[2] > MOST_TEXELS:
        refuse(
            "light",
            f"at most {MOST_TEXELS} texels",
            f"{tuple(light.shape)}; resize it (shaders.envmap.resize)",
        )
    if view is not None:
        require_shape("view", view, f"the shape of n, {tuple(n.shape)}", view.shape == n.shape)
    if mask is not None:
        require_beside("mask", mask, n)
        require_shape("mask", mask, f"shape {tuple(picture)}", mask.shape == picture)
        if mask.dtype != torch.bool:
            refuse("mask", "dtype torch.bool", mask.dtype)


def find_seen_pixels(
    n: torch.Tensor, view: torch.Tensor | None, mask: torch.Tensor | None
) -> tuple[torch.Tensor | None, torch.Tensor | None]:
    """Return the mask and the pixels that are seen, each (B, H, W) bool, by one kernel.

    Without a mask it is where n is not 0. The second is None if a length inside the mask is wrong.
    """
    states = pixel_selection.states(n, view, mask, LENGTH_TOLERANCE, HORIZON).reshape(n.shape[:3])
    if states.size and states.max() == WRONG:
        return mask, None
    mask = torch.from_numpy(states > OUTSIDE) if mask is None else mask
    return mask, torch.from_numpy(states == SEEN)


def check_segments(segments: torch.Tensor, picture: torch.Size, materials: int) -> torch.Tensor:
    """Return the segments (B, H, W) as int64. Refuse ids that no material belongs to."""
    require_shape("segments", segments, f"shape {tuple(picture)}", segments.shape == picture)
    if segments.dtype not in INTEGERS:
        refuse("segments", "an integer dtype", segments.dtype)
    # torch has no minimum and no comparison of most unsigned ones
    segments = segments.to(torch.int64)
    if segments.numel():
        low, high = segments.min().item(), segments.max().item()
        if low < 0 or high > materials:
            refuse(
                "segments",
                f"ids 0 (background) … {materials} (the materials given)",
                f"{low} … {high}",
            )
    return segments


def check_lengths(n: torch.Tensor, view: torch.Tensor | None, mask: torch.Tensor) -> None:
    """Refuse vectors (B, H, W, 3) that are not of unit length inside the mask; view may be None."""
    for argument, vectors in (("n", n), ("view", view)):
        if vectors is not None:
            length = vectors.float().norm(dim=-1)
            right = (length - 1).abs() <= LENGTH_TOLERANCE
            if not bool((right | ~mask).all()):
                rule = f"unit vectors inside the mask (length 1 ± {LENGTH_TOLERANCE})"
                require_values(argument, length[mask], rule, right[mask])


def check_values(material: torch.Tensor, light: torch.Tensor) -> None:
    """Refuse radiance or control values that are negative or not finite."""
    kappa, gamma = material.reshape(*material.shape[:-1], *SHAPE).unbind(-2)
    if are_in_range(light) and are_in_range(kappa) and are_in_range(gamma, above=True):
        return
    require_values("light", light, "finite radiance ≥ 0", (light >= 0) & light.isfinite())
    require_values(
        "material",
        kappa,
        "finite κ ≥ 0 (control values, not logarithms)",
        (kappa >= 0) & kappa.isfinite(),
    )
    require_values(
        "material",
        gamma,
        "finite γ > 0 (control values, not logarithms)",
        (gamma > 0) & gamma.isfinite(),
    )


def are_in_range(values: torch.Tensor, above: bool = False) -> bool:
    """Return whether all values are finite, and at least 0 or, where `above`, larger than 0."""
    if not values.numel():
        return True
    if values.stride(0) == 0:  # one tensor expanded over the batch
        values = values[:1]
    low, high = (x.item() for x in values.aminmax())
    return (low > 0 if above else low >= 0) and high < math.inf
