"""Kernel for second derivatives of the sum for a distant viewer.

It is the backward pass of learn.engines.distant.backward, whose loops it repeats on purpose: each
is unrolled around values in registers.

Letters, arrays and the sum as in learn.engines.distant; besides, a direction and the radiance's
change I' along it: n_along  (P, 3): n', tangential up to rounding e_along  (blocks, 3, 16): E'
l_along  (blocks, 3 lobes, 3 channels, 2, 16): γ', κ' at each light

    S = Σ_pk g_pk I'_pk,   I'_k = Σ_i (F'_k μ + F_k μ') E_k + F_k μ E'_k,   μ = max(0, n·w),  μ' =
    w·n' where μ > 0
    F' = Σ_s exp(x) x',   x = κ c^γ,   x' = c^γ κ' + x q,   q = γ' ln c + γ r,   r = c'/c,   c' = (h
    − n)·n'

Its gradient, of one lobe and channel with u = g E μ and v = g (E μ' + E' μ): α = u exp(x) and X =
exp(x) (u (x' + q) + v) belong to x' and to x; Y = α c^γ κ' + X x to γ ln c; hence

    by κ: X c^γ     by γ: Y ln c + α x r     by ln c: Y γ + α x γ'     by r: α x γ     by n: c'_n =
    −n' where c_n = h − n

The first derivative by n was that of c = 1 − ½‖h − n‖², (h − n) a light, which this is the
derivative of: see `radial` in learn.methods.exact_second, which is the same in plain torch.
"""

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import (
    LN2,
    add_to,
    clear,
    cosine,
    half_offset,
    peak_cosine,
    w_of,
    write_sums,
)
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
    LIGHT_CHUNKS,
    LOBE_STRIDE,
    LOBES_STRIDE,
)
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
)

SECOND = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 15)


@inlined
def lobe_second(
    gamma: Lanes,
    kappa: Lanes,
    gamma_along: Lanes,
    kappa_along: Lanes,
    log2_c: Lanes,
    log_c: Lanes,
    r: Lanes,
    u: Lanes,
    v: Lanes,
) -> tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]:
    """F, F', and S's derivatives by κ, γ, ln c and r, of one lobe and channel.

    They are followed by α c^γ and α x ln c, for derivatives by κ' and γ'.

    kappa is κ log2 e, log2_c and log_c the same in two units.
    """
    power = exp2(gamma * log2_c)
    exponent = kappa * power
    value = exp2m1(exponent)
    e, x = value + 1.0, exponent * LN2
    q = fma(gamma_along, log_c, gamma * r)
    by_power = power * kappa_along
    change = fma(x, q, by_power)
    alpha = u * e
    by_x = fma(alpha, change + q, v * e)
    both = fma(alpha, by_power, by_x * x)
    alpha_x = alpha * x
    by_gamma = fma(both, log_c, alpha_x * r)
    by_log_c = fma(both, gamma, alpha_x * gamma_along)
    return (
        value,
        e * change,
        by_x * power,
        by_gamma,
        by_log_c,
        alpha_x * gamma,
        alpha * power,
        alpha_x * log_c,
    )


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
    for chunk in range(first, last):
        block_first, block_last = (
            chunk * blocks // LIGHT_CHUNKS,
            (chunk + 1) * blocks // LIGHT_CHUNKS,
        )
        blocks_here = block_last - block_first
        clear(lobe_sums, LOBES_STRIDE * block_first, LOBES_STRIDE // LANES * blocks_here)
        clear(energy_sums, ENERGY_STRIDE * block_first, 3 * blocks_here)
        sums = DISTANT_SECOND_SCRATCH * chunk
        for start in range(0, pixels, DISTANT_TILE):
            count = min(DISTANT_TILE, pixels - start)
            clear(scratch, sums, DISTANT_SECOND_ROWS * count)
            for block in range(block_first, block_last):
                o, i = DISTANT_STRIDE * block, ENERGY_STRIDE * block
                for j in range(count):
                    p = 3 * (start + j)
                    nx, ny, nz = n[p], n[p + 1], n[p + 2]
                    n_w = cosine(geometry, o, nx, ny, nz)
                    visible = n_w > 0.0
                    if not anywhere(visible):
                        continue
                    x, y, z = half_offset(geometry, o, nx, ny, nz)
                    c, log2_c = peak_cosine(x, y, z)
                    nearest = lane_max(log2_c)
                    ax, ay, az = n_along[p], n_along[p + 1], n_along[p + 2]
                    n_w = maximum(n_w, 0.0)
                    w_along = select(visible, cosine(geometry, o, ax, ay, az), 0.0)
                    log_c, by_c = log2_c * LN2, 1.0 / c
                    r = select(visible, fma(x, ax, fma(y, ay, z * az)) * by_c, 0.0)
                    by_w, by_log_c, by_r = splat(0.0), splat(0.0), splat(0.0)
                    a = sums + LANES * DISTANT_SECOND_ROWS * j
                    seen = False
                    for k in range(3):
                        e, e_change, weight = (
                            load(energy, i + LANES * k),
                            load(e_along, i + LANES * k),
                            n_w * g[p + k],
                        )
                        u, v = weight * e, fma(w_along * g[p + k], e, weight * e_change)
                        f, change = splat(0.0), splat(0.0)
                        for s in range(3):
                            if nearest * least[3 * block + s] > cut[block]:
                                seen = True
                                t = LOBES_STRIDE * block + LOBE_STRIDE * s + CHANNEL_STRIDE * k
                                (
                                    value,
                                    moved,
                                    by_kappa,
                                    by_gamma,
                                    lobe_log_c,
                                    lobe_r,
                                    _kappa,
                                    _gamma,
                                ) = lobe_second(
                                    load(lobes, t),
                                    load(lobes, t + LANES * KAPPA),
                                    load(l_along, t),
                                    load(l_along, t + LANES * KAPPA),
                                    log2_c,
                                    log_c,
                                    r,
                                    u,
                                    v,
                                )
                                f, change = f + value, change + moved
                                by_log_c, by_r = by_log_c + lobe_log_c, by_r + lobe_r
                                add_to(lobe_sums, t, by_kappa)
                                add_to(lobe_sums, t + LANES, by_gamma)
                        both = fma(change, n_w, f * w_along)
                        by_w = fma(fma(e, change, e_change * f), g[p + k], by_w)
                        add_to(energy_sums, i + LANES * k, both * g[p + k])
                        add_to(
                            scratch, a + ENERGY_STRIDE + LANES * k, fma(e, both, e_change * f * n_w)
                        )
                    if not seen:
                        continue
                    by_w = select(visible, by_w, 0.0)
                    moving = by_r * by_c
                    by_c = (by_log_c - by_r * r) * by_c
                    wx, wy, wz = w_of(geometry, o)
                    by_x = fma(by_c, x, 0.0 - moving * ax)
                    by_y = fma(by_c, y, 0.0 - moving * ay)
                    by_z = fma(by_c, z, 0.0 - moving * az)
                    add_to(scratch, a, fma(by_w, wx, by_x))
                    add_to(scratch, a + LANES, fma(by_w, wy, by_y))
                    add_to(scratch, a + 2 * LANES, fma(by_w, wz, by_z))
            for j in range(count):
                at = 3 * (chunk * pixels + start + j)
                write_sums(scratch, sums + LANES * DISTANT_SECOND_ROWS * j, 3, n_part, at)
                write_sums(
                    scratch, sums + LANES * DISTANT_SECOND_ROWS * j + ENERGY_STRIDE, 3, g_part, at
                )
