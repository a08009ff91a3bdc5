"""Radiance for a view per pixel as `auto` plans it: each group of lobes by a strategy of its own.

Lobes whose highlights are narrower than the map's nodes could follow are summed at the pixels
(learn/methods/viewed_lists.py). Others vary slowly with the view, so that a few reflectance maps
serve: one for each view of a small grid about the picture's own views. A pixel reads them all, and
interpolates between views:

    I(n, v) ≈ Σ_k ℓ_k(v) M_k(n_k),   M_k(n) = I(n, v_k)

n_k is the pixel's normal, or for sharp lobes the one that mirrors the same light (`ViewMap`).
ℓ_k are the polynomials of degree 0, 1 or 2 that are 1 at v_k and 0 at the others.

n, view (P, 3), m (3, 3, 2, 6), light (height, width, 3), all float32 on the CPU with kernels at
hand.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch

from learn.engines.derivatives import Context, Step, last
from learn.engines.lights import Rotation
from learn.methods import coarse, light_tables, reflectance_map, refusal
from learn.methods.block_lists import Listing, Tables
from learn.methods.light_tables import Lights
from learn.methods.planned import Strategy
from learn.methods.viewed_lists import ViewedListing, ViewedTables

LEAST_SPREAD = 0.02  # of the views in a direction: polynomials over less lose digits


def ring(count: int, radius: float) -> list[tuple[float, float]]:
    """Points on a circle."""
    angles = (2 * math.pi * k / count for k in range(count))
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]


# places of the views, from −1 to 1 in two directions, that fix a polynomial of degree 0, 1 or 2;
# three have the second moments of the square
VIEWS = {1: [(0.0, 0.0)], 3: ring(3, math.sqrt(2 / 3)), 6: [(0.0, 0.0), *ring(5, 1.0)]}
# monomials x^a y^b, of which the first 1, 3 or 6 serve
POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


class ViewGrid:
    """Views v_k about a picture's views, and the weights by which a pixel interpolates.

    count    1, 3 or 6 views
    views    (K, 3) float64 unit vectors
    weights  (K, P) float32
    """

    def __init__(self, plane: "Plane", count: int):
        self.plane = plane
        x, y = np.array(VIEWS[count]).T
        self.views = plane.at(x, y)
        powers = POWERS[:count]
        self.factors = np.linalg.inv(np.stack([x**i * y**j for i, j in powers], -1)).T
        x, y = plane.coordinates
        self.weights = self.combined([x**i * y**j for i, j in powers])

    def combined(self, monomials: list[np.ndarray | None]) -> np.ndarray:
        """Weights (K, P) from monomials (P,), None for 0; without BLAS, whose threads spin."""
        result = np.zeros((len(self.factors), len(self.plane.depth)), np.float32)
        for row, factors in zip(result, self.factors, strict=True):
            for factor, monomial in zip(factors, monomials, strict=True):
                if monomial is not None and abs(factor) > 1e-9:
                    row += np.float32(factor) * monomial
        return result

    def backward(self, by_weights: np.ndarray) -> np.ndarray:
        """The derivative by view (P, 3), from the one by the weights (K, P)."""
        x, y = self.plane.coordinates
        powers = POWERS[: len(self.factors)]
        dx = self.combined([i * x ** (i - 1) * y**j if i else None for i, j in powers])
        dy = self.combined([j * x**i * y ** (j - 1) if j else None for i, j in powers])
        return self.plane.backward((by_weights * dx).sum(0), (by_weights * dy).sum(0))


class Plane:
    """Views in the tangent plane of their mean: coordinates (P,) from −1 to 1 in two directions."""

    def __init__(self, view: np.ndarray):
        axis = view.sum(0, dtype=np.float64)
        axis /= np.linalg.norm(axis)
        e1 = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0], axis)
        e1 /= np.linalg.norm(e1)
        self.frame = np.stack([e1, np.cross(axis, e1), axis]).astype(np.float32)
        a, b, self.depth = (along(view, row) for row in self.frame)
        self.slopes = a / self.depth, b / self.depth
        ends = [(float(s.min()), float(s.max())) for s in self.slopes]
        self.middle = [0.5 * (low + high) for low, high in ends]
        self.half = [max(0.5 * (high - low), LEAST_SPREAD) for low, high in ends]
        self.coordinates = [
            (s - np.float32(c)) / np.float32(h)
            for s, c, h in zip(self.slopes, self.middle, self.half, strict=True)
        ]

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Unit vectors (K, 3) at coordinates (K,)."""
        a, b = x * self.half[0] + self.middle[0], y * self.half[1] + self.middle[1]
        result = np.stack([a, b, np.ones_like(a)], -1) @ self.frame.astype(np.float64)
        return result / np.linalg.norm(result, axis=-1, keepdims=True)

    @property
    def spread(self) -> float:
        """Half the width (tangent) of the interval of the views; inf beyond about 60°."""
        return max(self.half) if float(self.depth.min()) > 0.5 else math.inf

    def backward(self, by_x: np.ndarray, by_y: np.ndarray) -> np.ndarray:
        """The derivative by view (P, 3), from those by the coordinates (P,)."""
        by_a, by_b = by_x / self.half[0] / self.depth, by_y / self.half[1] / self.depth
        by_depth = -(by_a * self.slopes[0] + by_b * self.slopes[1])
        e1, e2, axis = self.frame
        return by_a[:, None] * e1 + by_b[:, None] * e2 + by_depth[:, None] * axis


@functools.lru_cache(maxsize=32)
def lights_seen_from(lights: Lights, viewer: tuple[float, ...]) -> Lights:
    """The same lights for a distant viewer in another direction."""
    return light_tables.lights_at(lights.w, np.array(viewer))


def along(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Components (P,) of vectors (P, 3) along an axis, without BLAS, whose threads spin."""
    return vectors[:, 0] * axis[0] + vectors[:, 1] * axis[1] + vectors[:, 2] * axis[2]


class Scene:
    """What all strategies share: pixels, material, light at its levels, and the tables of both."""

    def __init__(
        self,
        n: np.ndarray,
        view: np.ndarray,
        m: np.ndarray,
        light: np.ndarray,
        rotation: Rotation,
        light_gradient: bool = True,
        material_gradient: bool = False,
    ):
        self.n, self.view, self.m, self.light = n, view, m, coarse.Light(light, rotation)
        self.light_gradient, self.material_gradient = light_gradient, material_gradient
        self.budget = 0.0  # tolerance × mean radiance: the unit of a strategy's `culled`
        self.tables: dict[tuple[tuple[int, ...], int], ViewedTables] = {}
        self.grids: dict[int, ViewGrid] = {}
        self.list_bytes = 0

    @property
    def texels(self) -> int:
        """Texels of the light."""
        return self.light.height * self.light.width

    @functools.cached_property
    def plane(self) -> Plane:
        """The views in a plane."""
        return Plane(self.view)

    def grid(self, count: int) -> ViewGrid:
        """The grid of `count` views."""
        if count not in self.grids:
            self.grids[count] = ViewGrid(self.plane, count)
        return self.grids[count]

    def seen_from(self, viewer: np.ndarray, lobes: tuple[int, ...], level: int) -> Tables:
        """The tables of some lobes for a distant viewer in direction `viewer` (3,)."""
        lights, energy = self.light.at(level)
        lights = lights_seen_from(lights, tuple(viewer.tolist()))
        flags = self.light_gradient, lobes, self.material_gradient
        return Tables(self.m, energy, lights, *flags)

    def at(
        self,
        normals: np.ndarray,
        view: np.ndarray,
        lobes: tuple[int, ...],
        level: int = 0,
        left_out: float = 0.0,
        apart: float = 0.0,
    ) -> ViewedListing:
        """The `ViewedListing` of some lobes at normals and views (N, 3)."""
        if (lobes, level) not in self.tables:
            lights, energy = self.light.at(level)
            self.tables[lobes, level] = ViewedTables(
                self.m, energy, lights, self.light_gradient, lobes, self.material_gradient
            )
        listing = ViewedListing(normals, view, self.tables[lobes, level], left_out, self.list_bytes, apart)
        self.list_bytes += listing.list_bytes
        return listing

    def truth(self, pick: np.ndarray, lobes: tuple[int, ...]) -> np.ndarray:
        """The sum over all lights (S, 3) at pixels pick (S,)."""
        return self.at(self.n[pick], self.view[pick], lobes).radiance

    def sums(self, strategies: Sequence[Strategy], known: "dict[Strategy, Sum]") -> "Sums":
        """The `Sums` of strategies; known: sums that have been made before."""
        return Sums(self, strategies, known)


class ViewMap:
    """Where the pixels read the map of one view, and the derivatives of that.

    places  (P, 3) unit normals in the map's own frame, in which its view is (0, 0, 1)

    A broad lobe keeps its normal. A sharp one is read at the normal that mirrors the map's view
    into the same light as the pixel's own normal mirrors the pixel's own view, so that highlights
    stay where they are:

        r = 2 (n·v) n − v,   u = r + v_k,   n_k = u/‖u‖
    """

    def __init__(self, scene: Scene, view: np.ndarray, size: int, mirrored: bool):
        self.scene, self.view, self.mirrored, self.size = scene, view, mirrored, size
        self.frame = frame_of(view) if mirrored else np.eye(3, dtype=np.float32)
        n = scene.n
        if mirrored:
            self.cosine = dot(n, scene.view)
            u = 2 * self.cosine * n - scene.view + view.astype(np.float32)
            self.length = np.sqrt(dot(u, u))
            self.normal = u / self.length
            n = turned(self.normal, self.frame)
        self.places = n
        self.nodes = reflectance_map.nodes_for(n, size)
        normals = reflectance_map.normals(self.nodes, size)
        self.normals = turned(normals, self.frame.T).astype(np.float32)

    def read(self, table: np.ndarray) -> np.ndarray:
        """Values (P, 3) at the pixels."""
        return reflectance_map.read(self.places, table, self.size)

    def read_backward(
        self, table: np.ndarray, g: np.ndarray, with_view: bool
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        """Derivatives of Σ g·values by n, by view or None, and by the values at the nodes."""
        by_place, by_values = reflectance_map.read_backward(
            self.places, table, self.size, g, self.nodes
        )
        if not self.mirrored:
            return by_place, None, by_values
        by_u = turned(by_place, self.frame.T)
        by_u = (by_u - dot(by_u, self.normal) * self.normal) / self.length
        n = self.scene.n
        share = 2 * dot(n, by_u)
        by_n = share * self.scene.view + 2 * self.cosine * by_u
        return by_n, share * n - by_u if with_view else None, by_values


def frame_of(axis: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) float32 that takes a unit vector near (0, 0, 1) to it."""
    x, y, z = (float(value) for value in axis)
    a = 1 / (1 + z)
    rows = [[1 - x * x * a, -x * y * a, -x], [-x * y * a, 1 - y * y * a, -y], [x, y, z]]
    return np.array(rows, np.float32)


def turned(vectors: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Vectors (P, 3) rotated, without BLAS, whose threads spin."""
    return np.stack([along(vectors, row) for row in rotation], -1)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a·b, (P, 1)."""
    return (a[:, :1] * b[:, :1] + a[:, 1:2] * b[:, 1:2]) + a[:, 2:] * b[:, 2:]


class Sum:
    """One strategy's radiance at the pixels, (P, 3): `values`."""

    def __init__(self, scene: Scene, strategy: Strategy):
        self.scene, self.strategy = scene, strategy
        budget = strategy.culled * scene.budget
        lobes, level, size = strategy.lobes, strategy.level, strategy.size
        if not size:
            self.listing = scene.at(scene.n, scene.view, lobes, level, budget)
            self.values = self.listing.radiance
            return
        self.grid = scene.grid(strategy.views)
        self.maps = [ViewMap(scene, view, size, strategy.mirrored) for view in self.grid.views]
        self.listings = [
            Listing(each.normals, scene.seen_from(view, lobes, level), budget)
            for each, view in zip(self.maps, self.grid.views, strict=True)
        ]
        self.tables = [
            reflectance_map.table(listing.radiance, each.nodes, size)
            for listing, each in zip(self.listings, self.maps, strict=True)
        ]
        self.values = np.zeros_like(scene.n)
        for each, table, weight in self.parts():
            self.values += weight * each.read(table)

    def parts(self) -> Iterator[tuple[ViewMap, np.ndarray, np.ndarray]]:
        """Each view's map, its table, and its weight (P, 1) at the pixels."""
        yield from zip(self.maps, self.tables, self.grid.weights[:, :, None], strict=True)

    def error(self, pick: np.ndarray, truth: np.ndarray) -> float:
        """Mean absolute difference from truth (S, 3) at pixels pick (S,)."""
        return float(np.abs(self.values[pick] - truth).mean())

    def backward(
        self, g: np.ndarray, with_view: bool
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
        """Derivatives of Σ g·values, as those of `ViewedListing`."""
        if not self.strategy.size:
            return self.listing.backward(g, with_view)
        by_n, by_view = np.zeros_like(g), np.zeros_like(g)
        by_m, by_E = np.zeros((3, 3, 2, 6)), np.float32(0.0)
        by_weights = []
        for (each, table, weight), listing in zip(self.parts(), self.listings, strict=True):
            by_part_n, by_part_view, by_nodes = each.read_backward(table, weight * g, with_view)
            by_n += by_part_n
            _, by_part_m, by_part_E = listing.backward(by_nodes, False)
            by_m, by_E = by_m + by_part_m, by_E + by_part_E
            if with_view:
                by_weights.append(dot(each.read(table), g)[:, 0])
                if by_part_view is not None:
                    by_view += by_part_view
        if with_view:
            by_view += self.grid.backward(np.stack(by_weights))
        return by_n, by_view if with_view else None, by_m, by_E


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
        for part in self.all:
            by_part_n, by_part_view, by_part_m, by_E = part.backward(g, with_view)
            by_n += by_part_n
            by_m += by_part_m
            by_light += self.scene.light.gradient(by_E, part.strategy.level)
            if by_part_view is not None:
                by_view += by_part_view
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
