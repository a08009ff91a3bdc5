"""The culled sum for a distant viewer: lists of blocks of lights for each tile of pixels.

Numpy around the kernels of learn.engines.culled_lists, culled_sums and tables, float32. A normal
may also look away from the viewer, as do nodes of a reflectance map just beyond the silhouette:
c = h·n is held above 0, so values and derivatives stay finite.
"""

from typing import NamedTuple

import numpy as np
import torch

from learn.engines import machine_code, pixel_selection, threads
from learn.engines.layout import (
    CONE_ENERGY,
    CONE_KAPPA,
    CULLED_CHUNKS,
    CULLED_SCRATCH,
    CULLED_TILE,
    CUTS,
    LANES,
    SELECT_ROWS,
)
from learn.engines.lights import lobe_first, unblocked
from learn.methods.light_tables import Lights

FEW = 512  # pixels from which the backward pass is worth a second thread
PASS = 65536  # pixels whose lists are made at a time
CACHE_BYTES = 2**26  # of lists that a picture stores for the backward pass
ALL_LOBES = (0, 1, 2)
# eight bits over the even places of sixteen
SPREAD_BITS = np.array([int(f"{number:b}", 4) for number in range(256)], np.uint16)
# seconds to test sixteen blocks for a tile, and to sum a listed block for a pixel of it
TESTED, LISTED = 7e-8, 1e-8
# of the highest lobe's κ: lobes below it count as if they had it where the derivative by κ is
# requested
DIM = 0.01


class Lists(NamedTuple):
    """The tiles' lists, as learn.engines.culled_lists describes them."""

    cuts: np.ndarray
    lengths: np.ndarray
    entries: np.ndarray


class Tables:
    """Some lobes of a material at each light, as learn.engines.culled_lists reads them.

    m         (3, 3, 2, 6); energy: (blocks, 3, 16)
    lobes     (blocks, many, 3, 2, 16); cones: (wide blocks, CONE_ROWS, 16)
    backward_cones  the cones by which lists are made for the backward pass: the same, unless a lobe
                    is dim and the derivative by the material requested
    """

    def __init__(
        self,
        m: np.ndarray,
        energy: np.ndarray,
        lights: Lights,
        light_gradient: bool,
        lobes: tuple[int, ...] = ALL_LOBES,
        material_gradient: bool = False,
    ):
        self.lights, self.energy, self.numbers, self.many = lights, energy, list(lobes), len(lobes)
        self.lobes = np.empty((lights.blocks, self.many, 3, 2, LANES), np.float32)
        self.cones = lights.cones.copy()
        chosen = np.ascontiguousarray(lobe_first(m)[self.numbers], np.float32)
        arrays = chosen, lights.basis, energy, self.lobes, self.cones
        machine_code.call("tables.make", 0, lights.blocks, self.many, *arrays)
        if light_gradient:  # a dark block matters too: it counts as one of a tenth of the mean
            brightness = self.cones[:, CONE_ENERGY]
            np.maximum(brightness, 0.1 * brightness.sum() / lights.blocks or 1.0, out=brightness)
        self.backward_cones = self.with_dim_lobes() if material_gradient else self.cones

    def with_dim_lobes(self) -> np.ndarray:
        """Return the cones, with no lobe lower than a part DIM of the highest.

        A lobe of almost no height adds almost nothing and so may be left out everywhere, but its
        derivative by κ, c^γ, does not depend on its height.
        """
        rows = slice(CONE_KAPPA, CONE_KAPPA + self.many)
        height = self.cones[:, rows]
        least = np.where(
            np.arange(self.cones.shape[0] * LANES) < self.lights.blocks,
            np.float32(DIM) * height.max(),
            np.float32(0.0),
        )
        raised = np.maximum(height, least.reshape(-1, 1, LANES))
        if np.array_equal(raised, height):
            return self.cones
        result = self.cones.copy()
        result[:, rows] = raised
        return result

    def material_gradient(self, lobe_sums: np.ndarray) -> np.ndarray:
        """Derivative (3, 3, 2, 6) float64 by m, from the lobe sums of learn.engines.culled_sums."""
        sums, by_m = np.empty((self.many, 3, 2, 6, LANES), np.float32), np.zeros((3, 3, 2, 6))
        sizes = self.many, self.lights.blocks, len(lobe_sums), lobe_sums[0].size
        arrays = self.lights.basis, self.energy, self.lobes, lobe_sums, sums
        machine_code.call("tables.gradient", *sizes, *arrays)
        by_m[self.numbers] = sums.sum(-1, dtype=np.float64)
        return lobe_first(by_m)


class Listing:
    """Radiance at normals n (P, 3) by the lights of each tile's list, and its backward pass.

    left_out      radiance that may be missing from a pixel in a channel
    stored_bytes  lists that others store for the backward pass; beyond CACHE_BYTES, lists are made
                  a second time there
    radiance      (P, 3)
    list_bytes    lists that this object stores
    """

    def __init__(self, n: np.ndarray, tables: Tables, left_out: float, stored_bytes: int = 0):
        self.tables, self.left_out, self.order = tables, left_out, order_by_place(n)
        self.n, self.list_bytes = n.take(self.order, 0), 0
        self.lists: dict[int, Lists] = {}
        out = np.empty_like(self.n)
        for start in range(0, len(n), PASS):
            part = self.n[start : start + PASS]
            lists = select_lists(part, tables, tables.cones, left_out)
            run_forward(part, tables, lists, out[start : start + PASS])
            if stored_bytes + self.list_bytes < CACHE_BYTES and (
                tables.backward_cones is tables.cones
            ):
                self.lists[start] = lists
                self.list_bytes += sum(array.nbytes for array in lists)
        self.radiance = put_back(out, self.order)

    def backward(
        self, g: np.ndarray, with_n: bool = True
    ) -> tuple[np.ndarray | None, np.ndarray, np.ndarray]:
        """Derivatives of Σ g·radiance by n (P, 3) or None, m (3, 3, 2, 6) float64 and E (3, T)."""
        g = g.take(self.order, 0)
        by_sorted_n, by_m = np.empty_like(g), np.zeros((3, 3, 2, 6))
        by_E = np.zeros((3, len(self.tables.lights.w)), np.float32)
        for start in range(0, len(g), PASS):
            part = slice(start, start + PASS)
            lists = self.lists.get(start) or select_lists(
                self.n[part], self.tables, self.tables.backward_cones, self.left_out
            )
            energy_sums, lobe_sums = run_backward(
                self.n[part], self.tables, lists, g[part], by_sorted_n[part], with_n
            )
            by_m += self.tables.material_gradient(lobe_sums)
            by_E += unblocked(energy_sums)[:, : by_E.shape[1]]
        if not with_n:
            return None, by_m, by_E
        return put_back(by_sorted_n, self.order), by_m, by_E


def order_by_place(n: np.ndarray) -> np.ndarray:
    """Return an order (P,) of pixels in which neighbours have similar unit normals (P, 3).

    It follows a Morton curve over the normals' x and y.
    """
    x, y = (
        (np.ascontiguousarray(n[:, axis]) * np.float32(127.5) + np.float32(128.0)).astype(np.uint8)
        for axis in (0, 1)
    )
    return np.argsort(SPREAD_BITS.take(x) | (SPREAD_BITS << 1).take(y), kind="stable")


def put_back(values: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Return values (P, 3) scattered to the places order (P,)."""
    result = np.empty_like(values)
    pixel_selection.run("pixels.spread", len(order), order, values, result)
    return result


def tile_size(pixels: int) -> int:
    """Return how many pixels share a list: few of few pixels, whose normals are far apart."""
    return 16 if pixels < 12288 else 32 if pixels < 24576 else CULLED_TILE


def select_lists(n: np.ndarray, tables: Tables, cones: np.ndarray, left_out: float) -> Lists:
    """Return each tile's list; cones: the tables' own, or those of their backward pass."""
    size, capacity = tile_size(len(n)), tables.lights.blocks
    tiles = -(-len(n) // size)
    budget = np.array([min(left_out, np.finfo(np.float32).max)], np.float32)
    lists = Lists(
        np.empty((tiles, capacity, CUTS), np.float32),
        np.empty(tiles, np.int32),
        np.empty((tiles, capacity), np.int32),
    )

    def kernel(first: int, last: int) -> None:
        scratch = np.empty(cones.shape[0] * SELECT_ROWS * LANES, np.float32)
        sizes = first, last, len(n), size, len(cones), capacity, tables.many
        machine_code.call("culled_lists.select", *sizes, budget, n, cones, scratch, *lists)

    workers = threads.worth(torch.get_num_threads(), tiles * len(cones) * TESTED)
    threads.run(kernel, threads.split(tiles, workers), workers)
    return lists


def workers_for(lists: Lists, pixels: int) -> int:
    """Return the number of threads that a sum over the pixels' lists deserves."""
    seconds = int(lists.lengths.sum()) * tile_size(pixels) * LISTED
    return threads.worth(torch.get_num_threads(), seconds)


def run_forward(n: np.ndarray, tables: Tables, lists: Lists, out: np.ndarray) -> None:
    """Write radiance (P, 3) at normals n (P, 3) into out."""
    lights = tables.lights

    def kernel(first: int, last: int) -> None:
        scratch = np.empty(CULLED_SCRATCH, np.float32)
        sizes = first, last, len(n), tile_size(len(n)), lists.entries.shape[1], tables.many
        arrays = n, lights.axes, lights.geometry, tables.energy, tables.lobes, scratch, out
        machine_code.call("culled_sums.forward", *sizes, *arrays, *lists)

    workers = workers_for(lists, len(n))
    threads.run(kernel, threads.split(len(lists.lengths), 2 * workers), workers)


def run_backward(
    n: np.ndarray,
    tables: Tables,
    lists: Lists,
    g: np.ndarray,
    by_n: np.ndarray,
    with_n: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Return energy sums (blocks, 3, 16) and lobe sums (chunks, blocks, many, 3, 2, 16).

    by_n  (P, 3) is written if with_n
    """
    lights, blocks, many = tables.lights, tables.lights.blocks, tables.many
    # by the pixels, never by the threads: sums must come out the same
    chunks = min(CULLED_CHUNKS, 1 + len(n) // FEW)
    energy_sums = np.empty((chunks, blocks, 3, LANES), np.float32)
    lobe_sums = np.empty((chunks, blocks, many, 3, 2, LANES), np.float32)
    scratch = np.empty(chunks * CULLED_SCRATCH, np.float32)
    tiles, capacity = lists.entries.shape

    def kernel(first: int, last: int) -> None:
        sizes = len(n), tile_size(len(n)), tiles, blocks, capacity, many, chunks, int(with_n)
        inputs = n, lights.axes, lights.geometry, tables.energy, tables.lobes, scratch, g
        outputs = by_n, energy_sums, lobe_sums
        machine_code.call("culled_sums.backward", first, last, *sizes, *inputs, *outputs, *lists)

    workers = workers_for(lists, len(n))
    threads.run(kernel, threads.split(chunks, workers), workers)
    return sum_first_axis(energy_sums), lobe_sums


def sum_first_axis(parts: np.ndarray) -> np.ndarray:
    """Return the sum over the first axis, in its order, into the first part."""
    for part in parts[1:]:
        parts[0] += part
    return parts[0]
