"""The catalogue of rendering methods: how radiance is summed over the light, one method a module.

A method is a module of this folder with two names:

    CARD                         a `Card`: what it approximates, its error, cost, memory and needs
    radiance(batch, tolerance)   (P, 3) outgoing radiance of a `Batch`'s pixels, differentiable in its tensors

P pixels, G groups (one image and segment each; pixels lie sorted by group), B images.
"""

import importlib
from dataclasses import dataclass

import torch

from manifests.problems import closest

NAMES = ("exact", "quadrature")  # modules of this folder; what they need is imported when they are first used
HORIZON = 1e-4  # pixels with n·v below it are not rendered: c = h·n then stays above half of it (facts: slope of c^γ at 0)


@dataclass(frozen=True)
class Card:
    """What a method promises.

    name          the module's name, and the value of render's `method`
    approximates  in words: what is replaced by what
    error         the claim: largest relative error (mean absolute over mean) against the paper's sum, or None: no bound
    cost          in words: how time grows with pixels, lights and materials
    memory        in words: beyond inputs and outputs
    needs         names among {"orthographic", "numba", "triton", "cuda"}
    """

    name: str
    approximates: str
    error: float | None
    cost: str
    memory: str
    needs: frozenset = frozenset()


@dataclass(frozen=True)
class Batch:
    """Pixels to render, checked and compacted: what a method is given. There is at least one pixel, and no empty group.

    n                  (P, 3) unit normals, camera frame, n·v > HORIZON
    view               (P, 3) unit vectors to the viewer, camera frame, or None: (0, 0, 1) for every pixel
    m                  (G, 3, 3, 2, 6) κ and γ control values of each group
    light              (B, Hl, Wl, 3) linear radiance, light frame
    counts             pixels of each group; they lie one group after the other and sum to P
    light_of           index into `light` of each group
    camera_from_light  (3, 3) rotation, constant, float64 on the CPU whatever the rest is
    """

    n: torch.Tensor
    view: torch.Tensor | None
    m: torch.Tensor
    light: torch.Tensor
    counts: tuple
    light_of: tuple
    camera_from_light: torch.Tensor


def load(name):
    """The module of a method."""
    if name not in NAMES:
        raise ValueError(f'method: "auto" or one of {", ".join(NAMES)} expected, found {name!r}; {closest(name, NAMES)}')
    return importlib.import_module(f"learn.methods.{name}")


def choose(batch, tolerance):
    """The name of the cheapest method that keeps `tolerance` for this batch."""
    return "exact"


def by_group(batch, function):
    """Radiance (P, 3) by a function of one group: function(n (p, 3), view (p, 3) or None, m (3, 3, 2, 6), light (Hl, Wl, 3)) → (p, 3)."""
    n = batch.n.split(batch.counts)
    view = batch.view.split(batch.counts) if batch.view is not None else [None] * len(n)
    return torch.cat([function(n[g], view[g], batch.m[g], batch.light[batch.light_of[g]]) for g in range(len(n))])
