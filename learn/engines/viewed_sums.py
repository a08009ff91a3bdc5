"""Kernels that sum the lights of each tile's list for a view per pixel.

Letters, arrays and formulas as in learn.engines.viewed_lists, which makes the lists, and in
learn.engines.view_runs: pixels of similar view share h̄ and the spline values.
learn.engines.viewed_derivatives has the derivatives. Besides:
limit    (1,) the longest difference of a view from that of its run
"""

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.culled_sums import unpack
from learn.engines.distant import add_radiance, cosine
from learn.engines.exponentials import exp2, exp2m1
from learn.engines.layout import (
    CULLED_NORMALS,
    ENERGY_STRIDE,
    LANES,
    RUN_CHANNEL_STRIDE,
    RUN_GAMMA_SLOPE,
    RUN_KAPPA,
    RUN_KAPPA_SLOPE,
    RUN_LOBE_STRIDE,
    VIEW_CENTRES,
    VIEW_CUTS,
    VIEW_LOBES,
    VIEW_OFFSETS,
    VIEW_VIEWS,
)
from learn.engines.triples import clear, vector_at, write_sums
from learn.engines.vector import (
    FLOAT_POINTER,
    INT_POINTER,
    Lanes,
    Vector,
    anywhere,
    fma,
    lane_max,
    load,
    lowest_bit,
    splat,
)
from learn.engines.view_runs import (
    distance,
    make_lobes,
    make_runs,
    of_pixel,
    shared,
    turn,
)
from learn.engines.viewed_entries import Arrays, Entry, Run, entry_at, pixels_near, unpack_views

FORWARD = types.void(*[types.int64] * 6, *[FLOAT_POINTER] * 9, *[INT_POINTER] * 2)


@inlined
def lobe(scratch: np.ndarray, o: int, delta: Lanes, log_c: Lanes) -> Lanes:
    """expm1(κ c^γ) of the lobe and channel at offset o."""
    gamma = fma(delta, load(scratch, o + LANES * RUN_GAMMA_SLOPE), load(scratch, o))
    kappa = fma(
        delta, load(scratch, o + LANES * RUN_KAPPA_SLOPE), load(scratch, o + LANES * RUN_KAPPA)
    )
    return exp2m1(kappa * exp2(gamma * log_c))


@inlined
def reflectance(
    scratch: np.ndarray,
    cuts: np.ndarray,
    entry: Entry,
    many: int,
    nearest: float,
    delta: Lanes,
    log_c: Lanes,
) -> Vector:
    """F (3 channels) of one pixel at sixteen lights, by the run's lobes and their slopes.

    nearest  the largest log2 c; delta: δ of the pixel
    """
    f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
    for s in range(many):
        if nearest > cuts[VIEW_CUTS * entry.place + s]:
            t = VIEW_LOBES + RUN_LOBE_STRIDE * s
            f0 = f0 + lobe(scratch, t, delta, log_c)
            f1 = f1 + lobe(scratch, t + RUN_CHANNEL_STRIDE, delta, log_c)
            f2 = f2 + lobe(scratch, t + 2 * RUN_CHANNEL_STRIDE, delta, log_c)
    return f0, f1, f2


@inlined
def add_run(arrays: Arrays, entry: Entry, run: Run, many: int, scratch: np.ndarray) -> None:
    """Add the radiance of an entry's block to the sums of a run's pixels.

    The run's lobes are made for the first of its pixels that needs them.
    """
    geometry, o = arrays.geometry, entry.o
    same = shared(geometry, o, scratch, VIEW_CENTRES + run.first, run.furthest)
    near, made = run.near, False
    while near:
        j = run.first + lowest_bit(near)
        near &= near - 1
        normal = vector_at(arrays.n, 3 * (run.start + j))
        n_w = cosine(geometry, o, normal)
        if not anywhere(n_w > 0.0):
            continue
        log_c = of_pixel(same, scratch, VIEW_OFFSETS + j, normal)[3]
        nearest = lane_max(log_c)
        if not (nearest > entry.lowest):
            continue
        if not made:
            made = True
            make_lobes(geometry, o, same, run.furthest, run.alone, many, arrays.values, scratch, 0)
        delta = turn(geometry, o, same, scratch, VIEW_OFFSETS + j)
        f = reflectance(scratch, arrays.cuts, entry, many, nearest, delta, log_c)
        add_radiance(scratch, ENERGY_STRIDE * j, f, n_w, arrays.energy, entry.e)


def forward(
    first: int,
    last: int,
    pixels: int,
    size: int,
    room: int,
    many: int,
    limit: np.ndarray,
    n: np.ndarray,
    v: np.ndarray,
    geometry: np.ndarray,
    energy: np.ndarray,
    values: np.ndarray,
    scratch: np.ndarray,
    radiance: np.ndarray,
    cuts: np.ndarray,
    lengths: np.ndarray,
    entries: np.ndarray,
) -> None:
    """Radiance (P, 3) of pixel tiles first … last − 1; scratch holds VIEW_SCRATCH floats."""
    arrays = Arrays(n, geometry, energy, values, cuts)
    for tile in range(first, last):
        start = tile * size
        count = min(size, pixels - start)
        clear(scratch, 0, 3 * count)
        unpack(n, start, count, scratch, 0)
        unpack_views(v, start, count, scratch, VIEW_VIEWS)
        length = make_runs(v, start, count, limit[0], scratch, 0)
        for i in range(room * tile, room * tile + lengths[tile]):
            entry = entry_at(i, entries, cuts, many)
            for group in range(0, count, LANES):
                near = pixels_near(scratch, CULLED_NORMALS + group, count - group, cuts, i)
                for part in range(group, min(group + LANES, count), length):
                    of_run = (near >> (part - group)) & ((1 << length) - 1)
                    if of_run == 0:
                        continue
                    furthest = distance(scratch, 0, part, min(length, count - part))
                    run = Run(start, part, of_run, furthest, length == 1)
                    add_run(arrays, entry, run, many, scratch)
        write_sums(scratch, 0, 3 * count, radiance, 3 * start)
