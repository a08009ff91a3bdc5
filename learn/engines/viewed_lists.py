"""The kernel that lists, for each tile of pixels, the lights near its lobes; a view per pixel.

Letters, arrays and formulas as in learn.engines.general and learn.engines.culled_lists; pixels are
sorted so that a tile's normals, and as a rule its views, are close together. Besides:
v        (P, 3) unit vectors to the viewer
values   (many, 3 channels, 2, 6): control values of γ and of κ log2 e of the lobes that are summed
steps    (many, 3, 2, 5): slopes of their splines, as in learn.engines.general
ranges   (many, 2, THETA_BINS): the least γ and the largest κ log2 e that a lobe has near θ_d
cones    as in learn.engines.culled_lists, of which only those about w and the energy are read
cuts     (T, room, VIEW_CUTS): as there, and behind them the axis of the cone about h

The cone about h belongs to a tile and a block. For w and v in cones of half angles α and β about a
and b, s = w + v differs from a + b by at most 2 sin(α/2) + 2 sin(β/2), so that h lies within the
angle of that over ‖a + b‖ of (a + b)/‖a + b‖. `ranges` must cover the θ_d of such w and v, within
(α + β)/2 of that of a and b.
"""

import numpy as np
from numba import types

from learn.engines.block_cuts import (
    bound_lobes,
    cut_lobes,
    highest_bound,
    is_listed,
    threshold_within,
)
from learn.engines.compilation import inlined
from learn.engines.cones import along_axis, cone_about, nearest_cosine
from learn.engines.distant import clear, w_of
from learn.engines.exponentials import angle, log2
from learn.engines.general import LEAST_SQUARE, square
from learn.engines.layout import (
    CONE_ENERGY,
    CONE_STRIDE,
    CONE_W_COS,
    CONE_W_SIN,
    CONE_W_X,
    CUT_AXIS,
    CUT_REACH,
    LANES,
    SELECT_BOUND,
    SELECT_GAMMA,
    SELECT_H_COS,
    SELECT_H_SIN,
    SELECT_KAPPA,
    SELECT_REACH,
    SELECT_THETA,
    SELECT_VIEW_STRIDE,
    SELECT_WEIGHT,
    THETA_BINS,
    VIEW_CUTS,
)
from learn.engines.vector import (
    FLOAT_POINTER,
    INT_POINTER,
    anywhere,
    fma,
    load,
    maximum,
    splat,
    sqrt,
    store,
)
from learn.engines.vector import select as choose

BINS_PER_RADIAN = THETA_BINS / 1.5707963267948966
WHOLE_SPHERE = 0.999999  # sine of a cone's half angle from which it counts as the whole sphere

SELECT = types.void(*[types.int64] * 7, *[FLOAT_POINTER] * 7, *[INT_POINTER] * 2)


@inlined
def look_up_ranges(scratch: np.ndarray, b: int, many: int, ranges: np.ndarray) -> None:
    """Write rows SELECT_GAMMA and SELECT_KAPPA of sixteen blocks, by their row SELECT_THETA."""
    for lane in range(LANES):
        place = types.int64(scratch[b + LANES * SELECT_THETA + lane])
        place = min(max(place, 0), THETA_BINS - 1)
        for s in range(many):
            o = 2 * THETA_BINS * s + place
            scratch[b + LANES * (SELECT_GAMMA + s) + lane] = ranges[o]
            scratch[b + LANES * (SELECT_KAPPA + s) + lane] = ranges[o + THETA_BINS]


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
    v: np.ndarray,
    cones: np.ndarray,
    ranges: np.ndarray,
    scratch: np.ndarray,
    cuts: np.ndarray,
    lengths: np.ndarray,
    entries: np.ndarray,
) -> None:
    """The list of each tile first … last − 1; scratch: wide_blocks · SELECT_VIEW_STRIDE floats."""
    for tile in range(first, last):
        start = tile * size
        count = min(size, pixels - start)
        nx, ny, nz, cos_n, sin_n = cone_about(n, start, count)
        vx, vy, vz, cos_v, _sin_v = cone_about(v, start, count)
        gap_v = sqrt(splat(2.0) * maximum(splat(1.0) - cos_v, 0.0))
        for wide_block in range(wide_blocks):
            o, b = CONE_STRIDE * wide_block, SELECT_VIEW_STRIDE * wide_block
            axis = along_axis(cones, o + LANES * CONE_W_X, nx, ny, nz)
            cos_w, sin_w = load(cones, o + LANES * CONE_W_COS), load(cones, o + LANES * CONE_W_SIN)
            n_w = nearest_cosine(axis, cos_w, sin_w, cos_n, sin_n)
            if not anywhere(n_w > 0.0):
                clear(scratch, b + LANES * SELECT_BOUND, many)
                continue
            wx, wy, wz = w_of(cones, o + LANES * CONE_W_X)
            sx, sy, sz = wx + vx, wy + vy, wz + vz
            s_square = maximum(square(sx, sy, sz), LEAST_SQUARE)
            inverse = 1.0 / sqrt(s_square)
            hx, hy, hz = sx * inverse, sy * inverse, sz * inverse
            gap = sqrt(2.0 * maximum(1.0 - cos_w, 0.0)) + gap_v
            sin_h = fma(gap, inverse, 1e-6)
            whole = sin_h > WHOLE_SPHERE
            cos_h = choose(whole, -1.0, sqrt(maximum(1.0 - sin_h * sin_h, 0.0)))
            sin_h = choose(whole, 0.0, sin_h)
            theta_d = angle(square(wx - vx, wy - vy, wz - vz), s_square)
            store(scratch, b + LANES * SELECT_THETA, theta_d * BINS_PER_RADIAN)
            look_up_ranges(scratch, b, many, ranges)
            # for one pixel's view the cone is narrower, and about another axis
            alone = sqrt(2.0 * maximum(1.0 - cos_w, 0.0))
            alone = alone / maximum(1.0 / inverse - gap, 1e-6) + 1e-6
            beyond = alone > WHOLE_SPHERE
            cos_1 = choose(beyond, -1.0, sqrt(maximum(1.0 - alone * alone, 0.0)))
            store(scratch, b + LANES * SELECT_H_COS, cos_1)
            store(scratch, b + LANES * SELECT_H_SIN, choose(beyond, 0.0, alone))
            axis = fma(hx, nx, fma(hy, ny, hz * nz))
            c = maximum(nearest_cosine(axis, cos_h, sin_h, cos_n, sin_n), 1e-12)
            weight = maximum(n_w, 0.0) * load(cones, o + LANES * CONE_ENERGY)
            gammas, kappas = b + LANES * SELECT_GAMMA, b + LANES * SELECT_KAPPA
            bound_lobes(scratch, b, many, scratch, gammas, kappas, log2(c, 1.0 - c), weight)
        threshold = threshold_within(scratch, SELECT_VIEW_STRIDE, wide_blocks, many, budget[0])
        length = 0
        for wide_block in range(wide_blocks):
            b = SELECT_VIEW_STRIDE * wide_block
            if not anywhere(highest_bound(scratch, b, many) > threshold):
                continue
            cos_h, sin_h = (
                load(scratch, b + LANES * SELECT_H_COS),
                load(scratch, b + LANES * SELECT_H_SIN),
            )
            gammas, kappas = b + LANES * SELECT_GAMMA, b + LANES * SELECT_KAPPA
            reach = cut_lobes(scratch, b, many, scratch, gammas, kappas, threshold, cos_h, sin_h)
            store(scratch, b + LANES * SELECT_REACH, reach)
            for lane in range(LANES):
                block, q = LANES * wide_block + lane, b + LANES * SELECT_WEIGHT + lane
                if block < room and is_listed(scratch, q, many):
                    entry = room * tile + length
                    entries[entry] = block
                    to = VIEW_CUTS * entry
                    for s in range(many):
                        cuts[to + s] = scratch[q + LANES * s]
                    cuts[to + CUT_REACH] = scratch[b + LANES * SELECT_REACH + lane]
                    for i in range(3):
                        axis_at = CONE_STRIDE * wide_block + LANES * (CONE_W_X + i) + lane
                        cuts[to + CUT_AXIS + i] = cones[axis_at]
                    length += 1
        lengths[tile] = length
