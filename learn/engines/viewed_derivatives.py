"""Kernels of the derivatives of the sums of each tile's list, for a view per pixel.

Letters, arrays and `limit` as in learn.engines.viewed_sums, which has the sums.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.culled_sums import unpack
from learn.engines.distant import LN2, cosine, w_of
from learn.engines.exponentials import exp2, exp2m1
from learn.engines.layout import (
    CULLED_NORMALS,
    ENERGY_STRIDE,
    LANES,
    RUN_CHANNEL_STRIDE,
    RUN_GAMMA,
    RUN_GAMMA_SLOPE,
    RUN_KAPPA,
    RUN_KAPPA_SLOPE,
    RUN_LOBE_STRIDE,
    VALUES,
    VIEW_CENTRES,
    VIEW_CUTS,
    VIEW_LOBE_SUMS,
    VIEW_LOBES,
    VIEW_OFFSETS,
    VIEW_SCRATCH,
    VIEW_V_SUMS,
    VIEW_VIEWS,
)
from learn.engines.triples import Triple, add_to, add_vector, clear, combined, vector_at, write_sums
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
    maximum,
    splat,
)
from learn.engines.vector import select as choose
from learn.engines.view_runs import (
    add_material,
    distance,
    make_lobes,
    make_runs,
    of_pixel,
    shared,
    turn,
)
from learn.engines.viewed_entries import Arrays, Entry, Run, entry_at, pixels_near, unpack_views

BACKWARD = types.void(*[types.int64] * 11, *[FLOAT_POINTER] * 13, *[INT_POINTER] * 2)


class Gradients(NamedTuple):
    """Where the backward pass reads and adds: g, energy_sums and m_sums as of `backward`.

    energy_at, m_at  offsets of a chunk's part of energy_sums and of m_sums
    """

    g: np.ndarray
    energy_sums: np.ndarray
    m_sums: np.ndarray
    energy_at: int
    m_at: int


@inlined
def lobe_backward(
    scratch: np.ndarray,
    o: int,
    sums: int,
    delta: Lanes,
    log_c: Lanes,
    weight: Lanes,
    with_n: int,
) -> tuple[Lanes, Lanes, Lanes]:
    """F, dF/dc · c log2 e, and dF/dx / ln 2 of the spline's x, of one lobe and channel.

    The last two are 0 unless with_n. F's derivatives by γ ln² 2 and by κ, and by their slopes, ×
    weight, are added from scratch[sums] on.
    """
    gamma_slope, kappa_slope = (
        load(scratch, o + LANES * RUN_GAMMA_SLOPE),
        load(scratch, o + LANES * RUN_KAPPA_SLOPE),
    )
    gamma = fma(delta, gamma_slope, load(scratch, o + LANES * RUN_GAMMA))
    kappa = fma(delta, kappa_slope, load(scratch, o + LANES * RUN_KAPPA))
    power = exp2(gamma * log_c)
    exponent = kappa * power
    value = exp2m1(exponent)
    x = value + 1.0
    slope = x * exponent
    by_gamma, by_kappa = slope * log_c, x * power
    q = weight * by_gamma
    add_to(scratch, sums + LANES * RUN_GAMMA, q)
    add_to(scratch, sums + LANES * RUN_GAMMA_SLOPE, q * delta)
    q = weight * by_kappa
    add_to(scratch, sums + LANES * RUN_KAPPA, q)
    add_to(scratch, sums + LANES * RUN_KAPPA_SLOPE, q * delta)
    by_c, by_x = splat(0.0), splat(0.0)
    if with_n:
        by_c = slope * gamma
        by_x = fma(by_gamma * LN2, gamma_slope, by_kappa * kappa_slope)
    return value, by_c, by_x


@inlined
def reflectance_backward(
    arrays: Arrays,
    entry: Entry,
    gradients: Gradients,
    many: int,
    scratch: np.ndarray,
    base: int,
    p: int,
    n_w: Lanes,
    nearest: float,
    delta: Lanes,
    log_c: Lanes,
    with_n: int,
) -> Vector:
    """Derivatives of Σ_k g_k I_k of one pixel and block: by n·w, by c and by x; 0 unless with_n.

    That by c is × c log2 e, and that by x, the spline's, is / ln 2. Those by energy are added to
    the chunk's sums, those by the run's lobes to the sums in its scratch, which begins at `base`.

    p        place of the pixel in n and g
    n_w      max(0, n·w); nearest: the largest log2 c; delta: δ of the pixel
    """
    lobes, lobe_sums = base + VIEW_LOBES, base + VIEW_LOBE_SUMS
    by_w, by_c, by_x = splat(0.0), splat(0.0), splat(0.0)
    for k in range(3):
        energy_k = load(arrays.energy, entry.e + LANES * k)
        g_k = gradients.g[p + k]
        weight = n_w * g_k * energy_k
        f, d_c, d_x = splat(0.0), splat(0.0), splat(0.0)
        for s in range(many):
            if nearest > arrays.cuts[VIEW_CUTS * entry.place + s]:
                t = RUN_LOBE_STRIDE * s + RUN_CHANNEL_STRIDE * k
                lobe_f, lobe_c, lobe_x = lobe_backward(
                    scratch, lobes + t, lobe_sums + t, delta, log_c, weight, with_n
                )
                f, d_c, d_x = f + lobe_f, d_c + lobe_c, d_x + lobe_x
        to = gradients.energy_at + entry.e + LANES * k
        add_to(gradients.energy_sums, to, f * n_w * g_k)
        if with_n:
            by_w = fma(f * g_k, energy_k, by_w)
            by_c = fma(d_c, weight, by_c)
            by_x = fma(d_x, weight, by_x)
    return by_w, by_c, by_x


@inlined
def add_by_view(
    sums: np.ndarray,
    a: int,
    n: Triple,
    w: Vector,
    offset: Vector,
    inverse_s: Lanes,
    by_c: Lanes,
    by_x: Lanes,
) -> None:
    """Add the derivative by the view to the three rows from offset a on.

    offset      h − n; inverse_s: 1/‖s‖
    by_c, by_x  derivatives by c, and by w·d through x
    ∂c/∂v as in learn.engines.general.add_by_view; ∂x/∂v = −w δ/(w·d).
    """
    (x, y, z), (wx, wy, wz) = offset, w
    hx, hy, hz = x + n[0], y + n[1], z + n[2]
    by_c = by_c * inverse_s
    along = by_c * fma(x, hx, fma(y, hy, z * hz))
    value = (
        fma(along, hx, 0.0 - by_c * x) - by_x * wx,
        fma(along, hy, 0.0 - by_c * y) - by_x * wy,
        fma(along, hz, 0.0 - by_c * z) - by_x * wz,
    )
    add_vector(sums, a, value)


@inlined
def run_backward(
    arrays: Arrays,
    entry: Entry,
    run: Run,
    gradients: Gradients,
    many: int,
    scratch: np.ndarray,
    base: int,
    with_n: int,
    with_view: int,
) -> None:
    """Add the derivatives of Σ g·I by an entry's block and a run's pixels to the chunk's sums.

    base  where the chunk's scratch begins
    """
    geometry, o = arrays.geometry, entry.o
    same = shared(geometry, o, scratch, base + VIEW_CENTRES + run.first, run.furthest)
    near, made = run.near, False
    while near:
        j = run.first + lowest_bit(near)
        near &= near - 1
        p, d = 3 * (run.start + j), base + VIEW_OFFSETS + j
        normal = vector_at(arrays.n, p)
        n_w = cosine(geometry, o, normal)
        visible = n_w > 0.0
        if not anywhere(visible):
            continue
        offset, inverse_s, c, log_c = of_pixel(same, scratch, d, normal)
        nearest = lane_max(log_c)
        if not (nearest > entry.lowest):
            continue
        if not made:
            made = True
            values = arrays.values
            make_lobes(geometry, o, same, run.furthest, run.alone, many, values, scratch, base)
            clear(scratch, base + VIEW_LOBE_SUMS, RUN_LOBE_STRIDE // LANES * many)
        delta = turn(geometry, o, same, scratch, d)
        by_w, by_c, by_x = reflectance_backward(
            arrays, entry, gradients, many, scratch, base, p, maximum(n_w, 0.0), nearest, delta,
            log_c, with_n,
        )  # fmt: skip
        if not with_n:
            continue
        by_w = choose(visible, by_w, 0.0)
        by_c = by_c * LN2 / c
        w, a = w_of(geometry, o), base + ENERGY_STRIDE * j
        add_vector(scratch, a, combined(by_w, w, by_c, offset))
        if with_view:
            by_x = by_x * LN2 * same[4]
            add_by_view(scratch, a + VIEW_V_SUMS, normal, w, offset, inverse_s, by_c, by_x)
    if made:
        add_material(many, scratch, base, gradients.m_sums, gradients.m_at)


def backward(
    first: int,
    last: int,
    pixels: int,
    size: int,
    tiles: int,
    blocks: int,
    room: int,
    many: int,
    chunks: int,
    with_n: int,
    with_view: int,
    limit: np.ndarray,
    n: np.ndarray,
    v: np.ndarray,
    geometry: np.ndarray,
    energy: np.ndarray,
    values: np.ndarray,
    scratch: np.ndarray,
    g: np.ndarray,
    by_n: np.ndarray,
    by_v: np.ndarray,
    energy_sums: np.ndarray,
    m_sums: np.ndarray,
    cuts: np.ndarray,
    lengths: np.ndarray,
    entries: np.ndarray,
) -> None:
    """Derivatives of Σ g·I from the pixels of tile chunks first … last − 1.

    scratch      (chunks, VIEW_SCRATCH)
    with_n       0: neither by_n nor by_v is written
    with_view    0: by_v is not written; else with_n must not be 0
    by_n, by_v   (P, 3) out, tangential up to a radial part
    energy_sums  (chunks, blocks, 3, 16) out: Σ_p g F max(0, n·w)
    m_sums       (chunks, 108, 16) out, like values: derivatives by γ ln² 2 and by κ, in lanes
    """
    arrays = Arrays(n, geometry, energy, values, cuts)
    for chunk in range(first, last):
        base = VIEW_SCRATCH * chunk
        base_e, by_m = ENERGY_STRIDE * blocks * chunk, LANES * VALUES * chunk
        gradients = Gradients(g, energy_sums, m_sums, base_e, by_m)
        clear(energy_sums, base_e, 3 * blocks)
        clear(m_sums, by_m, VALUES)
        for tile in range(chunk * tiles // chunks, (chunk + 1) * tiles // chunks):
            start = tile * size
            count = min(size, pixels - start)
            clear(scratch, base, 3 * count)
            clear(scratch, base + VIEW_V_SUMS, 3 * count)
            unpack(n, start, count, scratch, base)
            unpack_views(v, start, count, scratch, base + VIEW_VIEWS)
            length = make_runs(v, start, count, limit[0], scratch, base)
            alone = length == 1 and not with_view
            for i in range(room * tile, room * tile + lengths[tile]):
                entry = entry_at(i, entries, cuts, many)
                for group in range(0, count, LANES):
                    normals = base + CULLED_NORMALS + group
                    near = pixels_near(scratch, normals, count - group, cuts, i)
                    for part in range(group, min(group + LANES, count), length):
                        of_run = (near >> (part - group)) & ((1 << length) - 1)
                        if of_run == 0:
                            continue
                        furthest = distance(scratch, base, part, min(length, count - part))
                        run = Run(start, part, of_run, furthest, alone)
                        run_backward(
                            arrays, entry, run, gradients, many, scratch, base, with_n, with_view
                        )
            write_sums(scratch, base, 3 * count * with_n, by_n, 3 * start)
            write_sums(scratch, base + VIEW_V_SUMS, 3 * count * with_view, by_v, 3 * start)
