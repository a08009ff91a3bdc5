"""The catalogue of rendering methods: how radiance is summed over the light, one per module.

A method is a module of this folder with two names:

    CARD                         a `Card`: what it approximates, its error, cost, memory and needs
    radiance(batch, tolerance)   (P, 3) outgoing radiance of a `Batch`'s pixels, differentiable in
                                 its tensors

P pixels, G groups (one image and segment each; pixels lie sorted by group), B images.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType

import torch

from learn.engines import derivatives
from manifests.errors import closest

NAMES = (  # modules of this folder; what they need is imported when they are first used
    "auto",
    "exact",
    "culled",
    "reflectance_map",
    "median_cut",
    "hybrid",
    "quadrature",
    "spherical_harmonics",
    "split_sum",
    "spherical_gaussians",
    "monte_carlo",
    "monte_carlo_light",
    "monte_carlo_brdf",
)
# reasons, for `forbid_second_derivatives`, why there is no second derivative
COMPILED = "whose compiled sums have first derivatives only"
HELD_LIGHTS = "which holds the directions of its lights where the light changes"
HELD_SAMPLES = "which holds its samples where the scene changes"
# pixels with n·v below it are not rendered: c = h·n then stays above half of it (facts: slope of
# c^γ at 0)
HORIZON = 1e-4


@dataclass(frozen=True)
class Card:
    """The claims of a method.

    name          the module's name, and the value of render's `method`
    approximates  in words: the term and its replacement
    error         the claim: largest relative error (mean absolute over mean) against the paper's
                  sum at tolerance 1e-2, or None: no bound
    cost          in words: how time grows with pixels, lights and materials
    memory        in words: beyond inputs and outputs
    needs         names among {"orthographic", "numba", "triton", "cuda"}
    gradient      the same claim for derivatives by n, material, light and view, or None
    """

    name: str
    approximates: str
    error: float | None
    cost: str
    memory: str
    needs: frozenset = frozenset()
    gradient: float | None = None


@dataclass(frozen=True)
class Batch:
    """Pixels to render, checked and compacted, in at least one group; no group is empty.

    n                  (P, 3) unit normals, camera frame, n·v > HORIZON
    view               (P, 3) unit vectors to the viewer, camera frame, or None: (0, 0, 1) for every
                       pixel
    m                  (G, 3, 3, 2, 6) κ and γ control values of each group
    light              (B, Hl, Wl, 3) linear radiance, light frame
    counts             pixels of each group; they lie one group after the other and sum to P
    light_of           index into `light` of each group
    camera_from_light  (3, 3) rotation, constant, float64 on the CPU
    one_material       whether all groups have the same tensor for their material
    """

    n: torch.Tensor
    view: torch.Tensor | None
    m: torch.Tensor
    light: torch.Tensor
    counts: tuple[int, ...]
    light_of: tuple[int, ...]
    camera_from_light: torch.Tensor
    one_material: bool = False


def load(name: object) -> ModuleType:
    """Return the module of a method."""
    if not isinstance(name, str):
        raise ValueError(f"method: expected one of {', '.join(NAMES)}, found {type(name).__name__}")
    if name not in NAMES:
        raise ValueError(
            f"method: expected one of {', '.join(NAMES)}, found {name[:60]!r}"
            f" ({closest(name[:60], NAMES)})"
        )
    return importlib.import_module(f"learn.methods.{name}")


def refusal(name: str, why: str = COMPILED) -> str:
    """Return the error message where a method's derivatives are differentiated again.

    why  the reason
    """
    return (
        f'method: expected "exact" where derivatives are differentiated again, found "{name}",'
        f' {why} (render with method="exact")'
    )


def wants_gradient(*tensors: torch.Tensor | None) -> bool:
    """Return whether a derivative by any of the tensors (or None) can be requested."""
    return torch.is_grad_enabled() and any(x is not None and x.requires_grad for x in tensors)


def forbid_second_derivatives(batch: Batch, name: str, why: str) -> Batch:
    """Return the batch for a method that has first derivatives only; it costs 0.1 ms."""
    tensors = [batch.n, batch.m, batch.light]
    if batch.view is not None:
        tensors.append(batch.view)
    n, m, light, *views = derivatives.forbid_second_derivatives(refusal(name, why), *tensors)
    return replace(batch, n=n, m=m, light=light, view=views[0] if views else None)


def radiance_by_group(batch: Batch, function: Callable[..., torch.Tensor]) -> torch.Tensor:
    """Return radiance (P, 3) by a function of one group.

    function  n (p, 3), view (p, 3) or None, m (3, 3, 2, 6), light (Hl, Wl, 3) → (p, 3)
    """
    return radiance_by_numbered_group(batch, lambda _, *arguments: function(*arguments))


def radiance_by_numbered_group(batch: Batch, function: Callable[..., torch.Tensor]) -> torch.Tensor:
    """As `radiance_by_group`, with the group's number as the first argument."""
    # without a copy, for which torch would wake its threads (learn/engines/pixel_selection.py)
    if len(batch.counts) == 1:
        return function(0, batch.n, batch.view, batch.m[0], batch.light[batch.light_of[0]])
    n = batch.n.split(batch.counts)
    view = [None] * len(n) if batch.view is None else batch.view.split(batch.counts)
    return torch.cat(
        [
            function(g, n[g], view[g], batch.m[g], batch.light[batch.light_of[g]])
            for g in range(len(n))
        ]
    )


def merge_groups(batch: Batch) -> Batch:
    """Return the batch with neighbouring groups merged where they share one material and one light.

    Shared means one tensor expanded over the batch (stride 0 in memory). Groups whose material or
    light is merely equal stay separate, so that no picture's bits depend on the rest of the batch.
    """
    one_light = batch.light.stride(0) == 0
    counts, first = [batch.counts[0]], [0]
    for g in range(1, len(batch.counts)):
        if batch.one_material and (one_light or batch.light_of[first[-1]] == batch.light_of[g]):
            counts[-1] += batch.counts[g]
        else:
            counts.append(batch.counts[g])
            first.append(g)
    if len(counts) == len(batch.counts):
        return batch
    return replace(
        batch,
        m=batch.m[first],
        counts=tuple(counts),
        light_of=tuple(batch.light_of[g] for g in first),
    )
