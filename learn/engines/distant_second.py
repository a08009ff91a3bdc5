"""Kernel for second derivatives of the sum for a distant viewer.

It is the backward pass of learn.engines.distant.backward, whose loops it repeats on purpose: each
is unrolled around values in registers.

Letters, arrays and the sum as in learn.engines.distant; besides, a direction and the radiance's
change I' along it:
n_along  (P, 3): n', tangential up to rounding
e_along  (blocks, 3, 16): E'
l_along  (blocks, 3 lobes, 3 channels, 2, 16): γ', κ' at each light

    S = Σ_pk g_pk I'_pk,   I'_k = Σ_i (F'_k μ + F_k μ') E_k + F_k μ E'_k,   μ = max(0, n·w),
    μ' = w·n' where μ > 0
    F' = Σ_s exp(x) x',   x = κ c^γ,   x' = c^γ κ' + x q,   q = γ' ln c + γ r,   r = c'/c,
    c' = (h − n)·n'

Its gradient, of one lobe and channel with u = g E μ and v = g (E μ' + E' μ): α = u exp(x) and
X = exp(x) (u (x' + q) + v) belong to x' and to x; Y = α c^γ κ' + X x to γ ln c; hence

    by κ: X c^γ     by γ: Y ln c + α x r     by ln c: Y γ + α x γ'     by r: α x γ
    by n: c'_n = −n' where c_n = h − n

The first derivative by n was that of c = 1 − ½‖h − n‖², (h − n) a light, which this is the
derivative of: see `radial` in learn.methods.exact_second, which is the same in plain torch.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import LN2, cosine, first_block, half_offset, is_seen, peak_cosine, w_of
from learn.engines.exponentials import exp2, exp2m1
from learn.engines.layout import (
    CHANNEL_STRIDE,
    DISTANT_SECOND_ROWS,
    DISTANT_SECOND_SCRATCH,
    DISTANT_STRIDE,
    DISTANT_TILE,
    ENERGY_STRIDE,
    KAPPA,
    LANES,
    LOBE_STRIDE,
    LOBES_STRIDE,
)
from learn.engines.triples import Triple, add_to, add_vector, clear, dot, vector_at, write_sums
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    Mask,
    Vector,
    anywhere,
    fma,
    lane_max,
    load,
    maximum,
    select,
    splat,
)

SECOND = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 15)


class Inputs(NamedTuple):
    """The arrays of that name above, and of learn.engines.distant."""

    energy: np.ndarray
    e_along: np.ndarray
    lobes: np.ndarray
    l_along: np.ndarray
    least: np.ndarray


class Sums(NamedTuple):
    """Where derivatives are added: energy_sums and lobe_sums as of `second`, and scratch."""

    energy: np.ndarray
    lobes: np.ndarray
    pixels: np.ndarray


class Change(NamedTuple):
    """What the sum over lobes needs to know of sixteen lights and of their change.

    n_w, n_w_along  μ and μ'
    log2_c, log_c   log2 c, and ln c
    r               c'/c
    """

    n_w: Lanes
    n_w_along: Lanes
    log2_c: Lanes
    log_c: Lanes
    r: Lanes


class Weights(NamedTuple):
    """How sixteen lights weigh in S, in one channel k.

    energy, energy_along  E and E'
    u, v                  g E μ and g (E μ' + E' μ)
    """

    energy: Lanes
    energy_along: Lanes
    u: Lanes
    v: Lanes


class LobeSecond(NamedTuple):
    """One lobe and channel at sixteen lights.

    value, change                F's summand and that of F'
    by_kappa, by_gamma           derivatives of S by κ and γ
    by_log_c, by_r               by ln c and by r
    alpha_power, alpha_x_log_c   α c^γ and α x ln c: by κ' and γ'
    """

    value: Lanes
    change: Lanes
    by_kappa: Lanes
    by_gamma: Lanes
    by_log_c: Lanes
    by_r: Lanes
    alpha_power: Lanes
    alpha_x_log_c: Lanes


@inlined
def lobe_second(
    gamma: Lanes,
    kappa: Lanes,
    gamma_along: Lanes,
    kappa_along: Lanes,
    change: Change,
    weights: Weights,
) -> LobeSecond:
    """The summands and derivatives of one lobe and channel, by the formulas above.

    kappa is κ log2 e; kappa_along and gamma_along are κ' and γ'.
    """
    power = exp2(gamma * change.log2_c)
    exponent = kappa * power
    value = exp2m1(exponent)
    e, x = value + 1.0, exponent * LN2
    u, v = weights.u, weights.v
    q = fma(gamma_along, change.log_c, gamma * change.r)
    by_power = power * kappa_along
    x_along = fma(x, q, by_power)
    alpha = u * e
    by_x = fma(alpha, x_along + q, v * e)
    both = fma(alpha, by_power, by_x * x)
    alpha_x = alpha * x
    return LobeSecond(
        value,
        e * x_along,
        by_x * power,
        fma(both, change.log_c, alpha_x * change.r),
        fma(both, gamma, alpha_x * gamma_along),
        alpha_x * gamma,
        alpha * power,
        alpha_x * change.log_c,
    )


@inlined
def weights_of(
    energy: np.ndarray, e_along: np.ndarray, i: int, change: Change, g: float
) -> Weights:
    """The weights of one channel, whose energies are at offset i; g: its derivative by radiance."""
    e, e_change, weight = load(energy, i), load(e_along, i), change.n_w * g
    return Weights(e, e_change, weight * e, fma(change.n_w_along * g, e, weight * e_change))


@inlined
def add_by_energy_and_g(
    energy_sums: np.ndarray,
    i: int,
    sums: np.ndarray,
    at: int,
    weights: Weights,
    change: Change,
    f: Lanes,
    f_along: Lanes,
    g: float,
    by_w: Lanes,
) -> Lanes:
    """Add one channel's derivatives by E and by g, and return by_w plus that by μ.

        by E: g (F' μ + F μ')     by g: E (F' μ + F μ') + E' F μ     by μ: g (E F' + E' F)

    i, at       offsets in energy_sums and in sums
    f, f_along  F and F'
    """
    e, e_change = weights.energy, weights.energy_along
    both = fma(f_along, change.n_w, f * change.n_w_along)
    add_to(energy_sums, i, both * g)
    add_to(sums, at, fma(e, both, e_change * f * change.n_w))
    return fma(fma(e, f_along, e_change * f), g, by_w)


@inlined
def by_cosine(by_log_c: Lanes, by_r: Lanes, r: Lanes, inverse_c: Lanes) -> tuple[Lanes, Lanes]:
    """The derivatives by c and by c' of r = c'/c and of ln c, from those by r and ln c."""
    return (by_log_c - by_r * r) * inverse_c, by_r * inverse_c


@inlined
def change_of(
    n_w: Lanes, visible: Mask, w_along: Lanes, c_along: Lanes, c: Lanes, log2_c: Lanes
) -> tuple[Change, Lanes]:
    """The change of sixteen lights, and 1/c.

    n_w, w_along  n·w and n'·w; visible: where n·w is above 0
    c, c_along    c and c', and log2 c
    """
    mu_along, inverse_c = select(visible, w_along, 0.0), 1.0 / c
    r = select(visible, c_along * inverse_c, 0.0)
    return Change(maximum(n_w, 0.0), mu_along, log2_c, log2_c * LN2, r), inverse_c


@inlined
def add_lobes(
    inputs: Inputs,
    sums: Sums,
    block: int,
    k: int,
    nearest: float,
    cut: float,
    change: Change,
    weights: Weights,
    by_log_c: Lanes,
    by_r: Lanes,
) -> tuple[Lanes, Lanes, Lanes, Lanes]:
    """F and F' of channel k, and by_log_c and by_r plus S's derivatives by ln c and by r.

    They are summed over the lobes that count; S's derivatives by κ and γ are added to the sums.

    nearest  the largest log2 c of the block's lights
    """
    f, f_along = splat(0.0), splat(0.0)
    for s in range(3):
        if nearest * inputs.least[3 * block + s] > cut:
            t = LOBES_STRIDE * block + LOBE_STRIDE * s + CHANNEL_STRIDE * k
            lobe = lobe_second(
                load(inputs.lobes, t),
                load(inputs.lobes, t + LANES * KAPPA),
                load(inputs.l_along, t),
                load(inputs.l_along, t + LANES * KAPPA),
                change,
                weights,
            )
            f, f_along = f + lobe.value, f_along + lobe.change
            by_log_c, by_r = by_log_c + lobe.by_log_c, by_r + lobe.by_r
            add_to(sums.lobes, t, lobe.by_kappa)
            add_to(sums.lobes, t + LANES, lobe.by_gamma)
    return f, f_along, by_log_c, by_r


@inlined
def block_second(
    inputs: Inputs,
    sums: Sums,
    block: int,
    nearest: float,
    cut: float,
    change: Change,
    g: np.ndarray,
    p: int,
    at: int,
) -> Vector:
    """S's derivatives by μ, ln c and r of one pixel and block; the others are added to the sums.

    g   (P, 3) of which the pixel's begins at place p; at: offset of its rows by g in sums.pixels
    """
    by_w, by_log_c, by_r = splat(0.0), splat(0.0), splat(0.0)
    for k in range(3):
        i = ENERGY_STRIDE * block + LANES * k
        weights = weights_of(inputs.energy, inputs.e_along, i, change, g[p + k])
        f, f_along, by_log_c, by_r = add_lobes(
            inputs, sums, block, k, nearest, cut, change, weights, by_log_c, by_r
        )
        by_w = add_by_energy_and_g(
            sums.energy, i, sums.pixels, at + LANES * k, weights, change, f, f_along, g[p + k], by_w
        )
    return by_w, by_log_c, by_r


@inlined
def by_normal(
    by_w: Lanes, w: Vector, by_c: Lanes, offset: Vector, by_c_along: Lanes, n_along: Triple
) -> Vector:
    """The derivative by n, of which μ has w, c has h − n, and c' has −n' (offset: h − n)."""
    by_x = fma(by_c, offset[0], 0.0 - by_c_along * n_along[0])
    by_y = fma(by_c, offset[1], 0.0 - by_c_along * n_along[1])
    by_z = fma(by_c, offset[2], 0.0 - by_c_along * n_along[2])
    return fma(by_w, w[0], by_x), fma(by_w, w[1], by_y), fma(by_w, w[2], by_z)


def second(
    first: int,
    last: int,
    pixels: int,
    blocks: int,
    n: np.ndarray,
    geometry: np.ndarray,
    energy: np.ndarray,
    lobes: np.ndarray,
    least: np.ndarray,
    cut: np.ndarray,
    scratch: np.ndarray,
    g: np.ndarray,
    n_along: np.ndarray,
    e_along: np.ndarray,
    l_along: np.ndarray,
    n_part: np.ndarray,
    g_part: np.ndarray,
    energy_sums: np.ndarray,
    lobe_sums: np.ndarray,
) -> None:
    """Derivatives of S from light chunks first … last − 1, as learn.engines.distant.backward.

    scratch      (LIGHT_CHUNKS, DISTANT_TILE, DISTANT_SECOND_ROWS, 16)
    n_part       (LIGHT_CHUNKS, P, 3) out: each chunk's share of the derivative by n, tangential
    g_part       (LIGHT_CHUNKS, P, 3) out: of the derivative by g
    energy_sums  (blocks, 3, 16) out: the derivative by energy
    lobe_sums    (blocks, 3, 3, 2, 16) out: those by κ and by γ at each light
    """
    inputs = Inputs(energy, e_along, lobes, l_along, least)
    outputs = Sums(energy_sums, lobe_sums, scratch)
    for chunk in range(first, last):
        block_first, block_last = first_block(chunk, blocks), first_block(chunk + 1, blocks)
        blocks_here = block_last - block_first
        clear(lobe_sums, LOBES_STRIDE * block_first, LOBES_STRIDE // LANES * blocks_here)
        clear(energy_sums, ENERGY_STRIDE * block_first, 3 * blocks_here)
        sums = DISTANT_SECOND_SCRATCH * chunk
        for start in range(0, pixels, DISTANT_TILE):
            count = min(DISTANT_TILE, pixels - start)
            clear(scratch, sums, DISTANT_SECOND_ROWS * count)
            for block in range(block_first, block_last):
                o = DISTANT_STRIDE * block
                for j in range(count):
                    p, at = 3 * (start + j), sums + LANES * DISTANT_SECOND_ROWS * j
                    normal, along = vector_at(n, p), vector_at(n_along, p)
                    n_w = cosine(geometry, o, normal)
                    visible = n_w > 0.0
                    if not anywhere(visible):
                        continue
                    offset = half_offset(geometry, o, normal)
                    c, log2_c = peak_cosine(offset)
                    nearest = lane_max(log2_c)
                    if not is_seen(nearest, least, 3 * block, cut[block]):
                        continue
                    w_along = cosine(geometry, o, along)
                    c_along = dot(offset, along)
                    change, inverse_c = change_of(n_w, visible, w_along, c_along, c, log2_c)
                    by_w, by_log_c, by_r = block_second(
                        inputs, outputs, block, nearest, cut[block], change, g, p,
                        at + ENERGY_STRIDE,
                    )  # fmt: skip
                    by_w = select(visible, by_w, 0.0)
                    by_c, by_c_along = by_cosine(by_log_c, by_r, change.r, inverse_c)
                    w = w_of(geometry, o)
                    add_vector(scratch, at, by_normal(by_w, w, by_c, offset, by_c_along, along))
            for j in range(count):
                at, to = sums + LANES * DISTANT_SECOND_ROWS * j, 3 * (chunk * pixels + start + j)
                write_sums(scratch, at, 3, n_part, to)
                write_sums(scratch, at + ENERGY_STRIDE, 3, g_part, to)
