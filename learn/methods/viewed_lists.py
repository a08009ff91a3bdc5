"""The culled sum for a view per pixel: lists of blocks of lights for each tile of pixels.

Numpy around the kernels of learn.engines.viewed_lists, float32; what learn.methods.block_lists is
for a distant viewer.
"""

import functools
import math

import numpy as np
import torch

from learn.engines import machine_code, threads
from learn.engines.layout import (
    CONE_ENERGY,
    CONE_W_COS,
    CULLED_CHUNKS,
    LANES,
    SELECT_VIEW_STRIDE,
    THETA_BINS,
    VALUES,
    VIEW_CUTS,
    VIEW_SCRATCH,
)
from learn.engines.lights import general_material_gradient, general_tables, unblocked
from learn.methods.block_lists import (
    ALL_LOBES,
    CACHE_BYTES,
    DIM,
    FEW,
    PASS,
    TESTED,
    Lists,
    order_by_place,
    put_back,
    sum_first_axis,
    tile_size,
)
from learn.methods.light_tables import Lights
from shaders.spline import basis

LISTED = 2.5e-8  # seconds to sum a listed block for a pixel of its tile
FINE = 4  # angles per bin at which a material's curves are looked up
ANGLES = np.linspace(0.0, np.pi / 2, FINE * THETA_BINS + 1)
BASIS = basis(ANGLES)  # (angles, 6)
# places in ANGLES of each bin, with both its ends
IN_BIN = FINE * np.arange(THETA_BINS)[:, None] + np.arange(FINE + 1)
GRAZING = 1.35  # θ_d from which a lobe's height is not compared with others': few pixels have it


@functools.lru_cache(maxsize=2 * THETA_BINS)
def bins_around(window: int) -> np.ndarray:
    """The bins (THETA_BINS, 2 window + 1) that are at most `window` from each, held at the ends."""
    near = np.arange(THETA_BINS)[:, None] + np.arange(-window, window + 1)
    return np.clip(near, 0, THETA_BINS - 1)


class ViewedTables:
    """Some lobes of a material under some lights, as learn.engines.viewed_lists reads them.

    m         (3, 3, 2, 6); energy: (blocks, 3, 16)
    values    (many, 3, 2, 6) float32: control values of the lobes' splines
    curves    (many, 2, angles) float64: the least γ and the largest κ log2 e over channels
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
        self.geometry = lights.general_geometry
        self.values = general_tables(m).values.reshape(3, 3, 2, 6)[self.numbers].copy()
        self.cones = lights.cones.copy()
        brightest = np.zeros(len(self.cones) * LANES, np.float32)
        # a light gathered from others may be negative
        brightest[: lights.blocks] = np.abs(energy).sum(-1).max(-1)
        if light_gradient:  # a dark block matters too: it counts as one of a tenth of the mean
            least = 0.1 * brightest.sum() / lights.blocks or 1.0
            brightest = np.maximum(brightest, np.float32(least))
        self.cones[:, CONE_ENERGY] = brightest.reshape(-1, LANES)
        curves = self.values.astype(np.float64) @ BASIS.T
        self.curves = np.stack([curves[:, :, 0].min(1), curves[:, :, 1].max(1)], 1)
        common = self.curves[:, 1, : np.searchsorted(ANGLES, GRAZING)]
        least_height = DIM * common.max()
        self.dims_lobes = material_gradient and bool((common < least_height).any())
        self.least_height = least_height
        blocks = self.cones[:, CONE_W_COS].reshape(-1)[: lights.blocks]
        self.widest_block = float(np.arccos(np.clip(blocks.min(), -1.0, 1.0)))
        self.made_ranges: dict[tuple[int, bool], np.ndarray] = {}

    def ranges(self, views: np.ndarray, size: int, backward: bool) -> np.ndarray:
        """Return the table `ranges` for tiles of `size` pixels with views (P, 3).

        backward  whether lobes of almost no height count, whose derivative by κ does not depend on
                  their height
        """
        widest = self.widest_block + widest_tile(views, size)
        window = int(np.ceil(0.5 * widest / (np.pi / 2) * THETA_BINS)) + 1
        key = window, backward and self.dims_lobes
        if key not in self.made_ranges:
            curves = self.curves
            if key[1]:
                curves = curves.copy()
                curves[:, 1] = np.maximum(curves[:, 1], self.least_height)
            # the least is the largest of the negative
            signed = curves * np.array([-1.0, 1.0])[:, None]
            around = signed[:, :, IN_BIN].max(-1)[:, :, bins_around(window)].max(-1)
            around[:, 0] *= -1
            self.made_ranges[key] = np.ascontiguousarray(around, np.float32)
        return self.made_ranges[key]

    def material_gradient(self, m_sums: np.ndarray) -> np.ndarray:
        """Derivative (3, 3, 2, 6) float64 by m, from the sums (chunks, 108, 16) of the kernel."""
        sums = m_sums.sum((0, 2), dtype=np.float64)[: 36 * self.many]
        lobe_sums = np.zeros((3, 3, 2, 6))
        lobe_sums[self.numbers] = sums.reshape(self.many, 3, 2, 6)
        return general_material_gradient(lobe_sums)


def widest_tile(views: np.ndarray, size: int) -> float:
    """The largest half angle of the cones about the views (P, 3) of tiles of `size` pixels."""
    whole = len(views) // size * size
    least = 1.0
    for tiles in (views[:whole].reshape(-1, size, 3), views[None, whole:]):
        if tiles.size:
            axis = np.einsum("tpi->ti", tiles)
            length = np.sqrt(np.einsum("ti,ti->t", axis, axis))
            along = np.einsum("tpi,ti->tp", tiles, axis).min(1) / np.maximum(length, 1e-6)
            least = min(least, float(along.min()))
    return math.acos(max(least, -1.0))


class ViewedListing:
    """Radiance at pixels by the lights of each tile's list, and its backward pass.

    n, view       (P, 3)
    left_out      radiance that may be missing from a pixel in a channel
    stored_bytes  as in block_lists.Listing
    view_gap      the longest difference of a view from that of the run that it shares
    radiance      (P, 3)
    list_bytes    lists that this object stores
    """

    def __init__(
        self,
        n: np.ndarray,
        view: np.ndarray,
        tables: ViewedTables,
        left_out: float,
        stored_bytes: int = 0,
        view_gap: float = 0.0,
    ):
        self.limit = np.array([view_gap], np.float32)
        self.tables, self.left_out, self.order = tables, left_out, order_by_place(n)
        self.n, self.view = n.take(self.order, 0), view.take(self.order, 0)
        self.list_bytes, self.lists = 0, dict[int, Lists]()
        out = np.empty_like(self.n)
        for start in range(0, len(n), PASS):
            part = slice(start, start + PASS)
            lists = select_lists(self.n[part], self.view[part], tables, left_out)
            run_forward(self.n[part], self.view[part], tables, lists, self.limit, out[part])
            if stored_bytes + self.list_bytes < CACHE_BYTES and not tables.dims_lobes:
                self.lists[start] = lists
                self.list_bytes += sum(array.nbytes for array in lists)
        self.radiance = put_back(out, self.order)

    def backward(
        self, g: np.ndarray, with_view: bool = True, with_n: bool = True
    ) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray, np.ndarray]:
        """Return derivatives of Σ g·radiance.

        By n (P, 3) or None, by view (P, 3) or None, by m (3, 3, 2, 6) float64 and by E (3, T).
        with_view  requires with_n
        """
        g = g.take(self.order, 0)
        by_n, by_view, by_m = np.empty_like(g), np.empty_like(g), np.zeros((3, 3, 2, 6))
        by_E = np.zeros((3, len(self.tables.lights.w)), np.float32)
        for start in range(0, len(g), PASS):
            part = slice(start, start + PASS)
            n, view = self.n[part], self.view[part]
            lists = self.lists.get(start) or select_lists(n, view, self.tables, self.left_out, True)
            energy_sums, m_sums = run_backward(
                n,
                view,
                self.tables,
                lists,
                self.limit,
                g[part],
                by_n[part],
                by_view[part],
                (with_n, with_view),
            )
            by_m += self.tables.material_gradient(m_sums)
            by_E += unblocked(energy_sums)[:, : by_E.shape[1]]
        placed_n = put_back(by_n, self.order) if with_n else None
        placed_view = put_back(by_view, self.order) if with_view else None
        return placed_n, placed_view, by_m, by_E


def select_lists(
    n: np.ndarray,
    view: np.ndarray,
    tables: ViewedTables,
    left_out: float,
    backward: bool = False,
) -> Lists:
    """Return each tile's list."""
    size, capacity, cones = tile_size(len(n)), tables.lights.blocks, tables.cones
    tiles = -(-len(n) // size)
    budget = np.array([min(left_out, np.finfo(np.float32).max)], np.float32)
    ranges = tables.ranges(view, size, backward)
    lists = Lists(
        np.empty((tiles, capacity, VIEW_CUTS), np.float32),
        np.empty(tiles, np.int32),
        np.empty((tiles, capacity), np.int32),
    )

    def kernel(first: int, last: int) -> None:
        scratch = np.empty(len(cones) * SELECT_VIEW_STRIDE, np.float32)
        sizes = first, last, len(n), size, len(cones), capacity, tables.many
        arrays = budget, n, view, cones, ranges, scratch
        machine_code.call("viewed_lists.select", *sizes, *arrays, *lists)

    workers = threads.worth(torch.get_num_threads(), tiles * len(cones) * 2 * TESTED)
    threads.run(kernel, threads.split(tiles, workers), workers)
    return lists


def workers_for(lists: Lists, pixels: int) -> int:
    """Return the number of threads that a sum over the pixels' lists deserves."""
    seconds = int(lists.lengths.sum()) * tile_size(pixels) * LISTED
    return threads.worth(torch.get_num_threads(), seconds)


def run_forward(
    n: np.ndarray,
    view: np.ndarray,
    tables: ViewedTables,
    lists: Lists,
    limit: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write radiance (P, 3) into out; limit: as in learn.engines.viewed_sums."""

    def kernel(first: int, last: int) -> None:
        scratch = np.empty(VIEW_SCRATCH, np.float32)
        sizes = first, last, len(n), tile_size(len(n)), lists.entries.shape[1], tables.many
        arrays = limit, n, view, tables.geometry, tables.energy, tables.values, scratch, out
        machine_code.call("viewed_sums.forward", *sizes, *arrays, *lists)

    workers = workers_for(lists, len(n))
    threads.run(kernel, threads.split(len(lists.lengths), 2 * workers), workers)


def run_backward(
    n: np.ndarray,
    view: np.ndarray,
    tables: ViewedTables,
    lists: Lists,
    limit: np.ndarray,
    g: np.ndarray,
    by_n: np.ndarray,
    by_view: np.ndarray,
    requested: tuple[bool, bool],
) -> tuple[np.ndarray, np.ndarray]:
    """Return energy sums (blocks, 3, 16) and sums by the material (chunks, 108, 16).

    by_n, by_view  (P, 3) are written, each if requested; the latter only together with the former
    """
    blocks = tables.lights.blocks
    # by the pixels, never by the threads: sums must come out the same
    chunks = min(CULLED_CHUNKS, 1 + len(n) // FEW)
    energy_sums = np.empty((chunks, blocks, 3, LANES), np.float32)
    m_sums = np.empty((chunks, VALUES, LANES), np.float32)
    scratch = np.empty(chunks * VIEW_SCRATCH, np.float32)
    tiles, capacity = lists.entries.shape

    def kernel(first: int, last: int) -> None:
        sizes = len(n), tile_size(len(n)), tiles, blocks, capacity, tables.many, chunks
        flags = map(int, requested)
        inputs = limit, n, view, tables.geometry, tables.energy, tables.values, scratch, g
        outputs = by_n, by_view, energy_sums, m_sums
        arrays = *inputs, *outputs, *lists
        machine_code.call("viewed_derivatives.backward", first, last, *sizes, *flags, *arrays)

    workers = workers_for(lists, len(n))
    threads.run(kernel, threads.split(chunks, workers), workers)
    return sum_first_axis(energy_sums), m_sums
