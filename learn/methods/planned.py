"""Radiance for a distant viewer as `auto` plans it: groups of lobes, each by a map or at the
pixels, under as many lights as it needs.

A `Strategy` says how a group of lobes goes: lobes; size of its map, 0 where it is summed at the
pixels; level of the light's detail (learn/methods/coarse.py); culled, what a pixel's list may leave
out, in tolerances. All maps are resampled at the nodes of the largest, so that there is one look-up
for each pixel. Everything between the tensors handed in and the radiance is numpy and kernels, one
step for autograd: `sums` holds what the backward pass needs.

n (P, 3), m (3, 3, 2, 6), light (height, width, 3), all float32 on the CPU with kernels at hand.
"""

import functools
from dataclasses import dataclass

import numpy as np
import torch

from learn.engines.derivatives import Step, last
from learn.methods import coarse, reflectance_map, refusal
from learn.methods.directional import Listing, Tables


@dataclass(frozen=True)
class Strategy:
    lobes: tuple
    size: int
    level: int
    culled: float


class Scene:
    """What all ways share: normals, material, light at its levels, and the tables of both."""

    def __init__(self, n, m, light, rotation, light_gradient=True, material_gradient=False):
        self.n, self.m, self.light = n, m, coarse.Light(light, rotation)
        self.light_gradient, self.material_gradient = light_gradient, material_gradient
        self.budget = 0.0  # tolerance × mean radiance: what a way's `culled` multiplies
        self.tables, self.kept = {}, 0

    def at(self, normals, lobes, level=0, left_out=0.0):
        """The `Listing` of some lobes at normals (N, 3)."""
        if (lobes, level) not in self.tables:
            lights, energy = self.light.at(level)
            self.tables[lobes, level] = Tables(
                self.m, energy, lights, self.light_gradient, lobes, self.material_gradient
            )
        listing = Listing(normals, self.tables[lobes, level], left_out, self.kept)
        self.kept += listing.kept
        return listing


class Sum:
    """One way's radiance: at the nodes of its map, or at the pixels."""

    def __init__(self, scene, strategy, within):
        """within: (N, 3) normals that the map must serve; the pixels themselves where there is
        none.
        """
        self.scene, self.strategy = scene, strategy
        self.nodes = reflectance_map.nodes_for(within, strategy.size) if strategy.size else None
        self.normals = (
            reflectance_map.normals(self.nodes, strategy.size).astype(np.float32)
            if strategy.size
            else scene.n
        )
        self.listing = scene.at(
            self.normals, strategy.lobes, strategy.level, strategy.culled * scene.budget
        )
        self.values = self.listing.radiance

    def table(self):
        return reflectance_map.table(self.values, self.nodes, self.strategy.size)

    def at_sample(self, pick):
        """(S, 3) at pixels pick (S,)."""
        if not self.strategy.size:
            return self.values[pick]
        return reflectance_map.read(self.scene.n[pick], self.table(), self.strategy.size)

    def error(self, pick, truth):
        """Mean absolute difference from truth (S, 3) at pixels pick (S,)."""
        return float(np.abs(self.at_sample(pick) - truth).mean())


class Sums:
    """All ways together: one map that the pixels look up, and the sums at the pixels."""

    def __init__(self, scene, strategies, known):
        """known: {way: Sum} of sums that have been made before, added to."""
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
        self.smaller = [
            Sum(scene, strategy, scene.n if strategy.size == self.size else self.largest.normals)
            for strategy in mapped[1:]
        ]
        if mapped:
            total = self.largest.values
            for part in self.smaller:
                same = part.strategy.size == self.size
                total = total + (
                    part.values
                    if same
                    else reflectance_map.read(
                        self.largest.normals, part.table(), part.strategy.size
                    )
                )
            self.table = reflectance_map.table(total, self.largest.nodes, self.size)

    @property
    def size(self):
        return self.largest.strategy.size

    def parts(self):
        return [*self.at_pixels, *([self.largest] if self.largest else []), *self.smaller]

    def at_sample(self, pick):
        """(S, 3) at pixels pick (S,)."""
        results = [part.values[pick] for part in self.at_pixels]
        return sum(
            results
            + (
                [reflectance_map.read(self.scene.n[pick], self.table, self.size)]
                if self.largest
                else []
            )
        )

    def radiance(self):
        """(P, 3)."""
        result = [reflectance_map.read(self.scene.n, self.table, self.size)] if self.largest else []
        result += [part.values for part in self.at_pixels]
        return functools.reduce(np.add, result) if result else 0 * self.scene.n

    def backward(self, g, with_n):
        """Derivatives of Σ g·radiance by n (None unless with_n), m and light."""
        by_n, by_m, by_light = None, np.zeros((3, 3, 2, 6)), np.zeros_like(self.scene.light.E)
        given = [(part, g, with_n) for part in self.at_pixels]
        if self.largest:
            by_n, by_values = reflectance_map.read_backward(
                self.scene.n, self.table, self.size, g, self.largest.nodes
            )
            given.append((self.largest, by_values, False))
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
                given.append((part, below, False))
        for part, by_values, requested in given:
            by_part_n, by_part_m, by_E = part.listing.backward(by_values, requested)
            by_n = by_n if by_part_n is None else by_part_n if by_n is None else by_n + by_part_n
            by_m += by_part_m
            by_light = by_light + self.scene.light.gradient(by_E, part.strategy.level)
        return by_n, by_m, np.ascontiguousarray(by_light.transpose(1, 2, 0))


class Planned(Step):
    """n (P, 3), m (3, 3, 2, 6), light → radiance (P, 3); plan(n, m, light, gradients), of arrays,
    gives `Sums`.

    gradients  which derivatives are wanted: by n, m and light
    """

    @staticmethod
    def forward(ctx, n, m, light, plan):
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
    def backward(ctx, g):
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


def radiance(n, m, light, plan):
    return Planned.apply(n, m, light, plan)
