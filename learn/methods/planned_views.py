"""Radiance for a view per pixel as `auto` plans it: each group of lobes by a strategy of its own.

Lobes whose highlights are narrower than a map's nodes could follow are summed at the pixels
(learn/methods/viewed_lists.py). The others are summed at the nodes of reflectance maps
(learn/methods/view_maps.py), which pixels read at the places of learn/methods/view_places.py.

n, view (P, 3), m (3, 3, 2, 6), light (height, width, 3), all float32 on the CPU with kernels at
hand.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from learn.engines.derivatives import Context, Step, last
from learn.engines.lights import Rotation
from learn.methods import coarse, lobe_shapes, reflectance_map, refusal
from learn.methods.cost_model import light_error
from learn.methods.planned import Strategy
from learn.methods.view_maps import Maps, slope_map_size
from learn.methods.view_places import Chart, Places, Views
from learn.methods.viewed_lists import ViewedListing, ViewedTables

# longest difference of a view from that of the run that it shares, at a tolerance of 1e-2; the
# error is of second order in it
VIEW_GAP = 0.15
IGNORED = 0.1  # of the tolerance, the light of control values whose sharpness does not count
COUNTED = 40  # size of the map whose nodes are counted
# of the tolerance, the bound of what may be missing from what parts of a picture are compared with;
# what is missing is far less
CLOSE = 1.0
COMPARED = 0.01  # of the tolerance, the predicted error of a coarser light that shows no difference


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
        self.truths: dict[tuple[int | None, tuple[int, ...]], np.ndarray] = {}
        sharpness, strength = lobe_shapes.sharpness(m), lobe_shapes.strength(m)
        visible = lobe_shapes.visible_sharpness(m, IGNORED * tolerance)
        self.sharpness = np.where(sharpness > 0, visible, lobe_shapes.sharpness(m, dark=True))
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

    def node_count(self, size: int) -> float:
        """Return the number of nodes that a map of a size will have, by those of a small one."""
        return self.node_share * size * size

    @functools.cached_property
    def node_share(self) -> float:
        """The part of a map's square that has nodes."""
        _, chart = self.map_places(False)
        return len(reflectance_map.nodes_for(chart.drawn, COUNTED)) / COUNTED**2

    def map_places(self, mirrored: bool) -> tuple[Places, Chart]:
        """Where maps are read."""
        if mirrored not in self.places:
            self.places[mirrored] = Places(self.n, self.view, self.views, mirrored)
            self.charts[mirrored] = Chart(self.places[mirrored].n, self.views.frame)
        return self.places[mirrored], self.charts[mirrored]

    def list_lobes(
        self,
        normals: np.ndarray,
        view: np.ndarray,
        lobes: tuple[int, ...],
        level: int = 0,
        left_out: float = 0.0,
        view_gap: float = 0.0,
    ) -> ViewedListing:
        """Return the `ViewedListing` of some lobes at normals and views (N, 3)."""
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
        """What `sum_to_compare` sums (S, 3) at pixels pick (S,); pick: one sample for each size."""
        return self.sum_to_compare(self.n[pick], self.view[pick], lobes, len(pick))

    def sum_to_compare(
        self, n: np.ndarray, view: np.ndarray, lobes: tuple[int, ...], known_as: int | None = None
    ) -> np.ndarray:
        """Return the sum of some lobes (S, 3) with which parts of a picture are compared.

        Lobes that show no difference between the light's own texels and larger ones are summed over
        these. CLOSE of the budget may be missing; before it is known, of a smaller one, by what
        these lobes reflect.
        known_as  the key of sums that were made before for the same n and view (S, 3)
        """
        result = np.zeros_like(n)
        for level in (1, 0):
            some = tuple(s for s in lobes if self.nearly_smooth[s] == (level == 1))
            if some and (known_as, some) not in self.truths:
                left_out = CLOSE * max(self.budget, self.tolerance * float(result.mean()))
                sums = self.list_lobes(n, view, some, level, left_out).radiance
                if known_as is None:
                    result = result + sums
                    continue
                self.truths[known_as, some] = sums
            if some:
                result = result + self.truths[known_as, some]
        return result

    @functools.cached_property
    def nearly_smooth(self) -> np.ndarray:
        """Whether each lobe is as broad as `sum_to_compare` asks for, (3,) bool."""
        height, width = self.light.size
        allowed = COMPARED * self.tolerance / np.maximum(self.shares, 1e-9)
        return np.array(
            [
                coarse.has_level(height, width, 1) and light_error(height >> 1, sharp) <= most
                for sharp, most in zip(self.sharpness, allowed, strict=True)
            ]
        )

    def light_loss(
        self, lobes: tuple[int, ...], level: int, pick: np.ndarray, truth: np.ndarray
    ) -> float:
        """Return the mean absolute error by a level of the light at pixels pick (S,).

        truth  (S, 3) the sum of the lobes there
        """
        n, view, left_out = self.n[pick], self.view[pick], CLOSE * self.budget
        return float(
            np.abs(self.list_lobes(n, view, lobes, level, left_out).radiance - truth).mean()
        )

    def sums(self, strategies: Sequence[Strategy], known: "dict[Strategy, Sum]") -> "Sums":
        """Return the `Sums` of strategies; known: sums that have been made before."""
        return Sums(self, strategies, known)


class Sum:
    """One strategy's radiance at the pixels, (P, 3): `values`."""

    def __init__(
        self, scene: Scene, strategy: Strategy, known: "dict[Strategy, Sum] | None" = None
    ):
        """known: sums that have been made before; what is equal is taken from them."""
        self.scene, self.strategy = scene, strategy
        self.maps: list[Maps] = []
        if not strategy.size:
            budget = strategy.culled * scene.budget
            lobes, level, gap = strategy.lobes, strategy.level, scene.view_gap
            self.listing = scene.list_lobes(scene.n, scene.view, lobes, level, budget, gap)
            self.values = self.listing.radiance
            return
        size, views = strategy.size, strategy.views
        if scene.view_gradient:
            self.maps.append(Maps(scene, strategy, size, views))
        else:
            before = (known or {}).get(replace(strategy, views=1))
            self.maps.append(before.maps[0] if before else Maps(scene, strategy, size, 1))
            if views > 1:
                self.maps.append(Maps(scene, strategy, slope_map_size(size), views, slopes=True))
        self.values = functools.reduce(np.add, [part.values for part in self.maps])

    def error(self, pick: np.ndarray, truth: np.ndarray) -> float:
        """Return the mean absolute difference from truth (S, 3) at pixels pick (S,)."""
        return float(np.abs(self.values[pick] - truth).mean())

    def causes(self, pick: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
        """Errors at pixels pick (S,) by the views that the maps lack, and by the maps' nodes.

        truth  (S, 3) the sum of the strategy's lobes there
        """
        scene, (places, _) = self.scene, self.scene.map_places(self.strategy.mirrored)
        normals = np.ascontiguousarray(places.n[pick])
        views = scene.views.vectors(places.middle[:, pick]).astype(np.float32)
        at = scene.sum_to_compare(normals, views, self.strategy.lobes)
        off = self.maps[0].read[0][pick] - at
        by_view = self.values[pick] - off - truth
        return float(np.abs(by_view).mean()), float(np.abs(off).mean())


class Sums:
    """All strategies together."""

    def __init__(self, scene: Scene, strategies: Sequence[Strategy], known: dict[Strategy, Sum]):
        """known: sums that have been made before; new ones are added."""
        self.scene = scene
        for strategy in strategies:
            if strategy not in known:
                known[strategy] = Sum(scene, strategy, known)
        self.all = [known[strategy] for strategy in strategies]

    def parts(self) -> list[Sum]:
        """Return the sum of each strategy."""
        return self.all

    def at_sample(self, pick: np.ndarray) -> np.ndarray:
        """Return radiance (S, 3) at pixels pick (S,)."""
        return functools.reduce(np.add, [part.values[pick] for part in self.all])

    def radiance(self) -> np.ndarray:
        """Return radiance (P, 3)."""
        return functools.reduce(
            np.add, [part.values for part in self.all], np.zeros_like(self.scene.n)
        )

    def backward(
        self, g: np.ndarray, with_view: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return derivatives of Σ g·radiance by n, view, m and light."""
        by_n, by_view = np.zeros_like(self.scene.n), np.zeros_like(self.scene.n)
        by_m, by_light = np.zeros((3, 3, 2, 6)), np.zeros_like(self.scene.light.E)
        by_place: dict[bool, tuple[np.ndarray, np.ndarray]] = {}
        for part in self.all:
            strategy = part.strategy
            summed = []
            for one in part.maps:
                drawn, offsets, values = one.backward(g)
                before = by_place.get(strategy.mirrored)
                by_place[strategy.mirrored] = (
                    (drawn, offsets) if before is None else (before[0] + drawn, before[1] + offsets)
                )
                summed.append((one.listing.backward(values, False, False), one.level))
            if not part.maps:
                summed.append((part.listing.backward(g, with_view), strategy.level))
                by_n += summed[-1][0][0]
                if summed[-1][0][1] is not None:
                    by_view += summed[-1][0][1]
            for (_, _, by_part_m, by_E), level in summed:
                by_m += by_part_m
                by_light += self.scene.light.gradient(by_E, level)
        for mirrored, (drawn, offsets) in by_place.items():
            places, chart = self.scene.map_places(mirrored)
            by_part_n, by_part_view = places.backward(chart.backward(drawn), offsets)
            by_n, by_view = by_n + by_part_n, by_view + by_part_view
        return by_n, by_view, by_m, np.ascontiguousarray(by_light.transpose(1, 2, 0))


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
