"""Radiance for a distant viewer as `auto` plans it: each group of lobes by a strategy of its own.

All maps are resampled at the nodes of the largest, so that there is one look-up
for each pixel. Everything between the tensors and the radiance is numpy and kernels, one step for
autograd; `Sums` stores what the backward pass needs.

n (P, 3), m (3, 3, 2, 6), light (height, width, 3), all float32 on the CPU with kernels at hand.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from learn.engines.derivatives import Context, Step, last
from learn.engines.lights import Rotation
from learn.methods import coarse, reflectance_map, refusal
from learn.methods.block_lists import Listing, Tables


@dataclass(frozen=True)
class Strategy:
    """How a group of lobes is summed.

    lobes   their numbers
    size    nodes along a side of their reflectance map, 0 where they are summed at the pixels
    level   of the light's detail (learn/methods/coarse.py)
    culled  radiance that a pixel's list may leave out, in tolerances
    views, mirrored  with a view per pixel (learn/methods/planned_views.py): the number of views for
            which maps are made, and whether these are read where they mirror the same light
    """

    lobes: tuple[int, ...]
    size: int
    level: int
    culled: float
    views: int = 1
    mirrored: bool = False


class Scene:
    """What all strategies share: normals, material, light at its levels, and the tables of both."""

    def __init__(
        self,
        n: np.ndarray,
        m: np.ndarray,
        light: np.ndarray,
        rotation: Rotation,
        light_gradient: bool = True,
        material_gradient: bool = False,
    ):
        self.n, self.m, self.light = n, m, coarse.Light(light, rotation)
        self.light_gradient, self.material_gradient = light_gradient, material_gradient
        self.budget = 0.0  # tolerance × mean radiance: the unit of a strategy's `culled`
        self.tables: dict[tuple[tuple[int, ...], int], Tables] = {}
        self.list_bytes = 0

    @property
    def texels(self) -> int:
        """Texels of the light."""
        return self.light.height * self.light.width

    def truth(self, pick: np.ndarray, lobes: tuple[int, ...]) -> np.ndarray:
        """Return the sum over all lights (S, 3) at pixels pick (S,)."""
        return self.list_lobes(self.n[pick], lobes).radiance

    def sums(self, strategies: "Sequence[Strategy]", known: "dict[Strategy, Sum]") -> "Sums":
        """Return the `Sums` of strategies; known: sums that have been made before."""
        return Sums(self, strategies, known)

    def list_lobes(
        self, normals: np.ndarray, lobes: tuple[int, ...], level: int = 0, left_out: float = 0.0
    ) -> Listing:
        """Return the `Listing` of some lobes at normals (N, 3)."""
        if (lobes, level) not in self.tables:
            lights, energy = self.light.at(level)
            self.tables[lobes, level] = Tables(
                self.m, energy, lights, self.light_gradient, lobes, self.material_gradient
            )
        listing = Listing(normals, self.tables[lobes, level], left_out, self.list_bytes)
        self.list_bytes += listing.list_bytes
        return listing


class Sum:
    """One strategy's radiance: at the nodes of its map, or at the pixels."""

    def __init__(self, scene: Scene, strategy: Strategy, within: np.ndarray):
        """within: (N, 3) normals at which the map will be read."""
        self.scene, self.strategy = scene, strategy
        self.nodes, self.normals = np.empty(0, int), scene.n
        if strategy.size:
            self.nodes = reflectance_map.nodes_for(within, strategy.size)
            self.normals = reflectance_map.normals(self.nodes, strategy.size).astype(np.float32)
        self.listing = scene.list_lobes(
            self.normals, strategy.lobes, strategy.level, strategy.culled * scene.budget
        )
        self.values = self.listing.radiance

    def table(self) -> np.ndarray:
        """Return the map's table for the kernels."""
        return reflectance_map.kernel_table(self.values, self.nodes, self.strategy.size)

    def at_sample(self, pick: np.ndarray) -> np.ndarray:
        """Return radiance (S, 3) at pixels pick (S,)."""
        if not self.strategy.size:
            return self.values[pick]
        return reflectance_map.read_values(self.scene.n[pick], self.table(), self.strategy.size)

    def error(self, pick: np.ndarray, truth: np.ndarray) -> float:
        """Return the mean absolute difference from truth (S, 3) at pixels pick (S,)."""
        return float(np.abs(self.at_sample(pick) - truth).mean())


class Sums:
    """All strategies together: one map that the pixels look up, and the sums at the pixels."""

    def __init__(self, scene: Scene, strategies: Sequence[Strategy], known: dict[Strategy, Sum]):
        """known: sums that have been made before; new ones are added."""
        self.scene = scene
        mapped = sorted(
            (strategy for strategy in strategies if strategy.size),
            key=lambda strategy: -strategy.size,
        )
        for strategy in [strategy for strategy in strategies if not strategy.size] + mapped[:1]:
            if strategy not in known:
                known[strategy] = Sum(scene, strategy, scene.n)
        self.at_pixels = [known[strategy] for strategy in strategies if not strategy.size]
        self.largest = known[mapped[0]] if mapped else None
        self.smaller: list[Sum] = []
        if self.largest:
            self.size, total = self.largest.strategy.size, self.largest.values
            for strategy in mapped[1:]:
                same = strategy.size == self.size
                part = Sum(scene, strategy, scene.n if same else self.largest.normals)
                self.smaller.append(part)
                total = total + (
                    part.values
                    if same
                    else reflectance_map.read_values(
                        self.largest.normals, part.table(), strategy.size
                    )
                )
            self.table = reflectance_map.kernel_table(total, self.largest.nodes, self.size)

    def parts(self) -> list[Sum]:
        """Return the sum of each strategy."""
        return [*self.at_pixels, *([self.largest] if self.largest else []), *self.smaller]

    def at_sample(self, pick: np.ndarray) -> np.ndarray:
        """Return radiance (S, 3) at pixels pick (S,)."""
        results = [part.values[pick] for part in self.at_pixels]
        if self.largest:
            results.append(reflectance_map.read_values(self.scene.n[pick], self.table, self.size))
        return functools.reduce(np.add, results)

    def radiance(self) -> np.ndarray:
        """Return radiance (P, 3)."""
        result = (
            [reflectance_map.read_values(self.scene.n, self.table, self.size)]
            if self.largest
            else []
        )
        result += [part.values for part in self.at_pixels]
        return functools.reduce(np.add, result) if result else 0 * self.scene.n

    def backward(
        self, g: np.ndarray, with_n: bool
    ) -> tuple[np.ndarray | None, np.ndarray, np.ndarray]:
        """Return derivatives of Σ g·radiance by n (None unless with_n), m and light."""
        by_n: np.ndarray | None = None
        by_m, by_light = np.zeros((3, 3, 2, 6)), np.zeros_like(self.scene.light.E)
        gradients = [(part, g, with_n) for part in self.at_pixels]
        if self.largest:
            by_n, by_values = reflectance_map.read_backward(
                self.scene.n, self.table, self.size, g, self.largest.nodes
            )
            gradients.append((self.largest, by_values, False))
            for part in self.smaller:
                below = by_values
                if part.strategy.size != self.size:
                    _, below = reflectance_map.read_backward(
                        self.largest.normals,
                        part.table(),
                        part.strategy.size,
                        by_values,
                        part.nodes,
                    )
                gradients.append((part, below, False))
        for part, by_values, requested in gradients:
            by_part_n, by_part_m, by_E = part.listing.backward(by_values, requested)
            by_n = by_n if by_part_n is None else by_part_n if by_n is None else by_n + by_part_n
            by_m += by_part_m
            by_light = by_light + self.scene.light.gradient(by_E, part.strategy.level)
        return by_n, by_m, np.ascontiguousarray(by_light.transpose(1, 2, 0))


# (n, m, light, gradients) → `Sums`, all arrays; gradients: which derivatives are requested, by n, m
# and light
Plan = Callable[[np.ndarray, np.ndarray, np.ndarray, Sequence[bool]], Sums]


class Planned(Step):
    """A planned sum for autograd: n (P, 3), m (3, 3, 2, 6), light, `Plan` → radiance (P, 3)."""

    @staticmethod
    def forward(
        ctx: Context, n: torch.Tensor, m: torch.Tensor, light: torch.Tensor, plan: Plan
    ) -> torch.Tensor:
        ctx.refusal = refusal("auto")
        ctx.save_for_backward(n, m, light)
        ctx.sums = plan(
            np.ascontiguousarray(n.numpy()),
            m.double().numpy(),
            light.numpy(),
            ctx.needs_input_grad[:3],
        )
        return torch.from_numpy(ctx.sums.radiance())

    @staticmethod
    @last
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        by_n, by_m, by_light = ctx.sums.backward(
            np.ascontiguousarray(g.numpy()), ctx.needs_input_grad[0]
        )
        if by_n is None:
            by_n = np.zeros_like(ctx.sums.scene.n)
        return (
            torch.from_numpy(by_n),
            torch.from_numpy(by_m).float(),
            torch.from_numpy(by_light),
            None,
        )


def radiance(n: torch.Tensor, m: torch.Tensor, light: torch.Tensor, plan: Plan) -> torch.Tensor:
    return Planned.apply(n, m, light, plan)
