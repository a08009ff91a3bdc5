"""Kernels for a distant viewer that skip what cannot matter: for each tile of like normals, only
the blocks of lights near its lobes.

Letters, arrays and formulas as in learn.engines.distant; pixels are sorted so that a tile's normals
are close together. Besides:
cones     (wide blocks, CONE_ROWS, 16), one lane a block of lights: the cones that hold its w and
its h (axis, cos and sin of the half
          angle), its energy in the brightest channel, and of each lobe the least γ and the largest
          κ log2 e
many      lobes that are summed, 1 to 3: lobes (blocks, many, 3, 2, 16) holds no others; the cones'
rows and the cuts know the first `many`
size      pixels of a tile, TILE at most
budget    (1,) radiance that may be left out of any pixel
room      entries that the list of one tile may have; one for each block of lights is always enough
lengths   (T,) int32: how many entries a tile has
entries   (T, room) int32: block numbers
cuts      (T, room, 4): log2 c at or below which a lobe is left out of a block; the least n·axis,
axis that of the block's cone about h,
          at which a pixel can have any lobe's c above that
axes      (blocks, 3): these axes

For a block, Σ_s expm1(κ c^γ) max(0, n·w) E ≤ its value at the largest c and n·w that the two cones
allow. What is skipped sums to at most `budget` a pixel and channel: a threshold on that bound is
lowered until it does. What a list still holds is tested again pixel by pixel, sixteen pixels at
once by the block's cone and then one by one, against the log2 c at which the bound meets the
threshold.
"""

import math

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
from learn.engines.vector import (
    FLOAT_POINTER,
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

TILE = 64  # pixels of one list at most
SCRATCH = 51 * TILE  # floats: a tile's sums (TILE, 3, 16) and its normals (3, TILE)
CHUNKS = 4  # of tiles at most, in the backward pass: the most threads it can use
CONE_ROWS = 17
LARGEST = 72.13475  # MAX_EXPONENT log2 e
NEVER, ALWAYS = 1.0, -1e30  # as a cut: above and below any log2 c
WIDENED = 1e-4  # radians by which the cone of a tile's normals is widened against rounding
SLACK = 2e-6  # on cosines, for rounding
LEAST_LOG = math.log2(LEAST_COSINE)
INT_POINTER = types.CPointer(types.int32)

SELECT = types.void(*[types.int64] * 7, *[FLOAT_POINTER] * 5, *[INT_POINTER] * 2)
FORWARD = types.void(*[types.int64] * 6, *[FLOAT_POINTER] * 8, *[INT_POINTER] * 2)
BACKWARD = types.void(*[types.int64] * 10, *[FLOAT_POINTER] * 11, *[INT_POINTER] * 2)


@inlined
def nearest_cosine(axis, cos_a, sin_a, cos_b, sin_b):
    """Largest cosine between a vector of one cone and one of the other, whose axes have the cosine
    `axis`.

    Half angles (in [0, π]) that sum to π or more leave no room between the cones. There the cosine
    of the sum says nothing: beyond π it rises again. a + b ≥ π where cos a ≤ cos(π − b) = −cos b.
    """
    cos_sum, sin_sum = cos_a * cos_b - sin_a * sin_b, sin_a * cos_b + cos_a * sin_b
    apart = fma(axis, cos_sum, sqrt(maximum(1.0 - axis * axis, 0.0)) * sin_sum)
    apart = choose(axis > cos_sum, 1.0, minimum(apart + SLACK, 1.0))
    return choose(cos_a + cos_b > 0.0, apart, 1.0)


@inlined
def least_cosine(log_c, cos_b, sin_b):
    """The least cosine with the axis of a cone (half angle b) of a vector that is within arccos c
    of one in the cone; log2 c given.
    """
    one_minus_c = 0.0 - exp2m1(maximum(log_c, LOWEST))
    c, sine = 1.0 - one_minus_c, sqrt(maximum(one_minus_c * (2.0 - one_minus_c), 0.0))
    whole = fma(sine, cos_b, c * sin_b) < 0.0  # the sum of the angles is beyond π
    least = choose(whole, ALWAYS, c * cos_b - sine * sin_b - SLACK)
    # c is held at LEAST_COSINE: every vector has a c above such a cut
    return choose(log_c > LEAST_LOG, least, ALWAYS)


@inlined
def unpack(n, start, count, scratch, o):
    """The normals of a tile as three rows behind its sums, which begin at offset o; 0 beyond their
    count.
    """
    for j in range(TILE):
        for i in range(3):
            scratch[o + 48 * TILE + TILE * i + j] = (
                n[3 * (start + j) + i] if j < count else types.float32(0.0)
            )


@inlined
def pixels_near(scratch, o, count, axes, block, reach):
    """Which of sixteen pixels (at most `count`), whose normals lie at offset o, a block can matter
    to, as bits.
    """
    x, y, z = load(scratch, o), load(scratch, o + TILE), load(scratch, o + 2 * TILE)
    axis = fma(x, axes[3 * block], fma(y, axes[3 * block + 1], z * axes[3 * block + 2]))
    return bits(axis > reach) & ((1 << min(16, count)) - 1)


@inlined
def cone_about(n, start, count):
    """Axis, cos and sin of the half angle of a cone that holds the normals start … start + count −
    1, a little widened.
    """
    x, y, z = 0.0, 0.0, 0.0
    for p in range(start, start + count):
        x, y, z = x + n[3 * p], y + n[3 * p + 1], z + n[3 * p + 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-6:  # normals that cancel: the whole sphere
        return (
            types.float32(0.0),
            types.float32(0.0),
            types.float32(1.0),
            types.float32(-1.0),
            types.float32(0.0),
        )
    x, y, z, least = x / length, y / length, z / length, 1.0
    for p in range(start, start + count):
        least = min(least, x * n[3 * p] + y * n[3 * p + 1] + z * n[3 * p + 2])
    sine = math.sqrt(max(1.0 - least * least, 0.0))
    wider, further = least - WIDENED * sine, sine + WIDENED * least
    if wider < -1.0 or further < 0.0:
        wider, further = -1.0, 0.0
    return (
        types.float32(x),
        types.float32(y),
        types.float32(z),
        types.float32(wider),
        types.float32(further),
    )


def select(
    first,
    last,
    pixels,
    size,
    wide_blocks,
    room,
    many,
    budget,
    n,
    cones,
    scratch,
    cuts,
    lengths,
    entries,
):
    """The list of each tile first … last − 1; scratch holds 6 · wide_blocks · 16 floats."""
    for tile in range(first, last):
        nx, ny, nz, cos_n, sin_n = cone_about(n, tile * size, min(size, pixels - tile * size))
        for wide_block in range(wide_blocks):
            o, b = 16 * CONE_ROWS * wide_block, 96 * wide_block
            axis = fma(load(cones, o), nx, fma(load(cones, o + 16), ny, load(cones, o + 32) * nz))
            n_w = nearest_cosine(axis, load(cones, o + 48), load(cones, o + 64), cos_n, sin_n)
            if not anywhere(n_w > 0.0):
                clear(scratch, b, 6)
                continue
            axis = fma(
                load(cones, o + 80), nx, fma(load(cones, o + 96), ny, load(cones, o + 112) * nz)
            )
            c = maximum(
                nearest_cosine(axis, load(cones, o + 128), load(cones, o + 144), cos_n, sin_n),
                1e-12,
            )
            log_c = log2(c, 1.0 - c)
            weight = maximum(n_w, 0.0) * load(cones, o + 160)
            for s in range(many):
                exponent = load(cones, o + 224 + 16 * s) * exp2(
                    load(cones, o + 176 + 16 * s) * log_c
                )
                store(scratch, b + 16 * s, weight * exp2m1(minimum(exponent, LARGEST)))
                store(scratch, b + 48 + 16 * s, weight)
        threshold = 0.125 * budget[0]
        for _ in range(12):
            skipped = splat(0.0)
            for wide_block in range(wide_blocks):
                for s in range(many):
                    skipped = skipped + minimum(load(scratch, 96 * wide_block + 16 * s), threshold)
            if lane_sum(skipped) <= budget[0]:
                break
            threshold *= 0.25
        count = 0
        for wide_block in range(wide_blocks):
            o, b = 16 * CONE_ROWS * wide_block, 96 * wide_block
            highest = load(scratch, b)
            for s in range(1, many):
                highest = maximum(highest, load(scratch, b + 16 * s))
            if not anywhere(highest > threshold):
                continue
            reach = splat(NEVER)
            # the log2 c at which weight · (2^(κ c^γ) − 1) meets the threshold
            for s in range(many):
                share = threshold / maximum(load(scratch, b + 48 + 16 * s), 1e-30)
                inverse = 1.0 / (1.0 + share)  # log2 takes numbers up to 1
                bits = 0.0 - log2(maximum(inverse, 1e-30), share * inverse)
                height = minimum(bits / maximum(load(cones, o + 224 + 16 * s), 1e-30), 1.0)
                cut = log2(maximum(height, 1e-30), 1.0 - height) / load(cones, o + 176 + 16 * s)
                cut = choose(threshold * splat(1.0) > 0.0, cut, ALWAYS)
                requested = load(scratch, b + 16 * s) > threshold
                store(scratch, b + 48 + 16 * s, choose(requested, cut, NEVER))
                reach = minimum(
                    reach,
                    choose(
                        requested,
                        least_cosine(cut, load(cones, o + 128), load(cones, o + 144)),
                        NEVER,
                    ),
                )
            store(scratch, b, reach)
            for lane in range(16):
                block, q = 16 * wide_block + lane, 96 * wide_block + 48 + lane
                entry, listed = room * tile + count, False
                for s in range(many):
                    listed = listed or scratch[q + 16 * s] < NEVER
                if block < room and listed:
                    entries[entry] = block
                    for s in range(many):
                        cuts[4 * entry + s] = scratch[q + 16 * s]
                    cuts[4 * entry + 3] = scratch[b + lane]
                    count += 1
        lengths[tile] = count


def forward(
    first,
    last,
    pixels,
    size,
    room,
    many,
    n,
    axes,
    geometry,
    energy,
    lobes,
    scratch,
    radiance,
    cuts,
    lengths,
    entries,
):
    """Radiance (P, 3) of pixel tiles first … last − 1; scratch holds SCRATCH floats."""
    for tile in range(first, last):
        start = tile * size
        count = min(size, pixels - start)
        clear(scratch, 0, 3 * count)
        unpack(n, start, count, scratch, 0)
        for i in range(room * tile, room * tile + lengths[tile]):
            block = entries[i]
            g, e = 144 * block, 48 * block
            for group in range(0, count, 16):
                near = pixels_near(
                    scratch, 48 * TILE + group, count - group, axes, block, cuts[4 * i + 3]
                )
                while near:
                    j = group + lowest_bit(near)
                    near &= near - 1
                    p = 3 * (start + j)
                    nx, ny, nz = n[p], n[p + 1], n[p + 2]
                    n_w = cosine(geometry, g, nx, ny, nz)
                    if not anywhere(n_w > 0.0):
                        continue
                    x, y, z = half_offset(geometry, g, nx, ny, nz)
                    log_c = peak_cosine(x, y, z)[1]
                    nearest, seen = lane_max(log_c), False
                    f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
                    for s in range(many):
                        if nearest > cuts[4 * i + s]:
                            seen = True
                            o = 96 * (many * block + s)
                            f0 = f0 + lobe(lobes, o, log_c)
                            f1 = f1 + lobe(lobes, o + 32, log_c)
                            f2 = f2 + lobe(lobes, o + 64, log_c)
                    if seen:
                        n_w = maximum(n_w, 0.0)
                        a = 48 * j
                        add_to(scratch, a, f0 * n_w * load(energy, e))
                        add_to(scratch, a + 16, f1 * n_w * load(energy, e + 16))
                        add_to(scratch, a + 32, f2 * n_w * load(energy, e + 32))
        write_sums(scratch, 0, 3 * count, radiance, 3 * start)


def backward(
    first,
    last,
    pixels,
    size,
    tiles,
    blocks,
    room,
    many,
    chunks,
    with_n,
    n,
    axes,
    geometry,
    energy,
    lobes,
    scratch,
    g,
    by_n,
    energy_sums,
    lobe_sums,
    cuts,
    lengths,
    entries,
):
    """Derivatives of Σ g·I from the pixels of tile chunks first … last − 1; what the forward pass
    knew is computed again.

    scratch      (chunks, SCRATCH)
    with_n       0 if by_n is not wanted
    by_n         (P, 3) out, tangential up to a radial part
    energy_sums  (chunks, blocks, 3, 16) out: Σ_p g F max(0, n·w)
    lobe_sums    (chunks, blocks, many, 3, 2, 16) out: Σ_p g max(0, n·w) x c^γ, and the same times
    log2 c
    """
    for chunk in range(first, last):
        base_e, base_l, sums = 48 * blocks * chunk, 96 * many * blocks * chunk, SCRATCH * chunk
        clear(energy_sums, base_e, 3 * blocks)
        clear(lobe_sums, base_l, 6 * many * blocks)
        for tile in range(chunk * tiles // chunks, (chunk + 1) * tiles // chunks):
            start = tile * size
            count = min(size, pixels - start)
            clear(scratch, sums, 3 * count)
            unpack(n, start, count, scratch, sums)
            for i in range(room * tile, room * tile + lengths[tile]):
                block = entries[i]
                o = 144 * block
                for group in range(0, count, 16):
                    near = pixels_near(
                        scratch,
                        sums + 48 * TILE + group,
                        count - group,
                        axes,
                        block,
                        cuts[4 * i + 3],
                    )
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
                            if nearest > cuts[4 * i + s]:
                                seen = True
                                t = 96 * (many * block + s)
                                q = base_l + t
                                f0, d0 = lobe_backward(lobes, t, log_c, w0, lobe_sums, q, f0, d0)
                                f1, d1 = lobe_backward(
                                    lobes, t + 32, log_c, w1, lobe_sums, q + 32, f1, d1
                                )
                                f2, d2 = lobe_backward(
                                    lobes, t + 64, log_c, w2, lobe_sums, q + 64, f2, d2
                                )
                        if not seen:
                            continue
                        e = base_e + 48 * block
                        add_to(energy_sums, e, f0 * w0)
                        add_to(energy_sums, e + 16, f1 * w1)
                        add_to(energy_sums, e + 32, f2 * w2)
                        if with_n:
                            a, e = sums + 48 * j, 48 * block
                            add_by_n(
                                scratch,
                                a,
                                geometry,
                                o,
                                energy,
                                e,
                                visible,
                                f0,
                                f1,
                                f2,
                                d0,
                                d1,
                                d2,
                                g0,
                                g1,
                                g2,
                                n_w,
                                c,
                                x,
                                y,
                                z,
                            )
            write_sums(scratch, sums, 3 * count * with_n, by_n, 3 * start)
