"""Kernels for a view vector per pixel: h, θ_d and the spline values belong to each pixel and light.

P pixels, blocks of 16 lights (LANES); all arrays float32, flat, C order.
n, v      (P, 3) unit normals, and unit vectors to the viewer, camera frame
geometry  (blocks, 6, 16): w (3 rows), and what rounding took off w (3 rows)
energy    (blocks, 3, 16): radiance × solid angle, E_k
m         (3 lobes, 3 channels, 2, 6): control values of γ and of κ log2 e
least     (3 lobes,): smallest γ, to bound a whole block
cut       (blocks,): a lobe with log2 c^γ below it everywhere in a block is left out
          (learn.engines.lights)

    s = w + v, t = w − v, h = s/‖s‖, θ_d = arctan(‖t‖/‖s‖), c = n·h = 1 − ½‖h − n‖²;   the sum as in
    learn.engines.distant
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import LN2, first_block, is_seen, w_of
from learn.engines.exponentials import angle, exp2, exp2m1
from learn.engines.halfway import LEAST_SQUARE, HalfVectors, half_vectors, view_at
from learn.engines.layout import (
    CHANNEL_VALUES,
    CONTROL_VALUES,
    ENERGY_STRIDE,
    GENERAL_SCRATCH,
    GENERAL_STRIDE,
    GENERAL_TILE,
    KAPPA_VALUES,
    LANES,
    LOBE_VALUES,
    STEPS_OF_CURVE,
    VALUES,
)
from learn.engines.splines import ANGLE_TO_X, Basis, Tents, add_curve, basis, curve, slope, tents
from learn.engines.triples import (
    Triple,
    add_to,
    add_vector,
    clear,
    combined,
    difference,
    dot,
    vector_at,
    write_sums,
)
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    Vector,
    anywhere,
    fma,
    lane_max,
    lane_sum,
    load,
    maximum,
    select,
    splat,
    sqrt,
)

FORWARD = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 8)
BACKWARD = types.void(*[types.int64] * 5, *[FLOAT_POINTER] * 14)


class Material(NamedTuple):
    """A material's arrays: m and least as above, steps as of `backward`."""

    m: np.ndarray
    steps: np.ndarray
    least: np.ndarray


class Spline(NamedTuple):
    """The functions of the material's spline at the θ_d of sixteen lights (learn.engines.splines).

    basis, tents  its own, and the linear ones of its slope
    """

    basis: Basis
    tents: Tents


@inlined
def lobe(m: np.ndarray, o: int, log_c: Lanes, b: Basis) -> Lanes:
    """expm1(κ c^γ) of the lobe and channel at offset o."""
    return exp2m1(curve(m, o + KAPPA_VALUES, b) * exp2(curve(m, o, b) * log_c))


@inlined
def reflectance(
    m: np.ndarray, least: np.ndarray, cut: float, nearest: float, log_c: Lanes, b: Basis
) -> Vector:
    """F (3 channels) of sixteen lights: the sum over the lobes that are not cut.

    nearest  the largest log2 c
    """
    f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
    for s in range(3):
        if nearest * least[s] > cut:
            f0 = f0 + lobe(m, LOBE_VALUES * s, log_c, b)
            f1 = f1 + lobe(m, LOBE_VALUES * s + CHANNEL_VALUES, log_c, b)
            f2 = f2 + lobe(m, LOBE_VALUES * s + 2 * CHANNEL_VALUES, log_c, b)
    return f0, f1, f2


def forward(
    first: int,
    last: int,
    pixels: int,
    blocks: int,
    n: np.ndarray,
    v: np.ndarray,
    geometry: np.ndarray,
    energy: np.ndarray,
    m: np.ndarray,
    least: np.ndarray,
    cut: np.ndarray,
    radiance: np.ndarray,
) -> None:
    """Radiance (P, 3) of pixel tiles first … last − 1."""
    for p in range(first * GENERAL_TILE, min(last * GENERAL_TILE, pixels)):
        normal = splat(n[3 * p]), splat(n[3 * p + 1]), splat(n[3 * p + 2])
        view, v_short = view_at(v, 3 * p)
        i0, i1, i2 = splat(0.0), splat(0.0), splat(0.0)
        for block in range(blocks):
            o, e = GENERAL_STRIDE * block, ENERGY_STRIDE * block
            w = w_of(geometry, o)
            n_w = dot(w, normal)
            if not anywhere(n_w > 0.0):
                continue
            half = half_vectors(geometry, o, normal, view, v_short)
            nearest = lane_max(half.log_c)
            if not is_seen(nearest, least, 0, cut[block]):
                continue
            t = difference(w, view)
            b = basis(angle(dot(t, t), half.s_square))
            f0, f1, f2 = reflectance(m, least, cut[block], nearest, half.log_c, b)
            n_w = maximum(n_w, 0.0)
            i0 = fma(f0 * n_w, load(energy, e), i0)
            i1 = fma(f1 * n_w, load(energy, e + LANES), i1)
            i2 = fma(f2 * n_w, load(energy, e + 2 * LANES), i2)
        radiance[3 * p], radiance[3 * p + 1], radiance[3 * p + 2] = (
            lane_sum(i0),
            lane_sum(i1),
            lane_sum(i2),
        )


@inlined
def lobe_backward(
    material: Material,
    o: int,
    log_c: Lanes,
    spline: Spline,
    weight: Lanes,
    m_sums: np.ndarray,
    at: int,
    with_view: int,
) -> Vector:
    """F, dF/dc · c log2 e, and dF/dx of the spline's x, of one lobe and channel.

    o  offset of its values in m
    Its derivatives by m, × weight, are added from m_sums[at] on. dF/dx is 0 unless with_view.
    """
    m, steps, _ = material
    b, tent = spline
    gamma, kappa = curve(m, o, b), curve(m, o + KAPPA_VALUES, b)
    power = exp2(gamma * log_c)
    exponent = kappa * power
    value = exp2m1(exponent)
    x = value + 1.0
    by_kappa = x * power
    by_gamma = x * exponent * log_c
    add_curve(m_sums, at + LANES * o, weight * by_gamma, b)
    add_curve(m_sums, at + LANES * (o + KAPPA_VALUES), weight * by_kappa, b)
    by_x = splat(0.0)
    if with_view:
        i = o // CONTROL_VALUES * STEPS_OF_CURVE
        by_kappa_slope = by_kappa * slope(steps, i + STEPS_OF_CURVE, tent)
        by_x = fma(by_gamma, slope(steps, i, tent), by_kappa_slope)
    return value, x * exponent * gamma, by_x


@inlined
def channel_backward(
    material: Material,
    k: int,
    cut: float,
    nearest: float,
    log_c: Lanes,
    spline: Spline,
    weight: Lanes,
    m_sums: np.ndarray,
    at: int,
    with_view: int,
) -> Vector:
    """`lobe_backward` of channel k, summed over the lobes that are not cut.

    nearest  the largest log2 c; weight: g_k E_k max(0, n·w)
    """
    f, by_c, by_x = splat(0.0), splat(0.0), splat(0.0)
    for s in range(3):
        if nearest * material.least[s] > cut:
            o = LOBE_VALUES * s + CHANNEL_VALUES * k
            lobe_f, lobe_c, lobe_x = lobe_backward(
                material, o, log_c, spline, weight, m_sums, at, with_view
            )
            f, by_c, by_x = f + lobe_f, by_c + lobe_c, by_x + lobe_x
    return f, by_c, by_x


@inlined
def block_backward(
    material: Material,
    cut: float,
    nearest: float,
    log_c: Lanes,
    spline: Spline,
    energy: np.ndarray,
    e: int,
    n_w: Lanes,
    g: np.ndarray,
    p: int,
    energy_sums: np.ndarray,
    m_sums: np.ndarray,
    at: int,
    with_view: int,
) -> Vector:
    """Derivatives of Σ_k g_k I_k of one pixel and block: by μ = max(0, n·w), by c and by x.

    That by c is × c log2 e; x is the spline's. Those by energy and by m are added to energy_sums,
    and from m_sums[at] on.

    e    offset of the block's energy
    n_w  μ; g: (P, 3) the derivative by radiance, of which the pixel's begins at place p
    """
    by_w, by_c, by_x = splat(0.0), splat(0.0), splat(0.0)
    for k in range(3):
        energy_k = load(energy, e + LANES * k)
        weight = n_w * g[p + k] * energy_k
        f, d_c, d_x = channel_backward(
            material, k, cut, nearest, log_c, spline, weight, m_sums, at, with_view
        )
        add_to(energy_sums, e + LANES * k, f * n_w * g[p + k])
        by_w = fma(f * g[p + k], energy_k, by_w)
        by_c = fma(d_c, weight, by_c)
        by_x = fma(d_x, weight, by_x)
    return by_w, by_c, by_x


@inlined
def by_s_and_t(
    by_x: Lanes, s_square: Lanes, t_square: Lanes, inverse_s: Lanes
) -> tuple[Lanes, Lanes]:
    """The factors (p, q) of −(p s + q t), the derivative by the view through θ_d.

    by_x  the derivative by the spline's x
    ∂θ_d/∂v = −(‖s‖² t + ‖t‖² s)/(4 ‖s‖ ‖t‖): tangential in itself, so that nothing cancels at
    either end.
    """
    by_theta = by_x * (0.25 * ANGLE_TO_X) * inverse_s / sqrt(maximum(t_square, LEAST_SQUARE))
    return by_theta * t_square, by_theta * s_square


@inlined
def add_by_view(
    sums: np.ndarray,
    a: int,
    n: Triple,
    half: HalfVectors,
    t: Vector,
    t_square: Lanes,
    by_c: Lanes,
    by_x: Lanes,
) -> None:
    """Add the derivative by the view to a pixel's sums, whose rows begin at offset a.

    t            w − v, and t_square its ‖t‖²
    by_c, by_x   derivatives by c and by the spline's x
    ∂c/∂v = (n − c h)/‖s‖, and n − c h is what of n − h stands across h.
    """
    (x, y, z), (sx, sy, sz), (tx, ty, tz) = half.offset, half.s, t
    hx, hy, hz = x + n[0], y + n[1], z + n[2]
    by_c = by_c * half.inverse_s
    along = by_c * fma(x, hx, fma(y, hy, z * hz))
    by_s, by_t = by_s_and_t(by_x, half.s_square, t_square, half.inverse_s)
    add_to(sums, a, fma(along, hx, 0.0 - by_c * x) - by_t * tx - by_s * sx)
    add_to(sums, a + LANES, fma(along, hy, 0.0 - by_c * y) - by_t * ty - by_s * sy)
    add_to(sums, a + 2 * LANES, fma(along, hz, 0.0 - by_c * z) - by_t * tz - by_s * sz)


def backward(
    first: int,
    last: int,
    pixels: int,
    blocks: int,
    with_view: int,
    n: np.ndarray,
    v: np.ndarray,
    geometry: np.ndarray,
    energy: np.ndarray,
    m: np.ndarray,
    steps: np.ndarray,
    least: np.ndarray,
    cut: np.ndarray,
    scratch: np.ndarray,
    g: np.ndarray,
    n_part: np.ndarray,
    v_part: np.ndarray,
    energy_sums: np.ndarray,
    m_sums: np.ndarray,
) -> None:
    """Derivatives of Σ g·I that belong to light chunks first … last − 1.

    with_view    0: v_part is not written
    steps        (3 lobes, 3 channels, 2, 5): slopes of the splines of γ ln² 2 and of κ
                 (learn.engines.lights.spline_steps)
    scratch      (LIGHT_CHUNKS, GENERAL_SCRATCH): room for a tile's sums
    g            (P, 3) derivative by radiance
    n_part       (LIGHT_CHUNKS, P, 3) out: each chunk's share of the derivative by n, tangential
    v_part       (LIGHT_CHUNKS, P, 3) out: the same by v
    energy_sums  (blocks, 3, 16) out: Σ_p g F max(0, n·w), the derivative by energy
    m_sums       (LIGHT_CHUNKS, tiles, 108) out, like m: derivatives by γ ln² 2 and by κ
    Chunks as in learn.engines.distant.
    """
    tiles = (pixels + GENERAL_TILE - 1) // GENERAL_TILE
    material = Material(m, steps, least)
    for chunk in range(first, last):
        block_first, block_last = first_block(chunk, blocks), first_block(chunk + 1, blocks)
        clear(energy_sums, ENERGY_STRIDE * block_first, 3 * (block_last - block_first))
        n_sums = GENERAL_SCRATCH * chunk
        v_sums = n_sums + ENERGY_STRIDE * GENERAL_TILE
        by_m = v_sums + ENERGY_STRIDE * GENERAL_TILE
        for tile in range(tiles):
            start = tile * GENERAL_TILE
            count = min(GENERAL_TILE, pixels - start)
            clear(scratch, n_sums, GENERAL_SCRATCH // LANES)
            for block in range(block_first, block_last):
                o, e = GENERAL_STRIDE * block, ENERGY_STRIDE * block
                w = w_of(geometry, o)
                for j in range(count):
                    p = 3 * (start + j)
                    normal = vector_at(n, p)
                    n_w = dot(w, normal)
                    visible = n_w > 0.0
                    if not anywhere(visible):
                        continue
                    view, v_short = view_at(v, p)
                    half = half_vectors(geometry, o, normal, view, v_short)
                    nearest = lane_max(half.log_c)
                    if not is_seen(nearest, least, 0, cut[block]):
                        continue
                    t = difference(w, view)
                    t_square = dot(t, t)
                    theta_d = angle(t_square, half.s_square)
                    by_w, by_c, by_x = block_backward(
                        material, cut[block], nearest, half.log_c,
                        Spline(basis(theta_d), tents(theta_d)), energy, e, maximum(n_w, 0.0),
                        g, p, energy_sums, scratch, by_m, with_view,
                    )  # fmt: skip
                    by_w = select(visible, by_w, 0.0)
                    by_c = by_c * LN2 / half.c
                    add_vector(
                        scratch, n_sums + ENERGY_STRIDE * j, combined(by_w, w, by_c, half.offset)
                    )
                    if with_view:
                        at = v_sums + ENERGY_STRIDE * j
                        add_by_view(scratch, at, normal, half, t, t_square, by_c, by_x)
            write_sums(scratch, n_sums, 3 * count, n_part, 3 * (chunk * pixels + start))
            if with_view:
                write_sums(scratch, v_sums, 3 * count, v_part, 3 * (chunk * pixels + start))
            write_sums(scratch, by_m, VALUES, m_sums, VALUES * (chunk * tiles + tile))
