"""Kernels that sum the lights of each tile's list for a view per pixel, forward and backward.

Letters, arrays and formulas as in learn.engines.viewed_lists, which makes the lists, and in
learn.engines.view_runs: pixels of similar view share h̄ and the spline values. Besides:
limit    (1,) the longest difference of a view from that of its run
"""

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.culled_sums import unpack
from learn.engines.distant import LN2, add_to, clear, cosine, w_of, write_sums
from learn.engines.exponentials import exp2, exp2m1
from learn.engines.general import square
from learn.engines.layout import (
    CULLED_NORMALS,
    CULLED_TILE,
    CUT_AXIS,
    CUT_REACH,
    ENERGY_STRIDE,
    GENERAL_STRIDE,
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
from learn.engines.vector import (
    FLOAT_POINTER,
    INT_POINTER,
    Lanes,
    anywhere,
    bits,
    fma,
    lane_max,
    load,
    lowest_bit,
    maximum,
    splat,
    sqrt,
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

FORWARD = types.void(*[types.int64] * 6, *[FLOAT_POINTER] * 9, *[INT_POINTER] * 2)
BACKWARD = types.void(*[types.int64] * 11, *[FLOAT_POINTER] * 13, *[INT_POINTER] * 2)


@inlined
def pixels_near(scratch: np.ndarray, o: int, count: int, cuts: np.ndarray, entry: int) -> int:
    """Which of sixteen pixels (at most `count`) an entry's block can matter to, as bits.

    o  offset of their normals; their views are VIEW_VIEWS − CULLED_NORMALS behind
    """
    x, y, z = load(scratch, o), load(scratch, o + CULLED_TILE), load(scratch, o + 2 * CULLED_TILE)
    a, v = VIEW_CUTS * entry + CUT_AXIS, o + VIEW_VIEWS - CULLED_NORMALS
    sx = cuts[a] + load(scratch, v)
    sy = cuts[a + 1] + load(scratch, v + CULLED_TILE)
    sz = cuts[a + 2] + load(scratch, v + 2 * CULLED_TILE)
    along = fma(x, sx, fma(y, sy, z * sz))
    near = along > sqrt(square(sx, sy, sz)) * cuts[VIEW_CUTS * entry + CUT_REACH]
    return bits(near) & ((1 << min(LANES, count)) - 1)


@inlined
def unpack_views(v: np.ndarray, start: int, count: int, scratch: np.ndarray, o: int) -> None:
    """Write a tile's views as three rows at offset o."""
    for j in range(CULLED_TILE):
        for i in range(3):
            scratch[o + CULLED_TILE * i + j] = (
                v[3 * (start + j) + i] if j < count else types.float32(0.0)
            )


@inlined
def lobe(scratch: np.ndarray, o: int, delta: Lanes, log_c: Lanes) -> Lanes:
    """expm1(κ c^γ) of the lobe and channel at offset o."""
    gamma = fma(delta, load(scratch, o + LANES * RUN_GAMMA_SLOPE), load(scratch, o))
    kappa = fma(
        delta, load(scratch, o + LANES * RUN_KAPPA_SLOPE), load(scratch, o + LANES * RUN_KAPPA)
    )
    return exp2m1(kappa * exp2(gamma * log_c))


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
def lowest_cut(cuts: np.ndarray, entry: int, many: int) -> float:
    """The log2 c above which some lobe of a list's entry counts."""
    lowest = cuts[VIEW_CUTS * entry]
    for s in range(1, many):
        lowest = min(lowest, cuts[VIEW_CUTS * entry + s])
    return lowest


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
    for tile in range(first, last):
        start = tile * size
        count = min(size, pixels - start)
        clear(scratch, 0, 3 * count)
        unpack(n, start, count, scratch, 0)
        unpack_views(v, start, count, scratch, VIEW_VIEWS)
        run = make_runs(v, start, count, limit[0], scratch, 0)
        for i in range(room * tile, room * tile + lengths[tile]):
            o, e = GENERAL_STRIDE * entries[i], ENERGY_STRIDE * entries[i]
            lowest = lowest_cut(cuts, i, many)
            for group in range(0, count, LANES):
                normals = CULLED_NORMALS + group
                near = pixels_near(scratch, normals, count - group, cuts, i)
                for part in range(group, min(group + LANES, count), run):
                    of_run = (near >> (part - group)) & ((1 << run) - 1)
                    if of_run == 0:
                        continue
                    furthest, made = distance(scratch, 0, part, min(run, count - part)), False
                    same = shared(geometry, o, scratch, VIEW_CENTRES + part, furthest)
                    while of_run:
                        j = part + lowest_bit(of_run)
                        of_run &= of_run - 1
                        p = 3 * (start + j)
                        nx, ny, nz = n[p], n[p + 1], n[p + 2]
                        n_w = cosine(geometry, o, nx, ny, nz)
                        if not anywhere(n_w > 0.0):
                            continue
                        log_c = of_pixel(same, scratch, VIEW_OFFSETS + j, nx, ny, nz)[3]
                        nearest = lane_max(log_c)
                        if not (nearest > lowest):
                            continue
                        if not made:
                            made = True
                            make_lobes(
                                geometry, o, same, furthest, run == 1, many, values, scratch, 0
                            )
                        delta = turn(geometry, o, same, scratch, VIEW_OFFSETS + j)
                        f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
                        for s in range(many):
                            if nearest > cuts[VIEW_CUTS * i + s]:
                                t = VIEW_LOBES + RUN_LOBE_STRIDE * s
                                f0 = f0 + lobe(scratch, t, delta, log_c)
                                f1 = f1 + lobe(scratch, t + RUN_CHANNEL_STRIDE, delta, log_c)
                                f2 = f2 + lobe(scratch, t + 2 * RUN_CHANNEL_STRIDE, delta, log_c)
                        n_w = maximum(n_w, 0.0)
                        a = ENERGY_STRIDE * j
                        add_to(scratch, a, f0 * n_w * load(energy, e))
                        add_to(scratch, a + LANES, f1 * n_w * load(energy, e + LANES))
                        add_to(scratch, a + 2 * LANES, f2 * n_w * load(energy, e + 2 * LANES))
        write_sums(scratch, 0, 3 * count, radiance, 3 * start)


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
    for chunk in range(first, last):
        base_e, by_m, base = (
            ENERGY_STRIDE * blocks * chunk,
            LANES * VALUES * chunk,
            VIEW_SCRATCH * chunk,
        )
        lobes, lobe_sums = base + VIEW_LOBES, base + VIEW_LOBE_SUMS
        clear(energy_sums, base_e, 3 * blocks)
        clear(m_sums, by_m, VALUES)
        for tile in range(chunk * tiles // chunks, (chunk + 1) * tiles // chunks):
            start = tile * size
            count = min(size, pixels - start)
            clear(scratch, base, 3 * count)
            clear(scratch, base + VIEW_V_SUMS, 3 * count)
            unpack(n, start, count, scratch, base)
            unpack_views(v, start, count, scratch, base + VIEW_VIEWS)
            run = make_runs(v, start, count, limit[0], scratch, base)
            for i in range(room * tile, room * tile + lengths[tile]):
                o, e = GENERAL_STRIDE * entries[i], ENERGY_STRIDE * entries[i]
                lowest = lowest_cut(cuts, i, many)
                for group in range(0, count, LANES):
                    normals = base + CULLED_NORMALS + group
                    near = pixels_near(scratch, normals, count - group, cuts, i)
                    for part in range(group, min(group + LANES, count), run):
                        of_run = (near >> (part - group)) & ((1 << run) - 1)
                        if of_run == 0:
                            continue
                        furthest = distance(scratch, base, part, min(run, count - part))
                        same = shared(geometry, o, scratch, base + VIEW_CENTRES + part, furthest)
                        made = False
                        while of_run:
                            j = part + lowest_bit(of_run)
                            of_run &= of_run - 1
                            p, d = 3 * (start + j), base + VIEW_OFFSETS + j
                            nx, ny, nz = n[p], n[p + 1], n[p + 2]
                            n_w = cosine(geometry, o, nx, ny, nz)
                            visible = n_w > 0.0
                            if not anywhere(visible):
                                continue
                            (x, y, z), scale, c, log_c = of_pixel(same, scratch, d, nx, ny, nz)
                            nearest = lane_max(log_c)
                            if not (nearest > lowest):
                                continue
                            if not made:
                                made = True
                                make_lobes(
                                    geometry,
                                    o,
                                    same,
                                    furthest,
                                    run == 1 and not with_view,
                                    many,
                                    values,
                                    scratch,
                                    base,
                                )
                                clear(scratch, lobe_sums, RUN_LOBE_STRIDE // LANES * many)
                            delta = turn(geometry, o, same, scratch, d)
                            n_w = maximum(n_w, 0.0)
                            by_w, by_c, by_x = splat(0.0), splat(0.0), splat(0.0)
                            for k in range(3):
                                energy_k = load(energy, e + LANES * k)
                                weight = n_w * g[p + k] * energy_k
                                f, d_c, d_x = splat(0.0), splat(0.0), splat(0.0)
                                for s in range(many):
                                    if nearest > cuts[VIEW_CUTS * i + s]:
                                        t = RUN_LOBE_STRIDE * s + RUN_CHANNEL_STRIDE * k
                                        value, by_log, by_turn = lobe_backward(
                                            scratch, lobes + t, lobe_sums + t, delta, log_c,
                                            weight, with_n,
                                        )  # fmt: skip
                                        f, d_c, d_x = f + value, d_c + by_log, d_x + by_turn
                                add_to(energy_sums, base_e + e + LANES * k, f * n_w * g[p + k])
                                if with_n:
                                    by_w = fma(f * g[p + k], energy_k, by_w)
                                    by_c = fma(d_c, weight, by_c)
                                    by_x = fma(d_x, weight, by_x)
                            if not with_n:
                                continue
                            by_w = choose(visible, by_w, 0.0)
                            by_c = by_c * LN2 / c
                            wx, wy, wz = w_of(geometry, o)
                            a = base + ENERGY_STRIDE * j
                            add_to(scratch, a, fma(by_w, wx, by_c * x))
                            add_to(scratch, a + LANES, fma(by_w, wy, by_c * y))
                            add_to(scratch, a + 2 * LANES, fma(by_w, wz, by_c * z))
                            if with_view:
                                # ∂c/∂v as in learn.engines.general.add_by_view; ∂x/∂v = −w δ/(w·d)
                                hx, hy, hz = x + nx, y + ny, z + nz
                                by_c = by_c * scale
                                along = by_c * fma(x, hx, fma(y, hy, z * hz))
                                by_x = by_x * LN2 * same[4]
                                a += VIEW_V_SUMS
                                add_to(scratch, a, fma(along, hx, 0.0 - by_c * x) - by_x * wx)
                                add_to(
                                    scratch, a + LANES, fma(along, hy, 0.0 - by_c * y) - by_x * wy
                                )
                                add_to(
                                    scratch,
                                    a + 2 * LANES,
                                    fma(along, hz, 0.0 - by_c * z) - by_x * wz,
                                )
                        if made:
                            add_material(many, scratch, base, m_sums, by_m)
            write_sums(scratch, base, 3 * count * with_n, by_n, 3 * start)
            write_sums(scratch, base + VIEW_V_SUMS, 3 * count * with_view, by_v, 3 * start)
