"""Direct light of a mixture of closures without noise, seen by a distant viewer.

A mixture's radiance is a function of the normal alone when the viewer and the light are distant
(shaders.reflectance_maps). Each closure is integrated as its width asks for:

wide    by maps over the visible hemisphere, of unit weight, between whose nodes radiance is
        interpolated. A node is the sum over the light's texels: blocks of them count as one light
        where the lobe is much wider, and near a narrower lobe's axis each is divided. Flat faces of
        many points have sums of their own, over all texels: an error would be that of a whole face
narrow  at every normal, over sample directions that follow the lobe as far as `extent` around its
        axis; what a long-tailed lobe (GGX) reflects from beyond comes from a map as above

What Cycles does besides is part of it: on coarse meshes, whose interpolated normals lean from their
facets, narrower lobes reflect no light from below the facet; where such a normal faces away
from the viewer, they reflect only if their tilted normal does not; and Cycles draws some half
vectors of Ashikhmin and Shirley's closure wrongly, which brightens grazing views.

The light is piecewise constant over its texels, as in the layer and in Cycles with nearest look-up.

n      (…, 3) unit normals, camera frame; the viewer is at (0, 0, 1)
t      (tan θ_h / α)²
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from shaders import direct_light_kernels, light_blocks, normal_groups
from shaders.light_blocks import LightBlocks
from shaders.mixture import TABLE_SIZE, Mixture, ramp_table, table_look_up
from shaders.normal_groups import (
    COS_LEANING,
    FACING,
    Group,
    by_repetition,
    distinct,
    large,
    means,
    turn_to_viewer,
)
from shaders.reflectance_maps import ReflectanceMap

LOBES = ("ggx", "beckmann", "ashikhmin_shirley")
NARROW = 0.03  # α below which a lobe is sampled
WIDE = 0.1  # α from which blocks of texels may count as one light
LEAST_NODES = 64  # of a map across the hemisphere
SPACING = 0.5  # of nodes, in units of the lobe's α
BLOCKS = ((0.3, 16), (0.15, 32), (0.0, 64))  # rows of light blocks for closures at least so wide
PARTS = ((0.035, 2), (0.0, 3))  # into how many a texel is divided there, by α
GRAZING = 0.25  # n·v below which texels are divided twice as finely: half vectors lie closer there
WITHIN = {"ggx": 5.0, "beckmann": 3.8, "ashikhmin_shirley": 3.8}  # tan θ_h / α that is near
SAMPLES = 12  # directions per normal of each of the two distributions
# directions that points of one normal share, in units of those that they would have alone: their
# error is common to them, so that the differences of grids of points do not show it
SHARED = 4
MOST_TOGETHER = 16384
KEPT_FACES = 1 << 14  # sums of faces that are remembered
EXTENT = 0.2  # radians about the mirrored direction that samples of a narrow lobe cover
# into how many parts texels are divided below facets, by the least α of lobes that are not narrow
LEANING = ((0.1, 1), (0.05, 2), (0.0, 3))
HALF_VECTORS = 512  # per normal, of those that Cycles turns round
UNWEIGHTED = np.array([[0, 0, 1, 1, 1]] * 2, np.float32)  # a table of unit weights
GRAZING_ROWS = TABLE_SIZE // 4  # of a table, at n·v below a quarter


def constants() -> list[list[object]]:
    """Return name and value of every constant that alters pixels, for a fingerprint."""
    result: list[list[object]] = []
    names = globals() | vars(light_blocks) | vars(normal_groups)
    for module in (names, vars(direct_light_kernels)):
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
        self.blocks = LightBlocks(self.light, camera_from_light)
        self._least = np.exp(mixture.log_alpha.min(0))
        self._maps = {k: ReflectanceMap.empty(self._size(k)) for k in range(len(mixture.kinds))}
        self._faces: dict[bytes, np.ndarray] = {}  # what maps are for, by normals of flat faces
        self._misdirected: ReflectanceMap | None = None
        if misdirected and "ashikhmin_shirley" in mixture.kinds and self.light.any():
            self._misdirected = ReflectanceMap.empty(LEAST_NODES)
        self._tables = [_table(mixture, k) for k in range(len(mixture.kinds))]

    @property
    def narrowest(self) -> float:
        """The least α of a closure with a lobe, 1 without one."""
        return min(self._lobes, default=1.0)

    @property
    def narrowest_listed(self) -> float:
        """The least α of a closure with a lobe that is not narrow, 1 without one."""
        return min([a for a in self._lobes if a >= NARROW], default=1.0)

    @property
    def _lobes(self) -> list[float]:
        """The least α of each closure with a lobe."""
        kinds = self.mixture.kinds
        return [float(a) for a, kind in zip(self._least, kinds, strict=True) if kind in LOBES]

    @property
    def narrow(self) -> int:
        """The number of narrow closures."""
        return sum(self._is_narrow(k) for k in range(len(self.mixture.kinds)))

    @property
    def map_size(self) -> float:
        """The nodes of the maps that take long, in units of those of a lobe of α = 1.

        Blocks of the light count as one for wider closures, which are quick.
        """
        return sum(
            1 / (self._least[k] if not self._is_narrow(k) else EXTENT / 4) ** 2
            for k, kind in enumerate(self.mixture.kinds)
            if kind in LOBES and self._has_map(k) and self._least[k] < WIDE
        )

    def at(
        self,
        n: np.ndarray,
        samples: int = SAMPLES,
        facets: np.ndarray | None = None,
        misdirected: bool = True,
        cells: np.ndarray | None = None,
        patches: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return radiance (P, 3) float32 at normals (P, 3), of which some may face away.

        samples      directions per normal of each of the two distributions of a narrow lobe; few
                     suffice where many normals are averaged, for their errors differ
        facets       (P, 3) normals of the surface itself: of light below it Cycles loses a part
                     (direct_light_kernels.add_leaning). None: the normals
        misdirected  False: without the light that Cycles finds by mistake
        cells        (P,) integers, equal for similar normals that are neighbours in a picture: what
                     takes a sum of its own near the horizon is computed once for the mean of each
                     cell. None: for each normal
        patches      (P,) the same for neighbours on one facet: what facets take away, and what
                     normals that face away reflect by the same closures
        """
        given = np.ascontiguousarray(n, np.float32)
        facets = None if facets is None else np.ascontiguousarray(facets, np.float32)
        n, lean = turn_to_viewer(given, facets)
        facets = n if facets is None else facets
        radiance = np.zeros_like(n)
        alone, shared = by_repetition(n, facets)
        faces = large(shared)
        if len(faces.first):
            radiance[faces.points] = self._on_faces(n[faces.first])[faces.each]
            others = np.ones(len(n), bool)
            others[faces.points] = False
            radiance[others] = self._mapped(n[others], None if cells is None else cells[others])
        else:
            radiance += self._mapped(n, cells)
        for k in range(len(self.mixture.kinds)):
            if self._is_narrow(k):
                self._sample(k, n, facets, alone, shared, samples, radiance)
        if lean:
            (leaning,) = np.nonzero(np.einsum("ij,ij->i", facets, n) < COS_LEANING)
            first, each = distinct(leaning, patches)
            towards = means(n[leaning], each)
            radiance[leaning] -= self._leaning(towards, facets[first], away=False)[each]
            np.maximum(radiance, 0, out=radiance)
        (away,) = np.nonzero(given[:, 2] < FACING)
        if len(away):
            patches = None if patches is None else self._by_closures(given, patches)
            first, each = distinct(away, patches)
            towards = means(given[away], each)
            radiance[away] = self._leaning(towards, facets[first], away=True)[each]
        return radiance + self.mistaken(given, facets, cells, patches) if misdirected else radiance

    def each_light(self, n: np.ndarray, rows: int) -> np.ndarray:
        """Return what the mixture reflects of each light at normals (P, 3): (P, 3, T) float32.

        What `draw_narrow` draws is no part of it, nor what Cycles does at facets. The T lights are
        those of LightBlocks.listed_patches.

        rows  of blocks of the light, of which wide lobes reflect each as one light
        """
        lights, (centres, radii, near, _) = self.blocks.lights(rows), self.blocks.detail(1)
        out = np.empty((len(n), 3, lights.shape[1] + near.shape[0] * near.shape[2]), np.float32)
        direct_light_kernels.list_lights(
            np.array([direct_light_kernels.KINDS[kind] for kind in self.mixture.kinds]),
            n,
            np.stack(self._tables),
            np.array([self._extent(k) for k in range(len(self.mixture.kinds))], np.float32),
            np.float32(WIDE),
            np.array([WITHIN.get(kind, 0.0) for kind in self.mixture.kinds], np.float32),
            lights,
            centres,
            radii,
            near,
            out,
        )
        return out

    def draw_narrow(
        self, number: int, n: np.ndarray, facets: np.ndarray, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw directions that one of the `narrow` closures reflects light from at normals (P, 3).

        number  of the closure, 0 … narrow − 1
        facets  (P, 3) normals of the surface itself
        places  (P, J, 2) in [0, 1), which give the directions
        Returns  directions and radiance (P, J, 3) float32; the mean of radiance over J is what the
                 closure adds to `at` near its mirrored direction
        """
        k = [k for k in range(len(self.mixture.kinds)) if self._is_narrow(k)][number]
        w, radiance = np.empty((2, *places.shape[:2], 3), np.float32)
        direct_light_kernels.draw_samples(
            direct_light_kernels.KINDS[self.mixture.kinds[k]],
            np.ascontiguousarray(n, np.float32),
            np.ascontiguousarray(facets, np.float32),
            self._tables[k],
            np.float32(self._extent(k)),
            self.light,
            np.ascontiguousarray(self.camera_from_light.T, np.float32),
            np.ascontiguousarray(places, np.float32),
            w,
            radiance,
        )
        return w, radiance

    def mistaken(
        self,
        n: np.ndarray,
        facets: np.ndarray,
        cells: np.ndarray | None = None,
        patches: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the light (P, 3) that Cycles finds by mistake; arguments as `at` takes them."""
        radiance = np.zeros_like(n)
        if self._misdirected is None:
            return radiance
        self._look_up(
            self._misdirected, self.misdirected, None, turn_to_viewer(n)[0], radiance, cells
        )
        (away,) = np.nonzero(n[:, 2] < FACING)
        if len(away):
            first, each = distinct(away, patches)
            radiance[away] = self.misdirected(means(n[away], each), facets[first])[each]
        return radiance

    def _mapped(self, n: np.ndarray, cells: np.ndarray | None) -> np.ndarray:
        """Return what closures reflect at normals (P, 3), but not what `_sample` adds; by maps."""
        radiance = np.zeros_like(n)
        for k in range(len(self.mixture.kinds)):
            if self._has_map(k):
                self._look_up(self._maps[k], partial(self._summed, k), k, n, radiance, cells)
        return radiance

    def _on_faces(self, n: np.ndarray) -> np.ndarray:
        """Return the same at normals (F, 3) of flat faces, each by a sum over all texels."""
        if len(self._faces) > KEPT_FACES:
            self._faces.clear()
        keys = [each.tobytes() for each in n]
        lacking = [i for i, key in enumerate(keys) if key not in self._faces]
        sums = np.zeros((len(lacking), 3), np.float32)
        for k in range(len(self.mixture.kinds)):
            if lacking and self._has_map(k):
                weights = table_look_up(self._tables[k][:, 2:], 1 - n[lacking, 2])
                sums += self._summed(k, n[lacking], in_blocks=False) * weights
        self._faces.update(zip((keys[i] for i in lacking), sums, strict=True))
        return np.stack([self._faces[key] for key in keys])

    def _by_closures(self, n: np.ndarray, patches: np.ndarray) -> np.ndarray:
        """Return integers (P,) that are equal where patches (P,) are and the same closures reflect.

        At normals (P, 3) that face away those do whose tilted normal faces the viewer.
        """
        for table in self._tables:
            tilt = table_look_up(table[:, 1:2], 1 - np.abs(n[:, 2]))[:, 0]
            patches = 2 * patches + (n[:, 2] + tilt * (1 - n[:, 2] ** 2) > 0)
        return patches

    def _leaning(self, n: np.ndarray, facets: np.ndarray, away: bool) -> np.ndarray:
        """Return what add_leaning adds (P, 3) at normals and facets (P, 3)."""
        width = self.narrowest_listed
        parts = 1 if away else next((parts for wide, parts in LEANING if width >= wide), 1)
        extents = [0.0 if away else self._extent(k) for k in range(len(self._least))]
        radiance = np.zeros_like(n)
        direct_light_kernels.add_leaning(
            np.array([direct_light_kernels.KINDS[kind] for kind in self.mixture.kinds]),
            n,
            facets,
            np.stack(self._tables),
            np.array(extents, np.float32),
            *self.blocks.texels(parts),
            away,
            radiance,
        )
        return radiance

    def _is_narrow(self, k: int) -> bool:
        return self.mixture.kinds[k] in LOBES and bool(self._least[k] < NARROW)

    def _extent(self, k: int) -> float:
        """Return tan θ_h up to which closure k is sampled, 0 where it is not."""
        return float(np.tan(EXTENT / 2)) if self._is_narrow(k) else 0.0

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
        at: ReflectanceMap,
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
        horizon = self._horizon(at, k)
        lacking = at.add(n, horizon, table, out)
        if len(lacking):
            nodes = np.argwhere(at.known == 2)
            at.set(nodes, compute(at.normals(nodes)))
            # added as where the nodes were known, so that what was asked before changes no bit
            radiance = out[lacking]
            at.add(n[lacking], horizon, table, radiance)
            out[lacking] = radiance
        (low,) = np.nonzero(n[:, 2] < np.float32(horizon))
        if len(low):
            weights = table_look_up(table[:, 2:], 1 - n[low, 2])
            _, each = distinct(low, cells)
            out[low] += compute(means(n[low], each))[each] * weights

    def _horizon(self, at: ReflectanceMap, k: int | None) -> float:
        """Return n·v below which a map is not looked up: two nodes from where closure k ends.

        A closure whose normal is tilted away from the viewer ends before n·v = 0.
        """
        tilts = self.mixture.tilt if k is None else self._tables[k][-GRAZING_ROWS:, 1]
        return 2 * np.pi / (len(at.known) - 3) + max(0.0, -float(tilts.min()))

    def _summed(self, k: int, n: np.ndarray, in_blocks: bool = True) -> np.ndarray:
        """Return what closure k of unit weight reflects, but not what `_sample` adds, (N, 3).

        in_blocks  whether blocks of texels may count as one light
        """
        radiance = np.zeros_like(n)
        self._sum(k, n, in_blocks, radiance)
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
            self.blocks.density,
            np.ascontiguousarray(self.camera_from_light.T, np.float32),
            HALF_VECTORS,
            radiance,
        )
        return radiance

    def _sum(self, k: int, n: np.ndarray, in_blocks: bool, out: np.ndarray) -> None:
        """Add to out (N, 3) what `_summed` returns."""
        kind = self.mixture.kinds[k]
        number, table, least = direct_light_kernels.KINDS[kind], self._tables[k], self._least[k]
        extent = np.float32(self._extent(k))
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
                    *self.blocks.detail(divided),
                    radiance,
                )
                out[here] += radiance
            return
        # sheen is bright near the horizon, whatever its width
        width = {"diffuse": 1.0, "sheen": 0.1}.get(kind, least)
        rows = len(self.light)
        if in_blocks:
            rows = min(rows, next(rows for wide, rows in BLOCKS if width >= wide))
        direct_light_kernels.add_lights(number, n, table, extent, self.blocks.lights(rows), out)

    def _sample(
        self,
        k: int,
        n: np.ndarray,
        facets: np.ndarray,
        alone: Group,
        shared: Group,
        samples: int,
        out: np.ndarray,
    ) -> None:
        """Add to out (P, 3) what closure k reflects from within its extent.

        Points of a flat facet have one normal, and reflect the same. They share their directions,
        instead of having a few each, whose noise would be large.

        alone, shared  points by whether others have their normals (`by_repetition`)
        """
        common = SHARED * samples * len(shared.points) // max(len(shared.first), 1)
        for group, count in ((alone, samples), (shared, min(common, MOST_TOGETHER))):
            if not len(group.points):
                continue
            radiance = np.zeros((len(group.first), 3), np.float32)
            direct_light_kernels.add_samples(
                direct_light_kernels.KINDS[self.mixture.kinds[k]],
                n.take(group.first, axis=0),
                facets.take(group.first, axis=0),
                self._tables[k],
                np.float32(self._extent(k)),
                self.light,
                np.ascontiguousarray(self.camera_from_light.T, np.float32),
                count,
                radiance,
            )
            direct_light_kernels.add_rows(group.points, radiance, group.each, out)


def _table(mixture: Mixture, k: int) -> np.ndarray:
    """Return closure k's log α, tilt and weights (S, 5) at equal steps of 1 − n·v, float32."""
    columns = (mixture.log_alpha[:, k, None], mixture.tilt[:, k, None], mixture.weights[:, k])
    values = np.concatenate(columns, axis=1)
    table = ramp_table(mixture.stops, values) if len(values) > 1 else np.repeat(values, 2, axis=0)
    return table.astype(np.float32)
