"""Kernel for second derivatives of the sum for a view vector per pixel.

It is the backward pass of learn.engines.general.backward, whose loops it repeats on purpose: each
is unrolled around values in registers.

Letters, arrays and the sum as in learn.engines.general, S and its parts as in
learn.engines.distant_second; besides n_along, v_along  (P, 3): n', v', tangential up to rounding
m                 (3 lobes, 3 channels, 2, 6): control values of γ and of κ log2 e
m_along           the same of γ' and of κ'
steps             (3 lobes, 3 channels, 2, 5): slopes of the splines of γ and of κ
                  (learn.engines.lights.spline_steps)
steps_along       the same of γ' and of κ'

    c' = (h − n)·n' + h'·n    h' = (v' − h (h·v'))/‖s‖    θ' = −¼ (‖s‖ d + ‖t‖ h)·v'    d = t/‖t‖
    κ' = Σ_b B_b m'_b + θ' Σ_b B_b' κ_b, and so γ'

The derivatives by n and by θ_d, θ' and c' of v are written out in `second`. θ_d has a corner where
w = v: ‖t‖ is held above √LEAST_SQUARE, and so is the second derivative below the bound that it
lacks.
"""

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import LN2, add_to, clear, peak_cosine, w_of, write_sums
from learn.engines.distant_second import lobe_second
from learn.engines.exponentials import angle
from learn.engines.general import LEAST_SQUARE, offset, shortfall, square, w_plus_v
from learn.engines.layout import (
    CHANNEL_VALUES,
    CONTROL_VALUES,
    ENERGY_STRIDE,
    GENERAL_SECOND_ROWS,
    GENERAL_SECOND_SCRATCH,
    GENERAL_STRIDE,
    GENERAL_TILE,
    KAPPA_VALUES,
    LANES,
    LIGHT_CHUNKS,
    LOBE_VALUES,
    STEPS,
    STEPS_OF_CURVE,
    VALUES,
)
from learn.engines.splines import ANGLE_TO_X, Tents, add_curve, basis, curve, slope, tents
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    anywhere,
    fma,
    lane_max,
    load,
    maximum,
    select,
    splat,
    sqrt,
    store,
)

SECOND = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 21)


@inlined
def bends(theta_d: Lanes) -> Tents:
    """The derivatives of `tents` by x: 1 on the interval before a knot, −1 on the one after."""
    x = theta_d * ANGLE_TO_X
    one, none = splat(1.0), splat(0.0)
    i0 = select(x < 1.0, one, none)
    i1 = select(x < 2.0, one, none) - i0
    i2 = select(x < 3.0, one, none) - i0 - i1
    i3 = one - i0 - i1 - i2
    return none - i0, i0 - i1, i1 - i2, i2 - i3, i3


@inlined
def add_slope(sums: np.ndarray, o: int, q: Lanes, t: Tents) -> None:
    """sums rows o/16 … + 4 (16 lanes each) += q t_j: a slope's derivative by its steps."""
    store(sums, o, fma(q, t[0], load(sums, o)))
    store(sums, o + LANES, fma(q, t[1], load(sums, o + LANES)))
    store(sums, o + 2 * LANES, fma(q, t[2], load(sums, o + 2 * LANES)))
    store(sums, o + 3 * LANES, fma(q, t[3], load(sums, o + 3 * LANES)))
    store(sums, o + 4 * LANES, fma(q, t[4], load(sums, o + 4 * LANES)))


@inlined
def dot(ax: Lanes, ay: Lanes, az: Lanes, bx: Lanes, by: Lanes, bz: Lanes) -> Lanes:
    """The scalar product."""
    return fma(ax, bx, fma(ay, by, az * bz))


def second(
    first: int,
    last: int,
    pixels: int,
    blocks: int,
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
    n_along: np.ndarray,
    v_along: np.ndarray,
    e_along: np.ndarray,
    m_along: np.ndarray,
    steps_along: np.ndarray,
    n_part: np.ndarray,
    v_part: np.ndarray,
    g_part: np.ndarray,
    energy_sums: np.ndarray,
    m_sums: np.ndarray,
    steps_sums: np.ndarray,
) -> None:
    """Derivatives of S from light chunks first … last − 1, as learn.engines.general.backward.

    scratch                 (LIGHT_CHUNKS, GENERAL_SECOND_SCRATCH): room for a tile's sums
    n_part, v_part, g_part  (LIGHT_CHUNKS, P, 3) out: each chunk's share of the derivatives by n, v
                            (tangential) and g
    energy_sums             (blocks, 3, 16) out: the derivative by energy
    m_sums, steps_sums      (LIGHT_CHUNKS, tiles, 108), (…, 90) out, like m and steps: each tile's
                            and chunk's derivatives by γ and κ through their values, and through
                            their slopes by θ'
    """
    tiles = (pixels + GENERAL_TILE - 1) // GENERAL_TILE
    for chunk in range(first, last):
        block_first, block_last = (
            chunk * blocks // LIGHT_CHUNKS,
            (chunk + 1) * blocks // LIGHT_CHUNKS,
        )
        clear(energy_sums, ENERGY_STRIDE * block_first, 3 * (block_last - block_first))
        sums = GENERAL_SECOND_SCRATCH * chunk
        by_m = sums + LANES * GENERAL_SECOND_ROWS * GENERAL_TILE
        by_steps = by_m + LANES * VALUES
        for tile in range(tiles):
            start = tile * GENERAL_TILE
            count = min(GENERAL_TILE, pixels - start)
            clear(scratch, sums, GENERAL_SECOND_SCRATCH // LANES)
            for block in range(block_first, block_last):
                o, i = GENERAL_STRIDE * block, ENERGY_STRIDE * block
                wx, wy, wz = w_of(geometry, o)
                for j in range(count):
                    p = 3 * (start + j)
                    nx, ny, nz = n[p], n[p + 1], n[p + 2]
                    n_w = fma(wx, nx, fma(wy, ny, wz * nz))
                    visible = n_w > 0.0
                    if not anywhere(visible):
                        continue
                    vx, vy, vz = splat(v[p]), splat(v[p + 1]), splat(v[p + 2])
                    v_short = shortfall(v[p], v[p + 1], v[p + 2])
                    sx, sy, sz, rx, ry, rz = w_plus_v(geometry, o, vx, vy, vz, v_short)
                    s_square = maximum(square(sx + rx, sy + ry, sz + rz), LEAST_SQUARE)
                    inverse_s = 1.0 / sqrt(s_square)
                    x, y, z = (
                        offset(sx, rx, nx, inverse_s),
                        offset(sy, ry, ny, inverse_s),
                        offset(sz, rz, nz, inverse_s),
                    )
                    c, log2_c = peak_cosine(x, y, z)
                    nearest = lane_max(log2_c)
                    if not (nearest * min(least[0], least[1], least[2]) > cut[block]):
                        continue
                    tx, ty, tz = wx - vx, wy - vy, wz - vz
                    t_square = square(tx, ty, tz)
                    theta_d = angle(t_square, s_square)
                    b, tent, bend = basis(theta_d), tents(theta_d), bends(theta_d)
                    inverse_t = 1.0 / sqrt(maximum(t_square, LEAST_SQUARE))
                    length_s, length_t = s_square * inverse_s, t_square * inverse_t
                    hx, hy, hz = x + nx, y + ny, z + nz
                    dx, dy, dz = tx * inverse_t, ty * inverse_t, tz * inverse_t
                    # changes along (n', v')
                    ax, ay, az = n_along[p], n_along[p + 1], n_along[p + 2]
                    qx, qy, qz = v_along[p], v_along[p + 1], v_along[p + 2]
                    h_q, d_q = dot(hx, hy, hz, qx, qy, qz), dot(dx, dy, dz, qx, qy, qz)
                    # x' of the spline's x
                    turned = -0.25 * ANGLE_TO_X * fma(length_s, d_q, length_t * h_q)
                    # across h: n, v' and n'; (h − n)·h is ½‖h − n‖², which keeps its digits
                    x_h = dot(x, y, z, hx, hy, hz)
                    ux, uy, uz = fma(x_h, hx, 0.0 - x), fma(x_h, hy, 0.0 - y), fma(x_h, hz, 0.0 - z)
                    across_x, across_y, across_z = qx - h_q * hx, qy - h_q * hy, qz - h_q * hz
                    n_q = dot(ux, uy, uz, qx, qy, qz)
                    n_w = maximum(n_w, 0.0)
                    w_along = select(visible, dot(wx, wy, wz, ax, ay, az), 0.0)
                    by_c, log_c = 1.0 / c, log2_c * LN2
                    r = select(visible, fma(n_q, inverse_s, dot(x, y, z, ax, ay, az)) * by_c, 0.0)
                    by_w, by_log_c, by_r, by_x, by_turned = (
                        splat(0.0),
                        splat(0.0),
                        splat(0.0),
                        splat(0.0),
                        splat(0.0),
                    )
                    at = sums + LANES * GENERAL_SECOND_ROWS * j
                    for k in range(3):
                        e, e_change, weight = (
                            load(energy, i + LANES * k),
                            load(e_along, i + LANES * k),
                            n_w * g[p + k],
                        )
                        u, s_weight = weight * e, fma(w_along * g[p + k], e, weight * e_change)
                        f, change = splat(0.0), splat(0.0)
                        for s in range(3):
                            if nearest * least[s] > cut[block]:
                                to = LOBE_VALUES * s + CHANNEL_VALUES * k
                                st = to // CONTROL_VALUES * STEPS_OF_CURVE
                                slope_gamma, slope_kappa = (
                                    slope(steps, st, tent),
                                    slope(steps, st + STEPS_OF_CURVE, tent),
                                )
                                gamma_along = fma(turned, slope_gamma, curve(m_along, to, b))
                                kappa_along = fma(
                                    turned, slope_kappa, curve(m_along, to + KAPPA_VALUES, b)
                                )
                                (
                                    value,
                                    moved,
                                    by_kappa,
                                    by_gamma,
                                    lobe_log_c,
                                    lobe_r,
                                    along_kappa,
                                    along_gamma,
                                ) = lobe_second(
                                    curve(m, to, b),
                                    curve(m, to + KAPPA_VALUES, b),
                                    gamma_along,
                                    kappa_along,
                                    log2_c,
                                    log_c,
                                    r,
                                    u,
                                    s_weight,
                                )
                                f, change = f + value, change + moved
                                by_log_c, by_r = by_log_c + lobe_log_c, by_r + lobe_r
                                add_curve(scratch, by_m + LANES * to, by_gamma, b)
                                add_curve(scratch, by_m + LANES * (to + KAPPA_VALUES), by_kappa, b)
                                add_slope(
                                    scratch, by_steps + LANES * st, along_gamma * turned, tent
                                )
                                add_slope(
                                    scratch,
                                    by_steps + LANES * (st + STEPS_OF_CURVE),
                                    along_kappa * turned,
                                    tent,
                                )
                                by_turned = by_turned + fma(
                                    along_gamma, slope_gamma, along_kappa * slope_kappa
                                )
                                bent_gamma = fma(
                                    turned, slope(steps, st, bend), slope(steps_along, st, tent)
                                )
                                bent_kappa = fma(
                                    turned,
                                    slope(steps, st + STEPS_OF_CURVE, bend),
                                    slope(steps_along, st + STEPS_OF_CURVE, tent),
                                )
                                by_x = by_x + fma(by_gamma, slope_gamma, by_kappa * slope_kappa)
                                by_x = by_x + fma(along_gamma, bent_gamma, along_kappa * bent_kappa)
                        both = fma(change, n_w, f * w_along)
                        by_w = fma(fma(e, change, e_change * f), g[p + k], by_w)
                        add_to(energy_sums, i + LANES * k, both * g[p + k])
                        add_to(
                            scratch,
                            at + 2 * ENERGY_STRIDE + LANES * k,
                            fma(e, both, e_change * f * n_w),
                        )
                    by_w = select(visible, by_w, 0.0)
                    moving = by_r * by_c  # by c'
                    by_c = (by_log_c - by_r * r) * by_c
                    # by n: c has h − n, and c' has h' − n'
                    to_h = moving * inverse_s
                    add_to(scratch, at, fma(by_w, wx, by_c * x) + (to_h * across_x - moving * ax))
                    add_to(
                        scratch,
                        at + LANES,
                        fma(by_w, wy, by_c * y) + (to_h * across_y - moving * ay),
                    )
                    add_to(
                        scratch,
                        at + 2 * LANES,
                        fma(by_w, wz, by_c * z) + (to_h * across_z - moving * az),
                    )
                    # by v: with u what of n stands across h, N = u·v', q that of v',
                    #   c has u/‖s‖;   c' has (n' across h)/‖s‖ − (N h + c q + (h·v') u)/‖s‖²
                    # θ has −¼ (‖s‖ d + ‖t‖ h);   θ' has −¼ ((d·v') h − (h·v') d − (‖s‖/‖t‖) (v'
                    # across d) + (‖t‖/‖s‖) q)
                    h_a = dot(hx, hy, hz, ax, ay, az)
                    twice = to_h * inverse_s
                    along_u = fma(by_c, inverse_s, 0.0 - twice * h_q)
                    by_theta, by_turn = (
                        by_x * (-0.25 * ANGLE_TO_X),
                        by_turned * (-0.25 * ANGLE_TO_X),
                    )
                    far, near = by_turn * length_s * inverse_t, by_turn * length_t * inverse_s
                    along_h = fma(by_theta, length_t, by_turn * d_q) - fma(to_h, h_a, twice * n_q)
                    along_d = fma(by_theta, length_s, far * d_q) - by_turn * h_q
                    along_q = near - twice * c
                    add_to(
                        scratch,
                        at + ENERGY_STRIDE,
                        dot(along_u, along_h, along_d, ux, hx, dx)
                        + (along_q * across_x + to_h * ax - far * qx),
                    )
                    add_to(
                        scratch,
                        at + ENERGY_STRIDE + LANES,
                        dot(along_u, along_h, along_d, uy, hy, dy)
                        + (along_q * across_y + to_h * ay - far * qy),
                    )
                    add_to(
                        scratch,
                        at + ENERGY_STRIDE + 2 * LANES,
                        dot(along_u, along_h, along_d, uz, hz, dz)
                        + (along_q * across_z + to_h * az - far * qz),
                    )
            for j in range(count):
                to = 3 * (chunk * pixels + start + j)
                at = sums + LANES * GENERAL_SECOND_ROWS * j
                write_sums(scratch, at, 3, n_part, to)
                write_sums(scratch, at + ENERGY_STRIDE, 3, v_part, to)
                write_sums(scratch, at + 2 * ENERGY_STRIDE, 3, g_part, to)
            write_sums(scratch, by_m, VALUES, m_sums, VALUES * (chunk * tiles + tile))
            write_sums(scratch, by_steps, STEPS, steps_sums, STEPS * (chunk * tiles + tile))
