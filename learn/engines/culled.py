"""Kernels for a distant viewer that sum, for each tile of normals, only the lights near its lobes.

Letters, arrays and formulas as in learn.engines.distant; pixels are sorted so that a tile's normals
are close together. Besides:
cones     (wide blocks, CONE_ROWS, 16), one lane a block of lights: the cones that hold its w and
          its h (axis, cos and sin of the half angle), its energy in the brightest channel, and of
          each lobe the least γ and the largest κ log2 e
many      lobes that are summed, 1 to 3: lobes (blocks, many, 3, 2, 16) holds no others; the cones'
          rows and the cuts know the first `many`
size      pixels of a tile, CULLED_TILE at most
budget    (1,) radiance that may be left out of any pixel
room      entries that the list of one tile may have; one for each block of lights is always enough
lengths   (T,) int32: how many entries a tile has
entries   (T, room) int32: block numbers
cuts      (T, room, 4): log2 c at or below which a lobe is left out of a block; the least n·axis,
          axis that of the block's cone about h, at which a pixel can have any lobe's c above that
axes      (blocks, 3): these axes

For a block, Σ_s expm1(κ c^γ) max(0, n·w) E ≤ its value at the largest c and n·w that the two cones
allow. What is skipped sums to at most `budget` a pixel and channel: a threshold on that bound is
lowered until it does. The entries of a list are tested again for each pixel, sixteen pixels at once
by the block's cone and then one by one, against the log2 c at which the bound meets the threshold.
The kernels' many parameters are the price of a call by address: it passes integers and pointers.
"""

import math
from collections.abc import Callable
from typing import cast

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import (
    LEAST_COSINE,
    add_by_n,
    add_to,
    clear,
    cosine,
    half_offset,
    lobe,
    lobe_backward,
    peak_cosine,
    write_sums,
)
from learn.engines.exponentials import LOWEST, exp2, exp2m1, log2
from learn.engines.layout import (
    CHANNEL_STRIDE,
    CONE_ENERGY,
    CONE_GAMMA,
    CONE_H_COS,
    CONE_H_SIN,
    CONE_H_X,
    CONE_KAPPA,
    CONE_STRIDE,
    CONE_W_COS,
    CONE_W_SIN,
    CONE_W_X,
    CULLED_SCRATCH,
    CULLED_TILE,
    CUT_REACH,
    CUTS,
    DISTANT_STRIDE,
    ENERGY_STRIDE,
    LANES,
    LOBE_STRIDE,
    SELECT_BOUND,
    SELECT_REACH,
    SELECT_ROWS,
    SELECT_STRIDE,
    SELECT_WEIGHT,
)
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    anywhere,
    bits,
    fma,
    lane_max,
    lane_sum,
    load,
    lowest_bit,
    maximum,
    minimum,
    splat,
    sqrt,
    store,
)
from learn.engines.vector import select as choose

LARGEST = 72.13475  # MAX_EXPONENT log2 e
NEVER, ALWAYS = 1.0, -1e30  # as a cut: above and below any log2 c
WIDENED = 1e-4  # radians by which the cone of a tile's normals is widened against rounding
SLACK = 2e-6  # on cosines, for rounding
single = cast("Callable[[float], float]", types.float32)  # a conversion, in a kernel
LEAST_LOG = math.log2(LEAST_COSINE)
INT_POINTER = types.CPointer(types.int32)

SELECT = types.void(*[types.int64] * 7, *[FLOAT_POINTER] * 5, *[INT_POINTER] * 2)
FORWARD = types.void(*[types.int64] * 6, *[FLOAT_POINTER] * 8, *[INT_POINTER] * 2)
BACKWARD = types.void(*[types.int64] * 10, *[FLOAT_POINTER] * 11, *[INT_POINTER] * 2)


@inlined
def nearest_cosine(axis: Lanes, cos_a: Lanes, sin_a: Lanes, cos_b: Lanes, sin_b: Lanes) -> Lanes:
    """Largest cosine between a vector of one cone and one of the other.

    axis  cosine between their axes
    Half angles (in [0, π]) that sum to π or more leave no gap between the cones. There the cosine
    of the sum is no bound: beyond π it rises again. a + b ≥ π where cos a ≤ cos(π − b) = −cos b.
    """
    cos_sum, sin_sum = cos_a * cos_b - sin_a * sin_b, sin_a * cos_b + cos_a * sin_b
    nearest = fma(axis, cos_sum, sqrt(maximum(1.0 - axis * axis, 0.0)) * sin_sum)
    nearest = choose(axis > cos_sum, 1.0, minimum(nearest + SLACK, 1.0))
    return choose(cos_a + cos_b > 0.0, nearest, 1.0)


@inlined
def least_cosine(log_c: Lanes, cos_b: Lanes, sin_b: Lanes) -> Lanes:
    """Least cosine with a cone's axis of a vector within arccos c of one in the cone.

    log_c  log2 c; b: half angle of the cone
    """
    one_minus_c = 0.0 - exp2m1(maximum(log_c, LOWEST))
    c, sine = 1.0 - one_minus_c, sqrt(maximum(one_minus_c * (2.0 - one_minus_c), 0.0))
    whole = fma(sine, cos_b, c * sin_b) < 0.0  # the sum of the angles is beyond π
    least = choose(whole, ALWAYS, c * cos_b - sine * sin_b - SLACK)
    # c is held at LEAST_COSINE: every vector has a c above such a cut
    return choose(log_c > LEAST_LOG, least, ALWAYS)


@inlined
def cut_at(threshold: float, weight: Lanes, gamma: Lanes, kappa: Lanes) -> Lanes:
    """The log2 c at which weight · (2^(κ c^γ) − 1) meets the threshold; κ: κ log2 e."""
    share = threshold / maximum(weight, 1e-30)
    inverse = 1.0 / (1.0 + share)  # log2 takes numbers up to 1
    bits = 0.0 - log2(maximum(inverse, 1e-30), share * inverse)
    height = minimum(bits / maximum(kappa, 1e-30), 1.0)
    cut = log2(maximum(height, 1e-30), 1.0 - height) / gamma
    return choose(threshold * splat(1.0) > 0.0, cut, ALWAYS)


@inlined
def along_axis(cones: np.ndarray, o: int, x: float, y: float, z: float) -> Lanes:
    """Cosines of a direction with sixteen axes, whose three rows begin at offset o."""
    return fma(load(cones, o), x, fma(load(cones, o + LANES), y, load(cones, o + 2 * LANES) * z))


@inlined
def unpack(n: np.ndarray, start: int, count: int, scratch: np.ndarray, o: int) -> None:
    """Write a tile's normals as three rows behind its sums, which begin at offset o.

    They are 0 beyond `count`.
    """
    for j in range(CULLED_TILE):
        for i in range(3):
            scratch[o + ENERGY_STRIDE * CULLED_TILE + CULLED_TILE * i + j] = (
                n[3 * (start + j) + i] if j < count else types.float32(0.0)
            )


@inlined
def pixels_near(
    scratch: np.ndarray, o: int, count: int, axes: np.ndarray, block: int, reach: float
) -> int:
    """Which of sixteen pixels (at most `count`) a block can matter to, as bits.

    o  offset of their normals
    """
    x, y, z = load(scratch, o), load(scratch, o + CULLED_TILE), load(scratch, o + 2 * CULLED_TILE)
    axis = fma(x, axes[3 * block], fma(y, axes[3 * block + 1], z * axes[3 * block + 2]))
    return bits(axis > reach) & ((1 << min(LANES, count)) - 1)


@inlined
def cone_about(n: np.ndarray, start: int, count: int) -> tuple[float, float, float, float, float]:
    """Axis, cosine and sine of the half angle of a cone about `count` normals, slightly widened."""
    x, y, z = 0.0, 0.0, 0.0
    for p in range(start, start + count):
        x, y, z = x + n[3 * p], y + n[3 * p + 1], z + n[3 * p + 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-6:  # normals that cancel: the whole sphere
        return single(0.0), single(0.0), single(1.0), single(-1.0), single(0.0)
    x, y, z, least = x / length, y / length, z / length, 1.0
    for p in range(start, start + count):
        least = min(least, x * n[3 * p] + y * n[3 * p + 1] + z * n[3 * p + 2])
    sine = math.sqrt(max(1.0 - least * least, 0.0))
    wider, further = least - WIDENED * sine, sine + WIDENED * least
    if wider < -1.0 or further < 0.0:
        wider, further = -1.0, 0.0
    return single(x), single(y), single(z), single(wider), single(further)


def select(
    first: int,
    last: int,
    pixels: int,
    size: int,
    wide_blocks: int,
    room: int,
    many: int,
    budget: np.ndarray,
    n: np.ndarray,
    cones: np.ndarray,
    scratch: np.ndarray,
    cuts: np.ndarray,
    lengths: np.ndarray,
    entries: np.ndarray,
) -> None:
    """The list of each tile first … last − 1; scratch holds 6 · wide_blocks · 16 floats."""
    for tile in range(first, last):
        nx, ny, nz, cos_n, sin_n = cone_about(n, tile * size, min(size, pixels - tile * size))
        for wide_block in range(wide_blocks):
            o, b = CONE_STRIDE * wide_block, SELECT_STRIDE * wide_block
            axis = along_axis(cones, o + LANES * CONE_W_X, nx, ny, nz)
            cos_w, sin_w = load(cones, o + LANES * CONE_W_COS), load(cones, o + LANES * CONE_W_SIN)
            n_w = nearest_cosine(axis, cos_w, sin_w, cos_n, sin_n)
            if not anywhere(n_w > 0.0):
                clear(scratch, b, SELECT_ROWS)
                continue
            axis = along_axis(cones, o + LANES * CONE_H_X, nx, ny, nz)
            cos_h, sin_h = load(cones, o + LANES * CONE_H_COS), load(cones, o + LANES * CONE_H_SIN)
            c = maximum(nearest_cosine(axis, cos_h, sin_h, cos_n, sin_n), 1e-12)
            log_c = log2(c, 1.0 - c)
            weight = maximum(n_w, 0.0) * load(cones, o + LANES * CONE_ENERGY)
            for s in range(many):
                gamma = load(cones, o + LANES * (CONE_GAMMA + s))
                kappa = load(cones, o + LANES * (CONE_KAPPA + s))
                exponent = kappa * exp2(gamma * log_c)
                bound = weight * exp2m1(minimum(exponent, LARGEST))
                store(scratch, b + LANES * (SELECT_BOUND + s), bound)
                store(scratch, b + LANES * (SELECT_WEIGHT + s), weight)
        threshold = 0.125 * budget[0]
        for _ in range(12):
            skipped = splat(0.0)
            for wide_block in range(wide_blocks):
                for s in range(many):
                    bound = load(scratch, SELECT_STRIDE * wide_block + LANES * (SELECT_BOUND + s))
                    skipped = skipped + minimum(bound, threshold)
            if lane_sum(skipped) <= budget[0]:
                break
            threshold *= 0.25
        count = 0
        for wide_block in range(wide_blocks):
            o, b = CONE_STRIDE * wide_block, SELECT_STRIDE * wide_block
            highest = load(scratch, b + LANES * SELECT_BOUND)
            for s in range(1, many):
                highest = maximum(highest, load(scratch, b + LANES * (SELECT_BOUND + s)))
            if not anywhere(highest > threshold):
                continue
            reach = splat(NEVER)
            cos_h, sin_h = load(cones, o + LANES * CONE_H_COS), load(cones, o + LANES * CONE_H_SIN)
            for s in range(many):
                gamma = load(cones, o + LANES * (CONE_GAMMA + s))
                kappa = load(cones, o + LANES * (CONE_KAPPA + s))
                weight = load(scratch, b + LANES * (SELECT_WEIGHT + s))
                cut = cut_at(threshold, weight, gamma, kappa)
                above = load(scratch, b + LANES * (SELECT_BOUND + s)) > threshold
                store(scratch, b + LANES * (SELECT_WEIGHT + s), choose(above, cut, NEVER))
                reach = minimum(reach, choose(above, least_cosine(cut, cos_h, sin_h), NEVER))
            store(scratch, b + LANES * SELECT_REACH, reach)
            for lane in range(LANES):
                block, q = LANES * wide_block + lane, b + LANES * SELECT_WEIGHT + lane
                entry, listed = room * tile + count, False
                for s in range(many):
                    listed = listed or scratch[q + LANES * s] < NEVER
                if block < room and listed:
                    entries[entry] = block
                    for s in range(many):
                        cuts[CUTS * entry + s] = scratch[q + LANES * s]
                    cuts[CUTS * entry + CUT_REACH] = scratch[b + LANES * SELECT_REACH + lane]
                    count += 1
        lengths[tile] = count


def forward(
    first: int,
    last: int,
    pixels: int,
    size: int,
    room: int,
    many: int,
    n: np.ndarray,
    axes: np.ndarray,
    geometry: np.ndarray,
    energy: np.ndarray,
    lobes: np.ndarray,
    scratch: np.ndarray,
    radiance: np.ndarray,
    cuts: np.ndarray,
    lengths: np.ndarray,
    entries: np.ndarray,
) -> None:
    """Radiance (P, 3) of pixel tiles first … last − 1; scratch holds CULLED_SCRATCH floats."""
    for tile in range(first, last):
        start = tile * size
        count = min(size, pixels - start)
        clear(scratch, 0, 3 * count)
        unpack(n, start, count, scratch, 0)
        for i in range(room * tile, room * tile + lengths[tile]):
            block = entries[i]
            o, e = DISTANT_STRIDE * block, ENERGY_STRIDE * block
            for group in range(0, count, LANES):
                normals = ENERGY_STRIDE * CULLED_TILE + group
                reach = cuts[CUTS * i + CUT_REACH]
                near = pixels_near(scratch, normals, count - group, axes, block, reach)
                while near:
                    j = group + lowest_bit(near)
                    near &= near - 1
                    p = 3 * (start + j)
                    nx, ny, nz = n[p], n[p + 1], n[p + 2]
                    n_w = cosine(geometry, o, nx, ny, nz)
                    if not anywhere(n_w > 0.0):
                        continue
                    x, y, z = half_offset(geometry, o, nx, ny, nz)
                    log_c = peak_cosine(x, y, z)[1]
                    nearest, seen = lane_max(log_c), False
                    f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
                    for s in range(many):
                        if nearest > cuts[CUTS * i + s]:
                            seen = True
                            t = LOBE_STRIDE * (many * block + s)
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
    n: np.ndarray,
    axes: np.ndarray,
    geometry: np.ndarray,
    energy: np.ndarray,
    lobes: np.ndarray,
    scratch: np.ndarray,
    g: np.ndarray,
    by_n: np.ndarray,
    energy_sums: np.ndarray,
    lobe_sums: np.ndarray,
    cuts: np.ndarray,
    lengths: np.ndarray,
    entries: np.ndarray,
) -> None:
    """Derivatives of Σ g·I from the pixels of tile chunks first … last − 1.

    Values of the forward pass are computed again.

    scratch      (chunks, CULLED_SCRATCH)
    with_n       0: by_n is not written
    by_n         (P, 3) out, tangential up to a radial part
    energy_sums  (chunks, blocks, 3, 16) out: Σ_p g F max(0, n·w)
    lobe_sums    (chunks, blocks, many, 3, 2, 16) out: Σ_p g max(0, n·w) x c^γ, and the same times
                 log2 c
    """
    for chunk in range(first, last):
        base_e, base_l = ENERGY_STRIDE * blocks * chunk, LOBE_STRIDE * many * blocks * chunk
        sums = CULLED_SCRATCH * chunk
        clear(energy_sums, base_e, 3 * blocks)
        clear(lobe_sums, base_l, LOBE_STRIDE // LANES * many * blocks)
        for tile in range(chunk * tiles // chunks, (chunk + 1) * tiles // chunks):
            start = tile * size
            count = min(size, pixels - start)
            clear(scratch, sums, 3 * count)
            unpack(n, start, count, scratch, sums)
            for i in range(room * tile, room * tile + lengths[tile]):
                block = entries[i]
                o, e = DISTANT_STRIDE * block, ENERGY_STRIDE * block
                for group in range(0, count, LANES):
                    normals = sums + ENERGY_STRIDE * CULLED_TILE + group
                    reach = cuts[CUTS * i + CUT_REACH]
                    near = pixels_near(scratch, normals, count - group, axes, block, reach)
                    while near:
                        j = group + lowest_bit(near)
                        near &= near - 1
                        p = 3 * (start + j)
                        nx, ny, nz = n[p], n[p + 1], n[p + 2]
                        n_w = cosine(geometry, o, nx, ny, nz)
                        visible = n_w > 0.0
                        if not anywhere(visible):
                            continue
                        x, y, z = half_offset(geometry, o, nx, ny, nz)
                        c, log_c = peak_cosine(x, y, z)
                        nearest, seen = lane_max(log_c), False
                        n_w = maximum(n_w, 0.0)
                        g0, g1, g2 = g[p], g[p + 1], g[p + 2]
                        w0, w1, w2 = n_w * g0, n_w * g1, n_w * g2
                        f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
                        d0, d1, d2 = splat(0.0), splat(0.0), splat(0.0)
                        for s in range(many):
                            if nearest > cuts[CUTS * i + s]:
                                seen = True
                                t = LOBE_STRIDE * (many * block + s)
                                q = base_l + t
                                f0, d0 = lobe_backward(lobes, t, log_c, w0, lobe_sums, q, f0, d0)
                                t, q = t + CHANNEL_STRIDE, q + CHANNEL_STRIDE
                                f1, d1 = lobe_backward(lobes, t, log_c, w1, lobe_sums, q, f1, d1)
                                t, q = t + CHANNEL_STRIDE, q + CHANNEL_STRIDE
                                f2, d2 = lobe_backward(lobes, t, log_c, w2, lobe_sums, q, f2, d2)
                        if not seen:
                            continue
                        add_to(energy_sums, base_e + e, f0 * w0)
                        add_to(energy_sums, base_e + e + LANES, f1 * w1)
                        add_to(energy_sums, base_e + e + 2 * LANES, f2 * w2)
                        if with_n:
                            f, slope, by_radiance = (f0, f1, f2), (d0, d1, d2), (g0, g1, g2)
                            a, offset = sums + ENERGY_STRIDE * j, (x, y, z)
                            add_by_n(
                                scratch, a, geometry, o, energy, e, n_w, visible, c, offset,
                                f, slope, by_radiance,
                            )  # fmt: skip
            write_sums(scratch, sums, 3 * count * with_n, by_n, 3 * start)
