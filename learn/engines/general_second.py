"""Kernel for second derivatives of the sum for a view vector per pixel.

It is the backward pass of learn.engines.general.backward, whose loops it repeats on purpose: each
is unrolled around values in registers.

Letters, arrays and the sum as in learn.engines.general, S and its parts as in
learn.engines.second_lobes; besides
n_along, v_along  (P, 3): n', v', tangential up to rounding
m                 (3 lobes, 3 channels, 2, 6): control values of γ and of κ log2 e
m_along           the same of γ' and of κ'
steps             (3 lobes, 3 channels, 2, 5): slopes of the splines of γ and of κ
                  (learn.engines.lights.spline_steps)
steps_along       the same of γ' and of κ'

    c' = (h − n)·n' + h'·n    h' = (v' − h (h·v'))/‖s‖    θ' = −¼ (‖s‖ d + ‖t‖ h)·v'    d = t/‖t‖
    κ' = Σ_b B_b m'_b + θ' Σ_b B_b' κ_b, and so γ'

The splines' x = θ_d · 8/π stands for θ_d, and x' for θ'. θ_d has a corner where w = v: ‖t‖ is held
above √LEAST_SQUARE (learn.engines.halfway), and so is the second derivative below the bound that it
lacks.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import first_block, is_seen, w_of
from learn.engines.exponentials import angle
from learn.engines.halfway import half_vectors, view_at
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
    LOBE_VALUES,
    STEPS,
    STEPS_OF_CURVE,
    VALUES,
)
from learn.engines.second_angles import add_by_n, add_by_v, along_of, angles_of, x_along_of
from learn.engines.second_lobes import (
    Change,
    Weights,
    add_by_energy_and_g,
    by_cosine,
    change_of,
    lobe_second,
    weights_of,
)
from learn.engines.splines import ANGLE_TO_X, Basis, Tents, add_curve, basis, curve, slope, tents
from learn.engines.triples import clear, difference, dot, vector_at, write_sums
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    anywhere,
    fma,
    lane_max,
    load,
    select,
    splat,
    store,
)

SECOND = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 21)


class Inputs(NamedTuple):
    """The arrays of that name above, and of learn.engines.general."""

    energy: np.ndarray
    e_along: np.ndarray
    m: np.ndarray
    steps: np.ndarray
    least: np.ndarray
    m_along: np.ndarray
    steps_along: np.ndarray


class Sums(NamedTuple):
    """Where derivatives are added: energy_sums as of `second`, and a chunk's part of scratch.

    by_m, by_steps  offsets in scratch of the sums that are like m and like steps
    """

    energy: np.ndarray
    scratch: np.ndarray
    by_m: int
    by_steps: int


class Bend(NamedTuple):
    """The spline's functions at θ_d, those of its slope and of its second derivative, and x'."""

    basis: Basis
    tents: Tents
    bends: Tents
    x_along: Lanes


class Derivatives(NamedTuple):
    """Derivatives of S, for one pixel and sixteen lights: by ln c and r = c'/c, by x and by x'."""

    by_log_c: Lanes
    by_r: Lanes
    by_x: Lanes
    by_x_along: Lanes


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
def add_lobe(
    inputs: Inputs,
    sums: Sums,
    o: int,
    change: Change,
    bend: Bend,
    weights: Weights,
    f: Lanes,
    f_along: Lanes,
    by: Derivatives,
) -> tuple[Lanes, Lanes, Derivatives]:
    """f, f_along and `by`, plus F, F' and S's derivatives of one lobe and channel.

    Those by the material's γ and κ through their values, and through their slopes by x', are added
    to the sums.

    o  offset of the lobe's and channel's values in m
    """
    b, tent, bent, x_along = bend
    gammas = o // CONTROL_VALUES * STEPS_OF_CURVE  # offset in steps
    kappas = gammas + STEPS_OF_CURVE
    slope_gamma, slope_kappa = slope(inputs.steps, gammas, tent), slope(inputs.steps, kappas, tent)
    lobe = lobe_second(
        curve(inputs.m, o, b),
        curve(inputs.m, o + KAPPA_VALUES, b),
        fma(x_along, slope_gamma, curve(inputs.m_along, o, b)),
        fma(x_along, slope_kappa, curve(inputs.m_along, o + KAPPA_VALUES, b)),
        change,
        weights,
    )
    by_kappa_along, by_gamma_along = lobe.alpha_power, lobe.alpha_x_log_c
    scratch, by_m, by_steps = sums.scratch, sums.by_m, sums.by_steps
    add_curve(scratch, by_m + LANES * o, lobe.by_gamma, b)
    add_curve(scratch, by_m + LANES * (o + KAPPA_VALUES), lobe.by_kappa, b)
    add_slope(scratch, by_steps + LANES * gammas, by_gamma_along * x_along, tent)
    add_slope(scratch, by_steps + LANES * kappas, by_kappa_along * x_along, tent)
    # ∂γ'/∂x and ∂κ'/∂x
    bent_gamma = fma(
        x_along, slope(inputs.steps, gammas, bent), slope(inputs.steps_along, gammas, tent)
    )
    bent_kappa = fma(
        x_along, slope(inputs.steps, kappas, bent), slope(inputs.steps_along, kappas, tent)
    )
    by_x = by.by_x + fma(lobe.by_gamma, slope_gamma, lobe.by_kappa * slope_kappa)
    return (
        f + lobe.value,
        f_along + lobe.change,
        Derivatives(
            by.by_log_c + lobe.by_log_c,
            by.by_r + lobe.by_r,
            by_x + fma(by_gamma_along, bent_gamma, by_kappa_along * bent_kappa),
            by.by_x_along + fma(by_gamma_along, slope_gamma, by_kappa_along * slope_kappa),
        ),
    )


@inlined
def block_second(
    inputs: Inputs,
    sums: Sums,
    block: int,
    nearest: float,
    cut: float,
    change: Change,
    bend: Bend,
    g: np.ndarray,
    p: int,
    at: int,
) -> tuple[Lanes, Derivatives]:
    """S's derivative by μ, and its others, of one pixel and block.

    Those by g, by energy and by the material are added to the sums.

    nearest  the largest log2 c of the block's lights
    g        (P, 3) of which the pixel's begins at place p; at: offset of its rows by g in scratch
    """
    by_w, none = splat(0.0), splat(0.0)
    by = Derivatives(none, none, none, none)
    for k in range(3):
        i = ENERGY_STRIDE * block + LANES * k
        weights = weights_of(inputs.energy, inputs.e_along, i, change, g[p + k])
        f, f_along = splat(0.0), splat(0.0)
        for s in range(3):
            if nearest * inputs.least[s] > cut:
                o = LOBE_VALUES * s + CHANNEL_VALUES * k
                f, f_along, by = add_lobe(inputs, sums, o, change, bend, weights, f, f_along, by)
        to = at + LANES * k
        by_w = add_by_energy_and_g(
            sums.energy, i, sums.scratch, to, weights, change, f, f_along, g[p + k], by_w
        )
    return by_w, by


@inlined
def pixel_second(
    inputs: Inputs,
    sums: Sums,
    geometry: np.ndarray,
    block: int,
    cut: float,
    n: np.ndarray,
    v: np.ndarray,
    n_along: np.ndarray,
    v_along: np.ndarray,
    g: np.ndarray,
    p: int,
    at: int,
) -> None:
    """Add the derivatives of one pixel, at place p, and of one block of lights to the sums.

    at  offset of the pixel's nine rows in scratch: by n, by v and by g
    """
    o = GENERAL_STRIDE * block
    w, normal = w_of(geometry, o), vector_at(n, p)
    n_w = dot(w, normal)
    visible = n_w > 0.0
    if not anywhere(visible):
        return
    view, v_short = view_at(v, p)
    half = half_vectors(geometry, o, normal, view, v_short)
    nearest = lane_max(half.log_c)
    if not is_seen(nearest, inputs.least, 0, cut):
        return
    t = difference(w, view)
    t_square = dot(t, t)
    theta_d = angle(t_square, half.s_square)
    angles = angles_of(half, normal, t, t_square)
    along = along_of(angles, vector_at(n_along, p), vector_at(v_along, p))
    bend = Bend(basis(theta_d), tents(theta_d), bends(theta_d), x_along_of(angles, along))
    w_along = dot(w, along.n)
    c_along = fma(along.n_v, half.inverse_s, dot(half.offset, along.n))
    change, inverse_c = change_of(n_w, visible, w_along, c_along, half.c, half.log_c)
    by_w, by = block_second(
        inputs, sums, block, nearest, cut, change, bend, g, p, at + 2 * ENERGY_STRIDE
    )
    by_w = select(visible, by_w, 0.0)
    by_c, by_c_along = by_cosine(by.by_log_c, by.by_r, change.r, inverse_c)
    add_by_n(sums.scratch, at, by_w, w, by_c, half.offset, by_c_along, half.inverse_s, along)
    at += ENERGY_STRIDE
    add_by_v(sums.scratch, at, by_c, by_c_along, by.by_x, by.by_x_along, half.c, angles, along)


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
    inputs = Inputs(energy, e_along, m, steps, least, m_along, steps_along)
    for chunk in range(first, last):
        block_first, block_last = first_block(chunk, blocks), first_block(chunk + 1, blocks)
        clear(energy_sums, ENERGY_STRIDE * block_first, 3 * (block_last - block_first))
        rows = GENERAL_SECOND_SCRATCH * chunk
        by_m = rows + LANES * GENERAL_SECOND_ROWS * GENERAL_TILE
        by_steps = by_m + LANES * VALUES
        sums = Sums(energy_sums, scratch, by_m, by_steps)
        for tile in range(tiles):
            start = tile * GENERAL_TILE
            count = min(GENERAL_TILE, pixels - start)
            clear(scratch, rows, GENERAL_SECOND_SCRATCH // LANES)
            for block in range(block_first, block_last):
                for j in range(count):
                    at = rows + LANES * GENERAL_SECOND_ROWS * j
                    pixel_second(
                        inputs, sums, geometry, block, cut[block], n, v, n_along, v_along, g,
                        3 * (start + j), at,
                    )  # fmt: skip
            for j in range(count):
                to = 3 * (chunk * pixels + start + j)
                at = rows + LANES * GENERAL_SECOND_ROWS * j
                write_sums(scratch, at, 3, n_part, to)
                write_sums(scratch, at + ENERGY_STRIDE, 3, v_part, to)
                write_sums(scratch, at + 2 * ENERGY_STRIDE, 3, g_part, to)
            write_sums(scratch, by_m, VALUES, m_sums, VALUES * (chunk * tiles + tile))
            write_sums(scratch, by_steps, STEPS, steps_sums, STEPS * (chunk * tiles + tile))
