"""Kernel for second derivatives of the sum for a distant viewer.

It is the backward pass of learn.engines.distant.backward, whose loops it repeats on purpose: each
is unrolled around values in registers.

Letters, arrays and the sum as in learn.engines.distant, S and its parts as in
learn.engines.second_lobes; besides, a direction and what changes along it:
n_along  (P, 3): n', tangential up to rounding
e_along  (blocks, 3, 16): E'
l_along  (blocks, 3 lobes, 3 channels, 2, 16): γ', κ' at each light

    c' = (h − n)·n'     by n: c'_n = −n' where c_n = h − n

The first derivative by n was that of c = 1 − ½‖h − n‖², (h − n) a light, which this is the
derivative of: see `radial` in learn.methods.exact_second, which is the same in plain torch.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import cosine, first_block, half_offset, is_seen, peak_cosine, w_of
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
from learn.engines.second_lobes import (
    Change,
    Weights,
    add_by_energy_and_g,
    by_cosine,
    change_of,
    lobe_second,
    weights_of,
)
from learn.engines.triples import Triple, add_to, add_vector, clear, dot, vector_at, write_sums
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    Vector,
    anywhere,
    fma,
    lane_max,
    load,
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
