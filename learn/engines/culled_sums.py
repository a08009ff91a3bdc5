"""Kernels that sum the lights of each tile's list for a distant viewer, forward and backward.

Letters, arrays and formulas as in learn.engines.distant and in learn.engines.culled_lists, which
makes the lists. Their entries are tested again for each pixel: sixteen pixels at once by the
block's cone, and then one by one against the log2 c at which the bound meets the threshold.
"""

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import (
    add_by_n,
    add_radiance,
    cosine,
    facing,
    half_offset,
    peak_cosine,
    reflectance,
    reflectance_backward,
    w_of,
)
from learn.engines.layout import (
    CULLED_SCRATCH,
    CULLED_TILE,
    CUT_REACH,
    CUTS,
    DISTANT_STRIDE,
    ENERGY_STRIDE,
    LANES,
    LOBE_STRIDE,
)
from learn.engines.triples import add_vector, clear, product, vector_at, write_sums
from learn.engines.vector import (
    FLOAT_POINTER,
    INT_POINTER,
    anywhere,
    bits,
    fma,
    lane_max,
    load,
    lowest_bit,
    splat,
)

FORWARD = types.void(*[types.int64] * 6, *[FLOAT_POINTER] * 8, *[INT_POINTER] * 2)
BACKWARD = types.void(*[types.int64] * 10, *[FLOAT_POINTER] * 11, *[INT_POINTER] * 2)


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
                    normal = vector_at(n, 3 * (start + j))
                    n_w = cosine(geometry, o, normal)
                    if not anywhere(n_w > 0.0):
                        continue
                    log_c = peak_cosine(half_offset(geometry, o, normal))[1]
                    nearest, seen = lane_max(log_c), False
                    f = splat(0.0), splat(0.0), splat(0.0)
                    for s in range(many):
                        if nearest > cuts[CUTS * i + s]:
                            seen = True
                            f = reflectance(lobes, LOBE_STRIDE * (many * block + s), log_c, f)
                    if seen:
                        add_radiance(scratch, ENERGY_STRIDE * j, f, n_w, energy, e)
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
                        normal = vector_at(n, p)
                        n_w = cosine(geometry, o, normal)
                        visible = n_w > 0.0
                        if not anywhere(visible):
                            continue
                        pixel = facing(geometry, o, normal, n_w, visible, vector_at(g, p))
                        nearest, seen = lane_max(pixel.log_c), False
                        f = splat(0.0), splat(0.0), splat(0.0)
                        slope = splat(0.0), splat(0.0), splat(0.0)
                        for s in range(many):
                            if nearest > cuts[CUTS * i + s]:
                                seen, t = True, LOBE_STRIDE * (many * block + s)
                                to = base_l + t
                                f, slope = reflectance_backward(
                                    lobes, t, pixel.log_c, pixel.weight, lobe_sums, to, f, slope
                                )
                        if not seen:
                            continue
                        add_vector(energy_sums, base_e + e, product(f, pixel.weight))
                        if with_n:
                            at, w = sums + ENERGY_STRIDE * j, w_of(geometry, o)
                            add_by_n(scratch, at, w, energy, e, pixel, f, slope)
            write_sums(scratch, sums, 3 * count * with_n, by_n, 3 * start)
