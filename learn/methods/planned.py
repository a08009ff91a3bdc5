"""Radiance for a distant viewer as `auto` plans it: groups of lobes, each by a map or at the pixels, under as many lights as it needs.

A `Way` says how a group of lobes goes: lobes; size of its map, 0 where it is summed at the pixels; level of the light's detail
(learn/methods/coarse.py); culled, what a pixel's list may leave out, in tolerances. All maps are resampled at the nodes of the largest, so
that there is one look-up for each pixel. Everything between the tensors handed in and the radiance is numpy and kernels, one step for
autograd: `sums` holds what the backward pass needs.

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
class Way:
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
            self.tables[lobes, level] = Tables(self.m, energy, lights, self.light_gradient, lobes, self.material_gradient)
        listing = Listing(normals, self.tables[lobes, level], left_out, self.kept)
        self.kept += listing.kept
        return listing


class Sum:
    """One way's radiance: at the nodes of its map, or at the pixels."""

    def __init__(self, scene, way, within):
        """within: (N, 3) normals that the map must serve; the pixels themselves where there is none."""
        self.scene, self.way = scene, way
        self.nodes = reflectance_map.nodes_for(within, way.size) if way.size else None
        self.normals = reflectance_map.normals(self.nodes, way.size).astype(np.float32) if way.size else scene.n
        self.listing = scene.at(self.normals, way.lobes, way.level, way.culled * scene.budget)
        self.values = self.listing.radiance

    def table(self):
        return reflectance_map.table(self.values, self.nodes, self.way.size)

    def at_sample(self, pick):
        """(S, 3) at pixels pick (S,)."""
        if not self.way.size:
            return self.values[pick]
        return reflectance_map.read(self.scene.n[pick], self.table(), self.way.size)

    def error(self, pick, truth):
        """Mean absolute difference from truth (S, 3) at pixels pick (S,)."""
        return float(np.abs(self.at_sample(pick) - truth).mean())


class Sums:
    """All ways together: one map that the pixels look up, and the sums at the pixels."""

    def __init__(self, scene, ways, known):
        """known: {way: Sum} of sums that have been made before, added to."""
        self.scene = scene
        mapped = sorted((way for way in ways if way.size), key=lambda way: -way.size)
        for way in [way for way in ways if not way.size] + mapped[:1]:
            if way not in known:
                known[way] = Sum(scene, way, scene.n)
        self.at_pixels = [known[way] for way in ways if not way.size]
        self.largest = known[mapped[0]] if mapped else None
        self.smaller = [Sum(scene, way, scene.n if way.size == self.size else self.largest.normals) for way in mapped[1:]]
        if mapped:
            total = self.largest.values
            for part in self.smaller:
                same = part.way.size == self.size
                total = total + (part.values if same else reflectance_map.read(self.largest.normals, part.table(), part.way.size))
            self.table = reflectance_map.table(total, self.largest.nodes, self.size)

    @property
    def size(self):
        return self.largest.way.size

    def parts(self):
        return [*self.at_pixels, *([self.largest] if self.largest else []), *self.smaller]

    def at_sample(self, pick):
        """(S, 3) at pixels pick (S,)."""
        found = [part.values[pick] for part in self.at_pixels]
        return sum(found + ([reflectance_map.read(self.scene.n[pick], self.table, self.size)] if self.largest else []))

    def radiance(self):
        """(P, 3)."""
        found = [reflectance_map.read(self.scene.n, self.table, self.size)] if self.largest else []
        found += [part.values for part in self.at_pixels]
        return functools.reduce(np.add, found) if found else 0 * self.scene.n

    def backward(self, g, with_n):
        """Derivatives of Σ g·radiance by n (None unless with_n), m and light."""
        by_n, by_m, by_light = None, np.zeros((3, 3, 2, 6)), np.zeros_like(self.scene.light.E)
        given = [(part, g, with_n) for part in self.at_pixels]
        if self.largest:
            by_n, by_values = reflectance_map.read_backward(self.scene.n, self.table, self.size, g, self.largest.nodes)
            given.append((self.largest, by_values, False))
            for part in self.smaller:
                below = by_values
                if part.way.size != self.size:
                    _, below = reflectance_map.read_backward(self.largest.normals, part.table(), part.way.size, by_values, part.nodes)
                given.append((part, below, False))
        for part, by_values, wanted in given:
            by_part_n, by_part_m, by_E = part.listing.backward(by_values, wanted)
            by_n = by_n if by_part_n is None else by_part_n if by_n is None else by_n + by_part_n
            by_m += by_part_m
            by_light = by_light + self.scene.light.gradient(by_E, part.way.level)
        return by_n, by_m, np.ascontiguousarray(by_light.transpose(1, 2, 0))


class Planned(Step):
    """n (P, 3), m (3, 3, 2, 6), light → radiance (P, 3); plan(n, m, light, gradients), of arrays, gives `Sums`.

    gradients  which derivatives are wanted: by n, m and light
    """

    @staticmethod
    def forward(ctx, n, m, light, plan):
        ctx.refusal = refusal("auto")
        ctx.save_for_backward(n, m, light)
        ctx.sums = plan(np.ascontiguousarray(n.numpy()), m.double().numpy(), light.numpy(), ctx.needs_input_grad[:3])
        return torch.from_numpy(ctx.sums.radiance())

    @staticmethod
    @last
    def backward(ctx, g):
        by_n, by_m, by_light = ctx.sums.backward(np.ascontiguousarray(g.numpy()), ctx.needs_input_grad[0])
        if by_n is None:
            by_n = np.zeros_like(ctx.sums.scene.n)
        return torch.from_numpy(by_n), torch.from_numpy(by_m).float(), torch.from_numpy(by_light), None


def radiance(n, m, light, plan):
    return Planned.apply(n, m, light, plan)
