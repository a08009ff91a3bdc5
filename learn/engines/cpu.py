"""The exact sum and its derivatives on the CPU: the kernels, run group by group on threads.

P pixels, G groups (one image and one material each; pixels lie sorted by group), B images; numpy
arrays, float32 throughout.
n, view   (P, 3); view None: orthographic, (0, 0, 1) for every pixel
m         (G, 3, 3, 2, 6) κ and γ control values
light     (B, height, width, 3) linear radiance, light frame
rotation  nine numbers, camera_from_light
counts    pixels of each group; light_of: the index of its light
workers   threads

Results do not depend on the number of threads nor on what else is in the batch, to the last bit: a
pixel's sum runs over the lights in one order; derivatives are summed over fixed chunks of lights,
then over slices of PASS pixels in float64. Memory beyond inputs and outputs: the tables of a slab
of lights and of a slice of pixels, about 20 MiB.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from learn.engines import lights, threads
from learn.engines.layout import (
    DISTANT_SCRATCH,
    DISTANT_TILE,
    GENERAL_SCRATCH,
    GENERAL_TILE,
    LIGHT_CHUNKS,
    VALUES,
)
from learn.engines.lights import DistantTables, GeneralTables, Rotation, Slab
from learn.engines.machine_code import call

PASS = 8192  # pixels whose derivatives are summed in float32
CACHED_TABLES = 4  # materials whose tables are cached while a batch runs
Key = TypeVar("Key")
Table = TypeVar("Table")
Gradients = tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]


def radiance(
    n: np.ndarray,
    view: np.ndarray | None,
    m: np.ndarray,
    light: np.ndarray,
    rotation: Rotation,
    counts: Sequence[int],
    light_of: Sequence[int],
    workers: int,
) -> np.ndarray:
    """Radiance (P, 3)."""
    out = np.zeros_like(n)
    for slab in lights.slabs(light.shape[1], light.shape[2], rotation):
        prepared = Prepared(slab, m, light)
        for g, pixels in enumerate(groups(counts)):
            energy, cut = prepared.energy(light_of[g])
            if view is None:
                tables = prepared.distant(g)
                out[pixels] += distant_forward(n[pixels], slab, tables, energy, cut, workers)
            else:
                out[pixels] += general_forward(
                    n[pixels], view[pixels], slab.general, prepared.general(g), energy, cut, workers
                )
    return out


def gradients(
    g_radiance: np.ndarray,
    n: np.ndarray,
    view: np.ndarray | None,
    m: np.ndarray,
    light: np.ndarray,
    rotation: Rotation,
    counts: Sequence[int],
    light_of: Sequence[int],
    workers: int,
    with_view: bool = True,
) -> Gradients:
    """Derivatives of Σ g_radiance · radiance by n, view, m and light, in their shapes.

    with_view  whether the derivative by view is requested; where it is not, or where there is no
               view, None stands in its place
    Those by n and view are right in their tangential part, which is the part that passes through
    scaling to unit length.
    """
    by_n, by_m, by_light = np.zeros_like(n), np.zeros_like(m), np.zeros_like(light)
    by_view = np.zeros_like(view) if with_view and view is not None else None
    for slab in lights.slabs(light.shape[1], light.shape[2], rotation):
        prepared = Prepared(slab, m, light)
        for g, pixels in enumerate(groups(counts)):
            group = Group(n[pixels], g_radiance[pixels], *prepared.energy(light_of[g]), workers)
            if view is None:
                group_by_n, energy_sums, group_by_m = group.distant(slab, prepared.distant(g))
            else:
                group_by_n, group_by_view, energy_sums, group_by_m = group.general(
                    view[pixels], slab.general, prepared.general(g), by_view is not None
                )
                if by_view is not None:
                    by_view[pixels] += group_by_view
            by_n[pixels] += group_by_n
            by_m[g] += group_by_m
            slab.add_light_gradient(energy_sums, by_light[light_of[g]].reshape(-1, 3))
    return by_n, by_view, by_m, by_light


def groups(counts: Sequence[int]) -> list[slice]:
    """The slice of pixels of each group."""
    ends = np.cumsum((0, *counts))
    return [slice(a, b) for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]


class Prepared:
    """Tables of a batch's materials and lights for one slab, made on demand and cached."""

    def __init__(self, slab: Slab, m: np.ndarray, light: np.ndarray):
        self._slab, self._m, self._light = slab, m, light
        self._distant: dict[bytes, DistantTables] = {}
        self._general: dict[bytes, GeneralTables] = {}
        self._energy: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def distant(self, g: int) -> DistantTables:
        """Tables of group g's material for a distant viewer."""
        m = self._m[g].astype(np.float64)
        return cached(
            self._distant, m.tobytes(), lambda: lights.distant_tables(m, self._slab), CACHED_TABLES
        )

    def general(self, g: int) -> GeneralTables:
        """Tables of group g's material for a view per pixel."""
        m = self._m[g].astype(np.float64)
        return cached(self._general, m.tobytes(), lambda: lights.general_tables(m), CACHED_TABLES)

    def energy(self, image: int) -> tuple[np.ndarray, np.ndarray]:
        """Energy (blocks, 3, 16) of an image's light, and its cutoff (blocks,)."""

        def make() -> tuple[np.ndarray, np.ndarray]:
            energy = self._slab.energy(self._light[image])
            return energy, lights.cutoff(energy)

        return cached(self._energy, image, make, 1)


def cached(cache: dict[Key, Table], key: Key, make: Callable[[], Table], most: int) -> Table:
    """cache[key], made if it is missing; the oldest entry gives way where there are `most`."""
    if key not in cache:
        if len(cache) == most:
            cache.pop(next(iter(cache)))
        cache[key] = make()
    return cache[key]


def distant_forward(
    n: np.ndarray,
    slab: Slab,
    tables: DistantTables,
    energy: np.ndarray,
    cut: np.ndarray,
    workers: int,
) -> np.ndarray:
    """Radiance (p, 3) of one group by one slab's lights, for a distant viewer."""
    out = np.empty_like(n)

    def kernel(first: int, last: int) -> None:
        scratch = np.empty(DISTANT_SCRATCH, np.float32)
        arrays = n, slab.distant, energy, tables.lobes, tables.least, cut, scratch, out
        call("distant.forward", first, last, len(n), len(energy), *arrays)

    tiles = -(-len(n) // DISTANT_TILE)
    threads.run(kernel, threads.split(tiles, 8 * workers), workers)
    return out


def general_forward(
    n: np.ndarray,
    view: np.ndarray,
    geometry: np.ndarray,
    tables: GeneralTables,
    energy: np.ndarray,
    cut: np.ndarray,
    workers: int,
) -> np.ndarray:
    """Radiance (p, 3) of one group by one slab's lights (`Slab.general`), for a view per pixel."""
    out = np.empty_like(n)

    def kernel(first: int, last: int) -> None:
        arrays = n, view, geometry, energy, tables.values, tables.least, cut, out
        call("general.forward", first, last, len(n), len(energy), *arrays)

    tiles = -(-len(n) // GENERAL_TILE)
    threads.run(kernel, threads.split(tiles, 8 * workers), workers)
    return out


class Group:
    """The backward pass of one group's pixels under one slab's lights.

    Pixels are worked through in slices of PASS, whose sums are added in float64.
    """

    def __init__(
        self, n: np.ndarray, g: np.ndarray, energy: np.ndarray, cut: np.ndarray, workers: int
    ):
        self.n, self.g, self.energy, self.cut, self.workers = n, g, energy, cut, workers

    def slices(self) -> list[slice]:
        """Slices of at most PASS pixels."""
        return [slice(i, min(i + PASS, len(self.n))) for i in range(0, len(self.n), PASS)]

    def run(self, name: str, sizes: tuple[int, ...], arrays: tuple[np.ndarray, ...]) -> None:
        """Run a kernel over all chunks of lights."""
        threads.run(
            lambda first, last: call(name, first, last, *sizes, *arrays),
            threads.split(LIGHT_CHUNKS, LIGHT_CHUNKS),
            self.workers,
        )

    def distant(
        self, slab: Slab, tables: DistantTables
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivative by n, energy sums, and derivative by m, for a distant viewer."""
        by_n = np.empty_like(self.n)
        energy_part, lobe_part = np.empty_like(self.energy), np.empty_like(tables.lobes)
        energy_sums, lobe_sums = np.zeros(energy_part.shape), np.zeros(lobe_part.shape)
        scratch = np.empty(LIGHT_CHUNKS * DISTANT_SCRATCH, np.float32)
        for pixels in self.slices():
            n, g = self.n[pixels], self.g[pixels]
            n_part = np.empty((LIGHT_CHUNKS, *n.shape), np.float32)
            inputs = n, slab.distant, self.energy, tables.lobes, tables.least, self.cut
            outputs = n_part, energy_part, lobe_part
            sizes = len(n), len(self.energy)
            self.run("distant.backward", sizes, (*inputs, scratch, g, *outputs))
            by_n[pixels] = n_part.sum(0)
            energy_sums += energy_part
            lobe_sums += lobe_part
        by_m = lights.distant_material_gradient(lobe_sums, self.energy, tables.kappa, slab)
        return by_n, energy_sums, by_m

    def general(
        self, view: np.ndarray, geometry: np.ndarray, tables: GeneralTables, with_view: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives by n and view, energy sums, and derivative by m, for a view per pixel.

        geometry   `Slab.general`
        with_view  whether the derivative by view is computed; it is 0 otherwise
        """
        by_n, by_view = np.empty_like(self.n), np.empty_like(self.n)
        energy_part = np.empty_like(self.energy)
        energy_sums, m_sums = np.zeros(energy_part.shape), np.zeros(VALUES)
        scratch = np.empty(LIGHT_CHUNKS * GENERAL_SCRATCH, np.float32)
        for pixels in self.slices():
            n, v, g = self.n[pixels], view[pixels], self.g[pixels]
            n_part, v_part = np.zeros((2, LIGHT_CHUNKS, *n.shape), np.float32)
            m_part = np.empty((LIGHT_CHUNKS, -(-len(n) // GENERAL_TILE), VALUES), np.float32)
            inputs = n, v, geometry, self.energy, *tables, self.cut
            outputs = n_part, v_part, energy_part, m_part
            sizes = len(n), len(self.energy), int(with_view)
            self.run("general.backward", sizes, (*inputs, scratch, g, *outputs))
            by_n[pixels], by_view[pixels] = n_part.sum(0), v_part.sum(0)
            energy_sums += energy_part
            m_sums += m_part.sum((0, 1), dtype=np.float64)
        return by_n, by_view, energy_sums, lights.general_material_gradient(m_sums)
