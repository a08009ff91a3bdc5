"""Direct light of a mixture of closures without noise, seen by a distant viewer.

A mixture's radiance is a function of the normal alone when the viewer and the light are distant: a
reflectance map (Ramamoorthi and Hanrahan 2001). Each closure is integrated as its width asks for:

wide    by maps over the visible hemisphere, of unit weight, between whose nodes radiance is
        interpolated. A node is the sum over the light's texels: blocks of them count as one light
        where the lobe is much wider, and near a narrower lobe's axis each is divided
narrow  at every normal, over sample directions that follow the lobe as far as `extent` around its
        axis; what a long-tailed lobe (GGX) reflects from beyond comes from a map as above

What Cycles does besides is part of it: on coarse meshes, whose interpolated normals lean from their
facets, narrower lobes reflect no light from below the facet; where such a normal faces away
from the viewer, they reflect only if their tilted normal does not; and Cycles draws some half
vectors of Ashikhmin and Shirley's closure wrongly, which brightens grazing views.

The light is piecewise constant over its texels, as in the layer and in Cycles with nearest look-up.

n      (…, 3) unit normals, camera frame; the viewer is at (0, 0, 1)
t      (tan θ_h / α)²
nodes  of a map: polar angle θ and azimuth φ of the normal at ((θ cos φ, θ sin φ) 2/π + 1)/2
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from shaders import direct_light_kernels, envmap
from shaders.mixture import TABLE_SIZE, Mixture, ramp_table, table_look_up

LOBES = ("ggx", "beckmann", "ashikhmin_shirley")
NARROW = 0.03  # α below which a lobe is sampled
WIDE = 0.1  # α from which blocks of texels may count as one light
LEAST_NODES = 64  # of a map across the hemisphere
SPACING = 0.5  # of nodes, in units of the lobe's α
BLOCKS = ((0.45, 16), (0.2, 32), (0.0, 64))  # rows of light blocks for closures at least so wide
LAMPS = 64  # texels of most energy, which are divided where the others are not
BLOCK = 4  # texels across a block of the light that counts in detail near a lobe's axis
PARTS = ((0.035, 2), (0.0, 3))  # into how many a texel is divided there, by α
GRAZING = 0.25  # n·v below which texels are divided twice as finely: half vectors lie closer there
WITHIN = {"ggx": 5.0, "beckmann": 3.8, "ashikhmin_shirley": 3.8}  # tan θ_h / α that is near
SAMPLES = 12  # directions per normal of each of the two distributions
EXTENT = 0.2  # radians about the mirrored direction that samples of a narrow lobe cover
COS_LEANING = float(np.cos(np.radians(2.0)))  # between normals and facets that differ
# into how many parts texels are divided below facets, by the least α of lobes that are not narrow
LEANING = ((0.2, 1), (0.08, 2), (0.0, 3))
HALF_VECTORS = 512  # per normal, of those that Cycles turns round
UNWEIGHTED = np.array([[0, 0, 1, 1, 1]] * 2, np.float32)  # a table of unit weights
GRAZING_ROWS = TABLE_SIZE // 4  # of a table, at n·v below a quarter
FACING = 1e-3  # n·v of normals that lean away from the viewer


def constants() -> list[list[object]]:
    """Return name and value of every constant that alters pixels, for a fingerprint."""
    result: list[list[object]] = []
    for module in (globals(), vars(direct_light_kernels)):
        for name, value in sorted(module.items()):
            if name.isupper() and isinstance(value, (int, float, np.floating)):
                result.append([name, round(float(value), 9)])  # cosines differ in the last bit
            elif name.isupper() and isinstance(value, (tuple, dict)):
                result.append([name, sorted(value.items()) if isinstance(value, dict) else value])
    return result


class DirectLight:
    """The radiance of one mixture under one light; call `at` with normals.

    mixture            of closures
    light              (height, width, 3) radiance, light frame, nearest look-up
    camera_from_light  (3, 3)
    misdirected        whether light counts that Cycles finds by mistake
                       (direct_light_kernels.add_misdirected)
    """

    def __init__(
        self,
        mixture: Mixture,
        light: np.ndarray,
        camera_from_light: np.ndarray,
        misdirected: bool = True,
    ):
        self.mixture = mixture
        self.light = np.ascontiguousarray(light, np.float32)
        self.camera_from_light = camera_from_light
        self._lights: dict[int, np.ndarray] = {}
        self._detail: dict[int, tuple[Any, ...]] = {}
        self._texels: dict[int, tuple[np.ndarray, ...]] = {}
        self._least = np.exp(mixture.log_alpha.min(0))
        self._maps = {k: _Map.empty(self._size(k)) for k in range(len(mixture.kinds))}
        self._misdirected: _Map | None = None
        if misdirected and "ashikhmin_shirley" in mixture.kinds and self.light.any():
            self._misdirected = _Map.empty(LEAST_NODES)
        self._tables = [_table(mixture, k) for k in range(len(mixture.kinds))]

    @property
    def narrowest(self) -> float:
        """The least α of a closure with a lobe, 1 without one."""
        lobes = [
            a for a, kind in zip(self._least, self.mixture.kinds, strict=True) if kind in LOBES
        ]
        return float(min(lobes, default=1.0))

    @property
    def narrow(self) -> int:
        """The number of narrow closures."""
        return sum(self._is_narrow(k) for k in range(len(self.mixture.kinds)))

    def at(
        self,
        n: np.ndarray,
        samples: int = SAMPLES,
        facets: np.ndarray | None = None,
        misdirected: bool = True,
        cells: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return radiance (P, 3) float32 at normals (P, 3), of which some may face away.

        samples      directions per normal of each of the two distributions of a narrow lobe; few
                     suffice where many normals are averaged, for their errors differ
        facets       (P, 3) normals of the surface itself: of light below it Cycles loses a part
                     (direct_light_kernels.add_leaning). None: the normals
        misdirected  False: without the light that Cycles finds by mistake
        cells        (P,) integers, equal for normals that are neighbours in a picture: what facets
                     take away, and what takes a sum of its own near the horizon, is computed once
                     for each cell. None: for each normal
        """
        given = np.ascontiguousarray(n, np.float32)
        n = _facing(given)
        facets = n if facets is None else np.ascontiguousarray(facets, np.float32)
        radiance = np.zeros_like(n)
        for k in range(len(self.mixture.kinds)):
            if self._has_map(k):
                self._look_up(self._maps[k], partial(self._summed, k), k, n, radiance, cells)
            if self._is_narrow(k):
                self._sample(k, n, facets, samples, radiance)
        (leaning,) = np.nonzero((facets * n).sum(1) < COS_LEANING)
        if len(leaning):
            first, each = _distinct(leaning, cells)
            radiance[leaning] -= self._leaning(n[first], facets[first], away=False)[each]
            np.maximum(radiance, 0, out=radiance)
        (away,) = np.nonzero(given[:, 2] < FACING)
        if len(away):
            radiance[away] = self._leaning(given[away], facets[away], away=True)
        return radiance + self.mistaken(given, facets, cells) if misdirected else radiance

    def mistaken(
        self, n: np.ndarray, facets: np.ndarray, cells: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the light (P, 3) that Cycles finds by mistake; arguments as `at` takes them."""
        radiance = np.zeros_like(n)
        if self._misdirected is None:
            return radiance
        self._look_up(self._misdirected, self.misdirected, None, _facing(n), radiance, cells)
        (away,) = np.nonzero(n[:, 2] < FACING)
        if len(away):
            radiance[away] = self.misdirected(n[away], facets[away])
        return radiance

    def _leaning(self, n: np.ndarray, facets: np.ndarray, away: bool) -> np.ndarray:
        """Return what add_leaning adds (P, 3) at normals and facets (P, 3)."""
        lobes = [
            a for a, kind in zip(self._least, self.mixture.kinds, strict=True) if kind in LOBES
        ]
        width = min([a for a in lobes if a >= NARROW], default=1.0)
        parts = 1 if away else next((parts for wide, parts in LEANING if width >= wide), 1)
        extents = [
            np.tan(EXTENT / 2) if self._is_narrow(k) and not away else 0
            for k in range(len(self._least))
        ]
        radiance = np.zeros_like(n)
        direct_light_kernels.add_leaning(
            np.array([direct_light_kernels.KINDS[kind] for kind in self.mixture.kinds]),
            n,
            facets,
            np.stack(self._tables),
            np.array(extents, np.float32),
            *self.texels(parts),
            away,
            radiance,
        )
        return radiance

    def _is_narrow(self, k: int) -> bool:
        return self.mixture.kinds[k] in LOBES and bool(self._least[k] < NARROW)

    def _has_map(self, k: int) -> bool:
        """Whether a closure is wide, or reflects from beyond its extent."""
        return not self._is_narrow(k) or self.mixture.kinds[k] == "ggx"

    def _size(self, k: int) -> int:
        """Return the nodes across closure k's map."""
        width = self._least[k] if self.mixture.kinds[k] in LOBES else 1.0
        if self._is_narrow(k):
            width = EXTENT / 4  # across which the samples' share falls off
        return max(LEAST_NODES, 3 + int(np.ceil(np.pi / (SPACING * width))))

    def _look_up(
        self,
        at: _Map,
        compute: Callable[[np.ndarray], np.ndarray],
        k: int | None,
        n: np.ndarray,
        out: np.ndarray,
        cells: np.ndarray | None = None,
    ) -> None:
        """Add to out (P, 3) the radiance at normals (P, 3) of closure k, or of what has no weight.

        It is interpolated in a map. Near the horizon it is computed at each normal, because nodes
        there stand on both sides of where a closure ends.

        compute  the map's function of normals (N, 3)
        """
        table = UNWEIGHTED if k is None else self._tables[k]
        low = n[:, 2] < self._horizon(at, k)
        above = np.ascontiguousarray(n[~low])
        if direct_light_kernels.mark(above, at.known):
            nodes = np.argwhere(at.known == 2)
            at.set(nodes, compute(at.normals(nodes)))
        radiance = np.zeros_like(above)
        direct_light_kernels.interpolate(above, at.nodes, table, radiance)
        out[~low] += radiance
        if low.any():
            weights = table_look_up(table[:, 2:], 1 - n[low, 2])
            first, each = _distinct(np.nonzero(low)[0], cells)
            out[low] += compute(np.ascontiguousarray(n[first]))[each] * weights

    def _horizon(self, at: _Map, k: int | None) -> float:
        """Return n·v below which a map is not looked up: two nodes from where closure k ends.

        A closure whose normal is tilted away from the viewer ends before n·v = 0.
        """
        tilts = self.mixture.tilt if k is None else self._tables[k][-GRAZING_ROWS:, 1]
        return 2 * np.pi / (len(at.known) - 3) + max(0.0, -float(tilts.min()))

    def _summed(self, k: int, n: np.ndarray) -> np.ndarray:
        """Return what closure k of unit weight reflects, but not what `_sample` adds, (N, 3)."""
        radiance = np.zeros_like(n)
        self._sum(k, n, radiance)
        return radiance

    def misdirected(self, n: np.ndarray, facets: np.ndarray | None = None) -> np.ndarray:
        """Return the radiance (P, 3) that Cycles finds by mistake at normals (P, 3).

        facets  (P, 3) as `at` has them; None: the normals
        """
        radiance = np.zeros_like(n)
        direct_light_kernels.add_misdirected(
            np.array([direct_light_kernels.KINDS[kind] for kind in self.mixture.kinds]),
            n,
            n if facets is None else facets,
            np.stack(self._tables),
            self.light,
            self.density,
            np.ascontiguousarray(self.camera_from_light.T, np.float32),
            HALF_VECTORS,
            radiance,
        )
        return radiance

    @cached_property
    def density(self) -> np.ndarray:
        """By which Cycles draws directions to the light, (height, width) float32 in 1/sr."""
        # it draws texels by their mean over the channels and the sine at their middle
        _, solid_angle = envmap.directions(*self.light.shape[:2])
        drawn = self.light.mean(-1, dtype=np.float64) * solid_angle
        return (drawn / (max(drawn.sum(), 1e-30) * solid_angle)).astype(np.float32)

    def texels(self, parts: int) -> tuple[np.ndarray, ...]:
        """Return texels that are not black, divided into parts × parts, as lights in blocks.

        Returns  (9, T), as direct_light_kernels.add_lights takes them, their density (T,), and of
                 the blocks: firsts (B + 1,), centres (B, 3) and sines of radii (B,), as
                 direct_light_kernels.add_leaning takes them
        """
        if parts not in self._texels:
            height, width = self.light.shape[:2]
            w, solid_angle = envmap.directions(height * parts, width * parts)
            light, density = (
                each.repeat(parts, 0).repeat(parts, 1) for each in (self.light, self.density)
            )
            across = BLOCK * parts
            rows, columns = np.indices(light.shape[:2]) // across
            numbers = rows * -(-width // BLOCK) + columns
            lit = np.nonzero(light.any(-1).ravel())[0]
            lit = lit[np.argsort(numbers.ravel()[lit], kind="stable")]
            energy = light.reshape(-1, 3)[lit].astype(np.float64)
            energy *= solid_angle.reshape(-1)[lit][:, None]
            lights = self._lit(w.reshape(-1, 3)[lit][None], energy[None])[0]
            first = np.nonzero(np.diff(numbers.ravel()[lit], prepend=-1))[0]
            firsts = np.append(first, len(lit))
            counts = np.diff(firsts)
            at = lights[:3].T.astype(np.float64)
            centres = np.add.reduceat(at, first, axis=0) if len(lit) else np.zeros((0, 3))
            centres /= np.maximum(np.linalg.norm(centres, axis=1, keepdims=True), 1e-9)
            cosines = (at * centres.repeat(counts, axis=0)).sum(1)
            nearest = np.minimum.reduceat(cosines, first) if len(lit) else np.zeros(0)
            sines = np.sqrt(np.clip(1 - np.clip(nearest, 0, 1) ** 2, 0, 1)) + 1e-4  # rounding
            self._texels[parts] = (
                lights,
                density.ravel()[lit],
                firsts,
                centres.astype(np.float32),
                sines.astype(np.float32),
            )
        return self._texels[parts]

    def lights(self, rows: int) -> np.ndarray:
        """Return the lights that stand for blocks of the map, `rows` blocks from pole to pole.

        Returns  (9, T) float32, as direct_light_kernels.add_lights takes them
        """
        if rows not in self._lights:
            height, width = self.light.shape[:2]
            step = height // rows
            w, solid_angle = envmap.directions(height, width)
            energy = self.light.astype(np.float64) * solid_angle[..., None]
            brightness = energy.sum(-1, keepdims=True) + 1e-12

            def blocks(values: np.ndarray) -> np.ndarray:
                return values.reshape(rows, step, width // step, step, 3).sum((1, 3)).reshape(-1, 3)

            centres, energies = blocks(w * brightness), blocks(energy)
            if step == 1:  # few lamps make most of a map's light: they are divided
                lamps = np.argsort(energies.sum(-1))[-LAMPS:]
                w, solid_angle = envmap.directions(4 * height, 4 * width)
                parts = (
                    (4 * (lamps // width)[:, None, None] + np.arange(4)[:, None]),
                    (4 * (lamps % width)[:, None, None] + np.arange(4)),
                )
                inside = solid_angle[parts] / solid_angle[parts].sum((1, 2), keepdims=True)
                divided = energies[lamps][:, None, None] * inside[..., None]
                energies[lamps] = 0
                centres = np.concatenate([centres, w[parts].reshape(-1, 3)])
                energies = np.concatenate([energies, divided.reshape(-1, 3)])
            self._lights[rows] = self._lit(centres[None], energies[None])[0]
        return self._lights[rows]

    def detail(self, parts: int) -> tuple[Any, ...]:
        """Return blocks of the light: centres, radii, lights in detail and few lights of each.

        Texels are divided into parts × parts. Arguments as direct_light_kernels.add_blocks has them
        """
        if parts not in self._detail:
            height, width = self.light.shape[:2]
            w, solid_angle = envmap.directions(height * parts, width * parts)
            light = self.light.repeat(parts, 0).repeat(parts, 1).astype(np.float64)
            energy = light * solid_angle[..., None]

            def gathered(values: np.ndarray, across: int) -> np.ndarray:
                """(rows, columns, 3) → (blocks, texels of each, 3), `across` a block"""
                rows, columns = values.shape[0] // across, values.shape[1] // across
                parted = values.reshape(rows, across, columns, across, 3).swapaxes(1, 2)
                return parted.reshape(rows * columns, across * across, 3)

            brightness = energy.sum(-1, keepdims=True) + 1e-12
            half = BLOCK * parts // 2
            sums = [gathered(each, half).sum(1) for each in (w * brightness, energy)]
            rows, columns = height // BLOCK * 2, width // BLOCK * 2
            few = [gathered(each.reshape(rows, columns, 3), 2) for each in sums]
            near = gathered(w, BLOCK * parts), gathered(energy, BLOCK * parts)
            centres = near[0].sum(1)
            centres /= np.linalg.norm(centres, axis=1, keepdims=True)
            nearest = np.einsum("btc,bc->bt", near[0], centres).min(1)
            radii = np.arccos(np.clip(nearest, -1, 1)) + np.pi / len(self.light)
            self._detail[parts] = (
                np.ascontiguousarray(centres @ self.camera_from_light.T, np.float32),
                np.stack([np.cos(radii), np.sin(radii)], axis=1).astype(np.float32),
                self._lit(*near),
                np.ascontiguousarray(self._lit(*few).swapaxes(0, 1).reshape(9, -1)),
            )
        return self._detail[parts]

    def _lit(self, w: np.ndarray, energy: np.ndarray) -> np.ndarray:
        """Return the kernels' lights (B, 9, T) of directions and energies (B, T, 3)."""
        w = w @ self.camera_from_light.T
        w /= np.linalg.norm(w, axis=-1, keepdims=True)
        half = w + np.array([0.0, 0.0, 1.0])
        half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
        every = np.concatenate([w, half, energy], axis=-1)
        return np.ascontiguousarray(every.swapaxes(1, 2), np.float32)

    def _sum(self, k: int, n: np.ndarray, out: np.ndarray) -> None:
        """Add to out (N, 3) what closure k reflects of all lights, but not what `_sample` adds.

        Its weights are 1.
        """
        kind, narrow = self.mixture.kinds[k], self._is_narrow(k)
        number, table, least = direct_light_kernels.KINDS[kind], self._tables[k], self._least[k]
        extent = np.float32(np.tan(EXTENT / 2) if narrow else 0)
        if kind in LOBES and NARROW <= least < WIDE:
            parts = next(parts for width, parts in PARTS if least >= width)
            grazing = n[:, 2] < GRAZING
            for here, divided in ((~grazing, parts), (grazing, 2 * parts)):
                radiance = np.zeros((int(here.sum()), 3), np.float32)
                direct_light_kernels.add_blocks(
                    number,
                    n[here],
                    table,
                    np.float32(WITHIN[kind]),
                    *self.detail(divided),
                    radiance,
                )
                out[here] += radiance
            return
        # sheen is bright near the horizon, whatever its width
        width = {"diffuse": 1.0, "sheen": 0.1}.get(kind, least)
        rows = min(len(self.light), next(rows for wide, rows in BLOCKS if width >= wide))
        direct_light_kernels.add_lights(number, n, table, extent, self.lights(rows), out)

    def _sample(
        self, k: int, n: np.ndarray, facets: np.ndarray, samples: int, out: np.ndarray
    ) -> None:
        """Add to out (P, 3) what closure k reflects from within its extent."""
        direct_light_kernels.add_samples(
            direct_light_kernels.KINDS[self.mixture.kinds[k]],
            n,
            facets,
            self._tables[k],
            np.float32(np.tan(EXTENT / 2)),
            self.light,
            np.ascontiguousarray(self.camera_from_light.T, np.float32),
            samples,
            out,
        )


@dataclass(frozen=True, eq=False)
class _Map:
    """Radiance of a closure of unit weight: nodes (S, S, 3), and known (S, S) uint8."""

    nodes: np.ndarray
    known: np.ndarray

    def normals(self, nodes: np.ndarray) -> np.ndarray:
        """Return the normals (N, 3) of nodes (N, 2), by row and column."""
        place = ((nodes[:, ::-1] - 1) / (len(self.known) - 3) * 2 - 1) * (np.pi / 2)
        theta = np.linalg.norm(place, axis=1)
        along = place / np.maximum(theta[:, None], 1e-12)
        theta = np.minimum(theta, np.arccos(FACING))
        n = np.concatenate([np.sin(theta)[:, None] * along, np.cos(theta)[:, None]], axis=1)
        return n.astype(np.float32)

    def set(self, nodes: np.ndarray, radiance: np.ndarray) -> None:
        """Keep the radiance (N, 3) of nodes (N, 2)."""
        rows, columns = nodes.T
        self.nodes[rows, columns] = radiance
        self.known[rows, columns] = 1

    @classmethod
    def empty(cls, size: int) -> _Map:
        return cls(np.zeros((size, size, 3), np.float32), np.zeros((size, size), np.uint8))


def _distinct(
    indices: np.ndarray, cells: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | slice]:
    """Return one of the indices (N,) for each cell, and which of them stands for each index."""
    if cells is None:
        return indices, slice(None)
    _, first, each = np.unique(cells[indices], return_index=True, return_inverse=True)
    return indices[first], each


def _facing(n: np.ndarray) -> np.ndarray:
    """Return normals (P, 3) with n·v of at least FACING."""
    n = np.concatenate([n[:, :2], np.maximum(n[:, 2:], FACING)], axis=1)
    return (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)


def _table(mixture: Mixture, k: int) -> np.ndarray:
    """Return closure k's log α, tilt and weights (S, 5) at equal steps of 1 − n·v, float32."""
    columns = (mixture.log_alpha[:, k, None], mixture.tilt[:, k, None], mixture.weights[:, k])
    values = np.concatenate(columns, axis=1)
    table = ramp_table(mixture.stops, values) if len(values) > 1 else np.repeat(values, 2, axis=0)
    return table.astype(np.float32)
