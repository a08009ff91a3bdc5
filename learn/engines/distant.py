"""Kernels for a distant viewer: h, θ_d and the 18 spline values belong to the light.

Every pixel's view is (0, 0, 1).

P pixels, blocks of 16 lights (LANES); all arrays float32, flat, C order.
n         (P, 3) unit normals, camera frame
geometry  (blocks, 9, 16): w (3 rows), h (3 rows), and what rounding took off h (3 rows)
energy    (blocks, 3, 16): radiance × solid angle, E_k
lobes     (blocks, 3 lobes, 3 channels, 2, 16): γ, κ log2 e
least     (blocks, 3 lobes): smallest γ, to bound a whole block
cut       (blocks,): a lobe with log2 c^γ below it everywhere in a block is left out
          (learn.engines.lights)
scratch   per call: room for DISTANT_TILE pixels' sums, (DISTANT_TILE, 3, 16)

    I_k = Σ_i F_k max(0, n·w) E_k,   F_k = Σ_s expm1(κ c^γ),   c = n·h = 1 − ½‖h − n‖²

‖h − n‖² instead of n·h keeps the precision of 1 − c at the peak of sharp lobes; h's second half
matters there too (γ = 1e5). Sums run over blocks in order, so a pixel's bits depend on nothing but
its own inputs.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.exponentials import exp2, exp2m1, log2
from learn.engines.layout import (
    CHANNEL_STRIDE,
    DISTANT_STRIDE,
    DISTANT_TILE,
    ENERGY_STRIDE,
    H_REST_X,
    H_REST_Y,
    H_REST_Z,
    H_X,
    H_Y,
    H_Z,
    KAPPA,
    LANES,
    LIGHT_CHUNKS,
    LOBE_STRIDE,
    LOBES_STRIDE,
    W_X,
    W_Y,
    W_Z,
)
from learn.engines.triples import (
    Triple,
    add_to,
    add_vector,
    clear,
    combined,
    dot,
    product,
    scaled,
    vector_at,
    write_sums,
)
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
    store,
)

# of h·n in lanes whose light is behind the horizon; seen ones have c > HORIZON / 2
LEAST_COSINE = 1e-12
LN2 = 0.6931471805599453

FORWARD = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 8)
BACKWARD = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 11)


@inlined
def first_block(chunk: int, blocks: int) -> int:
    """The first block of lights of a chunk, of LIGHT_CHUNKS; it ends where the next one begins."""
    return chunk * blocks // LIGHT_CHUNKS


@inlined
def half_offset(geometry: np.ndarray, o: int, n: Triple) -> Vector:
    """h − n of the block at offset o."""
    x = (load(geometry, o + LANES * H_X) - n[0]) + load(geometry, o + LANES * H_REST_X)
    y = (load(geometry, o + LANES * H_Y) - n[1]) + load(geometry, o + LANES * H_REST_Y)
    z = (load(geometry, o + LANES * H_Z) - n[2]) + load(geometry, o + LANES * H_REST_Z)
    return x, y, z


@inlined
def w_of(geometry: np.ndarray, o: int) -> Vector:
    """w, from the first three rows of either geometry."""
    return (
        load(geometry, o + LANES * W_X),
        load(geometry, o + LANES * W_Y),
        load(geometry, o + LANES * W_Z),
    )


@inlined
def cosine(geometry: np.ndarray, o: int, n: Triple) -> Lanes:
    """n·w of the block at offset o."""
    return dot(w_of(geometry, o), n)


@inlined
def peak_cosine(offset: Vector) -> tuple[Lanes, Lanes]:
    """c and log2 c from h − n."""
    one_minus_c = dot(offset, offset) * 0.5
    c = maximum(1.0 - one_minus_c, LEAST_COSINE)
    return c, log2(c, one_minus_c)


@inlined
def lobe(lobes: np.ndarray, o: int, log_c: Lanes) -> Lanes:
    """expm1(κ c^γ) of the lobe and channel at offset o."""
    return exp2m1(load(lobes, o + LANES * KAPPA) * exp2(load(lobes, o) * log_c))


@inlined
def is_seen(nearest: float, least: np.ndarray, o: int, cut: float) -> bool:
    """Whether any of a block's three lobes counts, whose least γ begin at place o.

    nearest  the largest log2 c of the block's lights
    """
    return nearest * min(least[o], least[o + 1], least[o + 2]) > cut


@inlined
def reflectance(lobes: np.ndarray, o: int, log_c: Lanes, f: Vector) -> Vector:
    """f of each channel, plus expm1(κ c^γ) of the lobe whose first channel is at offset o."""
    return (
        f[0] + lobe(lobes, o, log_c),
        f[1] + lobe(lobes, o + CHANNEL_STRIDE, log_c),
        f[2] + lobe(lobes, o + 2 * CHANNEL_STRIDE, log_c),
    )


@inlined
def add_radiance(
    sums: np.ndarray, a: int, f: Vector, n_w: Lanes, energy: np.ndarray, e: int
) -> None:
    """Add F max(0, n·w) E of sixteen lights to a pixel's sums, whose rows begin at offset a.

    f  F of each channel; e: offset of the lights' energy
    """
    n_w = maximum(n_w, 0.0)
    add_to(sums, a, f[0] * n_w * load(energy, e))
    add_to(sums, a + LANES, f[1] * n_w * load(energy, e + LANES))
    add_to(sums, a + 2 * LANES, f[2] * n_w * load(energy, e + 2 * LANES))


def forward(
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
    radiance: np.ndarray,
) -> None:
    """Radiance (P, 3) of pixel tiles first … last − 1."""
    for tile in range(first, last):
        start = tile * DISTANT_TILE
        count = min(DISTANT_TILE, pixels - start)
        clear(scratch, 0, 3 * count)
        for block in range(blocks):
            o, e = DISTANT_STRIDE * block, ENERGY_STRIDE * block
            for j in range(count):
                normal = vector_at(n, 3 * (start + j))
                n_w = cosine(geometry, o, normal)
                if not anywhere(n_w > 0.0):
                    continue
                log_c = peak_cosine(half_offset(geometry, o, normal))[1]
                nearest, seen = lane_max(log_c), False
                f = splat(0.0), splat(0.0), splat(0.0)
                for s in range(3):
                    if nearest * least[3 * block + s] > cut[block]:
                        seen = True
                        f = reflectance(lobes, LOBES_STRIDE * block + LOBE_STRIDE * s, log_c, f)
                if seen:
                    add_radiance(scratch, ENERGY_STRIDE * j, f, n_w, energy, e)
        write_sums(scratch, 0, 3 * count, radiance, 3 * start)


class Facing(NamedTuple):
    """One pixel before sixteen lights, with the derivative by its radiance.

    n_w      μ = max(0, n·w); visible: where n·w is above 0
    offset   h − n; c and log_c: c and log2 c
    g        derivative by radiance; weight: g μ of each channel
    """

    n_w: Lanes
    visible: Mask
    offset: Vector
    c: Lanes
    log_c: Lanes
    g: Triple
    weight: Vector


@inlined
def facing(geometry: np.ndarray, o: int, n: Triple, n_w: Lanes, visible: Mask, g: Triple) -> Facing:
    """A pixel before the lights of the block at offset o, of which `visible` ones have n·w > 0."""
    offset = half_offset(geometry, o, n)
    c, log_c = peak_cosine(offset)
    n_w = maximum(n_w, 0.0)
    return Facing(n_w, visible, offset, c, log_c, g, scaled(n_w, g))


@inlined
def lobe_backward(
    lobes: np.ndarray,
    o: int,
    log_c: Lanes,
    weight: Lanes,
    lobe_sums: np.ndarray,
    to: int,
    f: Lanes,
    slope: Lanes,
) -> tuple[Lanes, Lanes]:
    """Add one lobe and channel to its two sums over pixels, to F and to its slope.

    Returns  f + expm1(κ c^γ), and slope + x κ c^γ γ log2 e, where x = exp(κ c^γ)
    """
    gamma = load(lobes, o)
    power = exp2(gamma * log_c)
    exponent = load(lobes, o + LANES * KAPPA) * power
    value = exp2m1(exponent)
    x = value + 1.0
    q = weight * (x * power)
    add_to(lobe_sums, to, q)
    store(lobe_sums, to + LANES, fma(q, log_c, load(lobe_sums, to + LANES)))
    return f + value, fma(x * exponent, gamma, slope)


@inlined
def reflectance_backward(
    lobes: np.ndarray,
    o: int,
    log_c: Lanes,
    weight: Vector,
    lobe_sums: np.ndarray,
    to: int,
    f: Vector,
    slope: Vector,
) -> tuple[Vector, Vector]:
    """`lobe_backward` of one lobe's three channels.

    o, to     offsets of the first channel in `lobes` and in `lobe_sums`
    weight    of `Facing`
    f, slope  of the lobes before, by channel
    """
    f0, d0 = lobe_backward(lobes, o, log_c, weight[0], lobe_sums, to, f[0], slope[0])
    o, to = o + CHANNEL_STRIDE, to + CHANNEL_STRIDE
    f1, d1 = lobe_backward(lobes, o, log_c, weight[1], lobe_sums, to, f[1], slope[1])
    o, to = o + CHANNEL_STRIDE, to + CHANNEL_STRIDE
    f2, d2 = lobe_backward(lobes, o, log_c, weight[2], lobe_sums, to, f[2], slope[2])
    return (f0, f1, f2), (d0, d1, d2)


@inlined
def add_by_n(
    sums: np.ndarray,
    a: int,
    w: Vector,
    energy: np.ndarray,
    e: int,
    pixel: Facing,
    f: Vector,
    slope: Vector,
) -> None:
    """Add the derivative by n to a pixel's sums: Σ_k g_k E_k (F w + μ dF/dc (h − n)).

    a  offset of the pixel's sums; e: of the lights' energy
    f  F of each channel; slope: dF/dc · c log2 e of each
    """
    n_w = pixel.n_w
    (f0, f1, f2), (d0, d1, d2), (g0, g1, g2) = f, slope, pixel.g
    e0, e1, e2 = load(energy, e), load(energy, e + LANES), load(energy, e + 2 * LANES)
    by_w = fma(f0 * g0, e0, fma(f1 * g1, e1, f2 * g2 * e2))
    by_w = select(pixel.visible, by_w, 0.0)
    by_c = fma(d0 * (n_w * g0), e0, fma(d1 * (n_w * g1), e1, d2 * (n_w * g2) * e2)) * LN2 / pixel.c
    add_vector(sums, a, combined(by_w, w, by_c, pixel.offset))


def backward(
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
    n_part: np.ndarray,
    energy_sums: np.ndarray,
    lobe_sums: np.ndarray,
) -> None:
    """Derivatives of Σ g·I that belong to light chunks first … last − 1.

    Values of the forward pass are computed again. Each kernel's loops are its own, unrolled around
    values in registers, although they resemble those of the other kernels.

    g            (P, 3) derivative by radiance
    n_part       (LIGHT_CHUNKS, P, 3) out: each chunk's share of the derivative by n, tangential
    energy_sums  (blocks, 3, 16) out: Σ_p g F max(0, n·w), the derivative by energy
    lobe_sums    (blocks, 3, 3, 2, 16) out: Σ_p g max(0, n·w) x c^γ, and the same times log2 c

    A block belongs to one chunk, and chunks do not depend on the number of threads: no atomics, the
    same bits every time. Off the sphere the derivative by n is free; c is taken as 1 − ½‖h − n‖²
    without its radial part, so that the small tangential part of a sharp lobe is not lost beside
    the radial one.
    """
    for chunk in range(first, last):
        block_first, block_last = first_block(chunk, blocks), first_block(chunk + 1, blocks)
        blocks_here = block_last - block_first
        clear(lobe_sums, LOBES_STRIDE * block_first, LOBES_STRIDE // LANES * blocks_here)
        clear(energy_sums, ENERGY_STRIDE * block_first, 3 * blocks_here)
        sums = ENERGY_STRIDE * DISTANT_TILE * chunk
        for start in range(0, pixels, DISTANT_TILE):
            count = min(DISTANT_TILE, pixels - start)
            clear(scratch, sums, 3 * count)
            for block in range(block_first, block_last):
                o, e = DISTANT_STRIDE * block, ENERGY_STRIDE * block
                for j in range(count):
                    p = 3 * (start + j)
                    normal = vector_at(n, p)
                    n_w = cosine(geometry, o, normal)
                    visible = n_w > 0.0
                    if not anywhere(visible):
                        continue
                    pixel = facing(geometry, o, normal, n_w, visible, vector_at(g, p))
                    nearest, seen = lane_max(pixel.log_c), False
                    f = splat(0.0), splat(0.0), splat(0.0)
                    slope = splat(0.0), splat(0.0), splat(0.0)
                    for s in range(3):
                        if nearest * least[3 * block + s] > cut[block]:
                            seen, t = True, LOBES_STRIDE * block + LOBE_STRIDE * s
                            f, slope = reflectance_backward(
                                lobes, t, pixel.log_c, pixel.weight, lobe_sums, t, f, slope
                            )
                    if not seen:
                        continue
                    add_vector(energy_sums, e, product(f, pixel.weight))
                    at, w = sums + ENERGY_STRIDE * j, w_of(geometry, o)
                    add_by_n(scratch, at, w, energy, e, pixel, f, slope)
            write_sums(scratch, sums, 3 * count, n_part, 3 * (chunk * pixels + start))
