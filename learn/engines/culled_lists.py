"""The kernel that lists, for each tile of normals, the lights near its lobes; for a distant viewer.

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
lowered until it does. learn.engines.culled_sums tests the entries of a list again for each pixel.
The kernel's many parameters are the price of a call by address: it passes integers and pointers.
"""

import numpy as np
from numba import types

from learn.engines.block_cuts import (
    bound_lobes,
    cut_lobes,
    highest_bound,
    is_listed,
    threshold_within,
    write_entry,
)
from learn.engines.cones import along_axis, cone_about, nearest_cosine
from learn.engines.exponentials import log2
from learn.engines.layout import (
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
    CUTS,
    LANES,
    SELECT_REACH,
    SELECT_ROWS,
    SELECT_STRIDE,
    SELECT_WEIGHT,
)
from learn.engines.triples import clear
from learn.engines.vector import FLOAT_POINTER, INT_POINTER, anywhere, load, maximum, store

SELECT = types.void(*[types.int64] * 7, *[FLOAT_POINTER] * 5, *[INT_POINTER] * 2)


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
            weight = maximum(n_w, 0.0) * load(cones, o + LANES * CONE_ENERGY)
            gammas, kappas = o + LANES * CONE_GAMMA, o + LANES * CONE_KAPPA
            bound_lobes(scratch, b, many, cones, gammas, kappas, log2(c, 1.0 - c), weight)
        threshold = threshold_within(scratch, SELECT_STRIDE, wide_blocks, many, budget[0])
        count = 0
        for wide_block in range(wide_blocks):
            o, b = CONE_STRIDE * wide_block, SELECT_STRIDE * wide_block
            if not anywhere(highest_bound(scratch, b, many) > threshold):
                continue
            cos_h, sin_h = load(cones, o + LANES * CONE_H_COS), load(cones, o + LANES * CONE_H_SIN)
            gammas, kappas = o + LANES * CONE_GAMMA, o + LANES * CONE_KAPPA
            reach = cut_lobes(scratch, b, many, cones, gammas, kappas, threshold, cos_h, sin_h)
            store(scratch, b + LANES * SELECT_REACH, reach)
            for lane in range(LANES):
                block, q = LANES * wide_block + lane, b + LANES * SELECT_WEIGHT + lane
                if block < room and is_listed(scratch, q, many):
                    entry = room * tile + count
                    write_entry(scratch, b, lane, many, block, entry, cuts, CUTS * entry, entries)
                    count += 1
        lengths[tile] = count
