"""Radiance for a view per pixel as `auto` plans it: each group of lobes by a strategy of its own.

Lobes whose highlights are narrower than a map's nodes could follow are summed at the pixels
(learn/methods/viewed_lists.py). The others are summed at the nodes of one to six reflectance maps,
of which learn/methods/view_places.py tells where the pixels read them.

n, view (P, 3), m (3, 3, 2, 6), light (height, width, 3), all float32 on the CPU with kernels at
hand.
"""

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from learn.engines.derivatives import Context, Step, last
from learn.engines.lights import Rotation
from learn.methods import coarse, lobe_shapes, reflectance_map, refusal
from learn.methods.planned import Strategy
from learn.methods.view_places import Chart, Places, Views, dot
from learn.methods.viewed_lists import ViewedListing, ViewedTables

# longest difference of a view from that of the run that it shares, at a tolerance of 1e-2; the
# error is of second order in it
VIEW_GAP = 0.15


class Scene:
    """What all strategies share: pixels, material, light at its levels, and the tables of both."""

    def __init__(
        self,
        n: np.ndarray,
        view: np.ndarray,
        m: np.ndarray,
        light: np.ndarray,
        rotation: Rotation,
        tolerance: float,
        view_gradient: bool = False,
        material_gradient: bool = False,
        light_gradient: bool = True,
    ):
        self.n, self.view, self.m, self.light = n, view, m, coarse.Light(light, rotation)
        self.light_gradient, self.material_gradient = light_gradient, material_gradient
        self.view_gradient, self.tolerance = view_gradient, tolerance
        self.view_gap = VIEW_GAP * min(math.sqrt(tolerance / 1e-2), 1.0)
        self.budget = 0.0  # tolerance × mean radiance: the unit of a strategy's `culled`
        self.tables: dict[tuple[tuple[int, ...], int], ViewedTables] = {}
        self.places: dict[bool, Places] = {}
        self.charts: dict[bool, Chart] = {}
        self.list_bytes = 0
        self.pick = np.empty(0, np.int64)  # the sample on which the picture is checked
        self.truths: dict[tuple[int, tuple[int, ...]], np.ndarray] = {}
        sharpness, strength = lobe_shapes.sharpness(m), lobe_shapes.strength(m)
        self.sharpness = np.where(sharpness > 0, sharpness, lobe_shapes.sharpness(m, dark=True))
        self.shares = strength / max(strength.sum(), 1e-300)
        self.steepness = lobe_shapes.steepness(m)

    @property
    def texels(self) -> int:
        """Texels of the light."""
        return self.light.height * self.light.width

    @functools.cached_property
    def views(self) -> Views:
        """The views and their fit."""
        return Views(self.n, self.view)

    def where(self, mirrored: bool) -> tuple[Places, Chart]:
        """Where maps are read."""
        if mirrored not in self.places:
            self.places[mirrored] = Places(self.n, self.view, self.views, mirrored)
            self.charts[mirrored] = Chart(self.places[mirrored].n, self.views.frame)
        return self.places[mirrored], self.charts[mirrored]

    def at(
        self,
        normals: np.ndarray,
        view: np.ndarray,
        lobes: tuple[int, ...],
        level: int = 0,
        left_out: float = 0.0,
        view_gap: float = 0.0,
    ) -> ViewedListing:
        """The `ViewedListing` of some lobes at normals and views (N, 3)."""
        if (lobes, level) not in self.tables:
            lights, energy = self.light.at(level)
            self.tables[lobes, level] = ViewedTables(
                self.m, energy, lights, self.light_gradient, lobes, self.material_gradient
            )
        stored = self.list_bytes
        listing = ViewedListing(
            normals, view, self.tables[lobes, level], left_out, stored, view_gap
        )
        self.list_bytes += listing.list_bytes
        return listing

    def truth(self, pick: np.ndarray, lobes: tuple[int, ...]) -> np.ndarray:
        """The sum over all lights (S, 3) at pixels pick (S,); pick: one sample for each size."""
        self.pick = pick
        if (len(pick), lobes) not in self.truths:
            sums = self.at(self.n[pick], self.view[pick], lobes)
            self.truths[len(pick), lobes] = sums.radiance
        return self.truths[len(pick), lobes]

    def light_loss(self, lobes: tuple[int, ...], level: int) -> float:
        """Mean absolute error on the sample of some lobes by a level of the light."""
        seen = self.at(self.n[self.pick], self.view[self.pick], lobes, level).radiance
        return float(np.abs(seen - self.truth(self.pick, lobes)).mean())

    def sums(self, strategies: Sequence[Strategy], known: "dict[Strategy, Sum]") -> "Sums":
        """The `Sums` of strategies; known: sums that have been made before."""
        return Sums(self, strategies, known)


class Sum:
    """One strategy's radiance at the pixels, (P, 3): `values`."""

    def __init__(self, scene: Scene, strategy: Strategy):
        self.scene, self.strategy = scene, strategy
        budget, count = strategy.culled * scene.budget, strategy.views
        lobes, level, size = strategy.lobes, strategy.level, strategy.size
        if not size:
            normals, views = scene.n, scene.view
        else:
            places, chart = scene.where(strategy.mirrored)
            self.nodes = reflectance_map.nodes_for(chart.drawn, size)
            drawn = reflectance_map.normals(self.nodes, size)
            normals, views = (
                np.ascontiguousarray(a.reshape(-1, 3))
                for a in scene.views.beside(chart.normals(drawn), count, strategy.mirrored)
            )
        self.listing = scene.at(normals, views, lobes, level, budget, scene.view_gap)
        self.values = self.listing.radiance
        if size:
            self.maps = [
                reflectance_map.table(values, self.nodes, size)
                for values in self.values.reshape(count, -1, 3)
            ]
            self.read = [reflectance_map.read(chart.drawn, table, size) for table in self.maps]
            self.weights = places.weights(count)[:, :, None] if count > 1 else np.ones((1, 1, 1))
            self.values = functools.reduce(
                np.add,
                (w.astype(np.float32) * r for w, r in zip(self.weights, self.read, strict=True)),
            )

    def error(self, pick: np.ndarray, truth: np.ndarray) -> float:
        """Mean absolute difference from truth (S, 3) at pixels pick (S,)."""
        return float(np.abs(self.values[pick] - truth).mean())


class Sums:
    """All strategies together."""

    def __init__(self, scene: Scene, strategies: Sequence[Strategy], known: dict[Strategy, Sum]):
        """known: sums that have been made before; new ones are added."""
        self.scene = scene
        for strategy in strategies:
            if strategy not in known:
                known[strategy] = Sum(scene, strategy)
        self.all = [known[strategy] for strategy in strategies]

    def parts(self) -> list[Sum]:
        """The sum of each strategy."""
        return self.all

    def at_sample(self, pick: np.ndarray) -> np.ndarray:
        """Radiance (S, 3) at pixels pick (S,)."""
        return functools.reduce(np.add, [part.values[pick] for part in self.all])

    def radiance(self) -> np.ndarray:
        """Radiance (P, 3)."""
        return functools.reduce(
            np.add, [part.values for part in self.all], np.zeros_like(self.scene.n)
        )

    def backward(
        self, g: np.ndarray, with_view: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of Σ g·radiance by n, view, m and light."""
        by_n, by_view = np.zeros_like(self.scene.n), np.zeros_like(self.scene.n)
        by_m, by_light = np.zeros((3, 3, 2, 6)), np.zeros_like(self.scene.light.E)
        by_place: dict[bool, tuple[np.ndarray, np.ndarray]] = {}
        for part in self.all:
            strategy = part.strategy
            if strategy.size:
                drawn, slopes, values = self.read_backward(part, g)
                before = by_place.get(strategy.mirrored)
                by_place[strategy.mirrored] = (
                    (drawn, slopes) if before is None else (before[0] + drawn, before[1] + slopes)
                )
                _, _, by_part_m, by_E = part.listing.backward(values, False)
            else:
                by_part_n, by_part_view, by_part_m, by_E = part.listing.backward(g, with_view)
                by_n += by_part_n
                if by_part_view is not None:
                    by_view += by_part_view
            by_m += by_part_m
            by_light += self.scene.light.gradient(by_E, strategy.level)
        for mirrored, (drawn, slopes) in by_place.items():
            places, chart = self.scene.where(mirrored)
            by_part_n, by_part_view = places.backward(chart.backward(drawn), slopes)
            by_n, by_view = by_n + by_part_n, by_view + by_part_view
        return by_n, by_view, by_m, np.ascontiguousarray(by_light.transpose(1, 2, 0))

    def read_backward(self, part: Sum, g: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives by the drawn places, by the offsets (2, P), and by the nodes' values."""
        places, chart = self.scene.where(part.strategy.mirrored)
        by_drawn, by_values, by_weights = np.zeros_like(g), [], []
        for weight, table, read in zip(part.weights, part.maps, part.read, strict=True):
            seen = np.ascontiguousarray(weight * g, np.float32)
            by_part, by_nodes = reflectance_map.read_backward(
                chart.drawn, table, part.strategy.size, seen, part.nodes
            )
            by_drawn += by_part
            by_values.append(by_nodes)
            by_weights.append(dot(read, g)[:, 0])
        if len(by_weights) == 1:
            return by_drawn, np.zeros((2, 1), np.float32), by_values[0]
        by_offsets = places.weights_backward(np.stack(by_weights))
        return by_drawn, by_offsets, np.concatenate(by_values)


# (n, view, m, light, gradients) → `Sums`, all arrays; gradients: which derivatives are requested,
# by n, view, m and light
Plan = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Sequence[bool]], Sums]


class Planned(Step):
    """A planned sum for autograd: n, view (P, 3), m (3, 3, 2, 6), light, `Plan` → radiance."""

    @staticmethod
    def forward(
        ctx: Context,
        n: torch.Tensor,
        view: torch.Tensor,
        m: torch.Tensor,
        light: torch.Tensor,
        plan: Plan,
    ) -> torch.Tensor:
        ctx.refusal = refusal("auto")
        ctx.save_for_backward(n, view, m, light)
        ctx.sums = plan(
            np.ascontiguousarray(n.numpy()),
            np.ascontiguousarray(view.expand_as(n).numpy()),
            m.double().numpy(),
            light.numpy(),
            ctx.needs_input_grad[:4],
        )
        return torch.from_numpy(ctx.sums.radiance())

    @staticmethod
    @last
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        with_view = ctx.needs_input_grad[1]
        by_n, by_view, by_m, by_light = ctx.sums.backward(
            np.ascontiguousarray(g.numpy()), with_view
        )
        return (
            torch.from_numpy(by_n),
            torch.from_numpy(by_view) if with_view else None,
            torch.from_numpy(by_m).float(),
            torch.from_numpy(by_light),
            None,
        )


def radiance(
    n: torch.Tensor, view: torch.Tensor, m: torch.Tensor, light: torch.Tensor, plan: Plan
) -> torch.Tensor:
    return Planned.apply(n, view, m, light, plan)
