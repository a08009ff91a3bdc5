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
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    Mask,
    Vector,
    anywhere,
    fma,
    lane_max,
    lane_sum,
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
def half_offset(geometry: np.ndarray, o: int, nx: Lanes, ny: Lanes, nz: Lanes) -> Vector:
    """h − n."""
    x = (load(geometry, o + LANES * H_X) - nx) + load(geometry, o + LANES * H_REST_X)
    y = (load(geometry, o + LANES * H_Y) - ny) + load(geometry, o + LANES * H_REST_Y)
    z = (load(geometry, o + LANES * H_Z) - nz) + load(geometry, o + LANES * H_REST_Z)
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
def cosine(geometry: np.ndarray, o: int, nx: Lanes, ny: Lanes, nz: Lanes) -> Lanes:
    """n·w."""
    wx, wy, wz = w_of(geometry, o)
    return fma(wx, nx, fma(wy, ny, wz * nz))


@inlined
def peak_cosine(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, Lanes]:
    """c and log2 c from h − n."""
    one_minus_c = fma(x, x, fma(y, y, z * z)) * 0.5
    c = maximum(1.0 - one_minus_c, LEAST_COSINE)
    return c, log2(c, one_minus_c)


@inlined
def lobe(lobes: np.ndarray, o: int, log_c: Lanes) -> Lanes:
    """expm1(κ c^γ) of the lobe and channel at offset o."""
    return exp2m1(load(lobes, o + LANES * KAPPA) * exp2(load(lobes, o) * log_c))


@inlined
def add_to(pointer: np.ndarray, o: int, value: Lanes) -> None:
    """Add sixteen floats to those at offset o."""
    store(pointer, o, load(pointer, o) + value)


@inlined
def clear(pointer: np.ndarray, o: int, count: int) -> None:
    """Write zeros into `count` rows from offset o on."""
    for i in range(count):
        store(pointer, o + LANES * i, splat(0.0))


@inlined
def write_sums(sums: np.ndarray, o: int, count: int, out: np.ndarray, to: int) -> None:
    """Write the sums over lanes of `count` rows."""
    for i in range(count):
        out[to + i] = lane_sum(load(sums, o + LANES * i))


@inlined
def add_by_n(
    sums: np.ndarray,
    a: int,
    geometry: np.ndarray,
    o: int,
    energy: np.ndarray,
    e: int,
    n_w: Lanes,
    visible: Mask,
    c: Lanes,
    offset: Vector,
    f: Vector,
    slope: Vector,
    g: tuple[float, float, float],
) -> None:
    """Add the derivative by n to a pixel's sums.

    offset  h − n
    f       F of each channel; slope: dF/dc · c log2 e of each; g: derivative by radiance
    """
    (f0, f1, f2), (d0, d1, d2), (g0, g1, g2) = f, slope, g
    e0, e1, e2 = load(energy, e), load(energy, e + LANES), load(energy, e + 2 * LANES)
    by_w = fma(f0 * g0, e0, fma(f1 * g1, e1, f2 * g2 * e2))
    by_w = select(visible, by_w, 0.0)
    by_c = fma(d0 * (n_w * g0), e0, fma(d1 * (n_w * g1), e1, d2 * (n_w * g2) * e2)) * LN2 / c
    wx, wy, wz = w_of(geometry, o)
    x, y, z = offset
    add_to(sums, a, fma(by_w, wx, by_c * x))
    add_to(sums, a + LANES, fma(by_w, wy, by_c * y))
    add_to(sums, a + 2 * LANES, fma(by_w, wz, by_c * z))


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
                p = 3 * (start + j)
                nx, ny, nz = n[p], n[p + 1], n[p + 2]
                n_w = cosine(geometry, o, nx, ny, nz)
                if not anywhere(n_w > 0.0):
                    continue
                x, y, z = half_offset(geometry, o, nx, ny, nz)
                log_c = peak_cosine(x, y, z)[1]
                nearest = lane_max(log_c)
                f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
                seen = False
                for s in range(3):
                    if nearest * least[3 * block + s] > cut[block]:
                        t = LOBES_STRIDE * block + LOBE_STRIDE * s
                        seen = True
                        f0 = f0 + lobe(lobes, t, log_c)
                        f1 = f1 + lobe(lobes, t + CHANNEL_STRIDE, log_c)
                        f2 = f2 + lobe(lobes, t + 2 * CHANNEL_STRIDE, log_c)
                if seen:
                    n_w = maximum(n_w, 0.0)
                    a = ENERGY_STRIDE * j
                    add_to(scratch, a, f0 * n_w * load(energy, e))
                    add_to(scratch, a + LANES, f1 * n_w * load(energy, e + LANES))
                    add_to(scratch, a + 2 * LANES, f2 * n_w * load(energy, e + 2 * LANES))
        write_sums(scratch, 0, 3 * count, radiance, 3 * start)


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
        block_first, block_last = (
            chunk * blocks // LIGHT_CHUNKS,
            (chunk + 1) * blocks // LIGHT_CHUNKS,
        )
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
                    nx, ny, nz = n[p], n[p + 1], n[p + 2]
                    n_w = cosine(geometry, o, nx, ny, nz)
                    visible = n_w > 0.0
                    if not anywhere(visible):
                        continue
                    x, y, z = half_offset(geometry, o, nx, ny, nz)
                    c, log_c = peak_cosine(x, y, z)
                    nearest = lane_max(log_c)
                    n_w = maximum(n_w, 0.0)
                    g0, g1, g2 = g[p], g[p + 1], g[p + 2]
                    w0, w1, w2 = n_w * g0, n_w * g1, n_w * g2
                    f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
                    d0, d1, d2 = splat(0.0), splat(0.0), splat(0.0)
                    seen = False
                    for s in range(3):
                        if nearest * least[3 * block + s] > cut[block]:
                            t = LOBES_STRIDE * block + LOBE_STRIDE * s
                            seen = True
                            f0, d0 = lobe_backward(lobes, t, log_c, w0, lobe_sums, t, f0, d0)
                            t += CHANNEL_STRIDE
                            f1, d1 = lobe_backward(lobes, t, log_c, w1, lobe_sums, t, f1, d1)
                            t += CHANNEL_STRIDE
                            f2, d2 = lobe_backward(lobes, t, log_c, w2, lobe_sums, t, f2, d2)
                    if not seen:
                        continue
                    add_to(energy_sums, e, f0 * w0)
                    add_to(energy_sums, e + LANES, f1 * w1)
                    add_to(energy_sums, e + 2 * LANES, f2 * w2)
                    f, slope, by_radiance = (f0, f1, f2), (d0, d1, d2), (g0, g1, g2)
                    a, offset = sums + ENERGY_STRIDE * j, (x, y, z)
                    add_by_n(
                        scratch, a, geometry, o, energy, e, n_w, visible, c, offset,
                        f, slope, by_radiance,
                    )  # fmt: skip
            write_sums(scratch, sums, 3 * count, n_part, 3 * (chunk * pixels + start))
