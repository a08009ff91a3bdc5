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

from typing import NamedTuple

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
from learn.engines.compilation import inlined
from learn.engines.cones import Cone, along_axis, cone_about, nearest_cosine
from learn.engines.distant import w_of
from learn.engines.exponentials import angle, log2
from learn.engines.halfway import LEAST_SQUARE
from learn.engines.layout import (
    CONE_ENERGY,
    CONE_STRIDE,
    CONE_W_COS,
    CONE_W_SIN,
    CONE_W_X,
    CUT_AXIS,
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
from learn.engines.triples import Triple, clear, dot
from learn.engines.vector import (
    FLOAT_POINTER,
    INT_POINTER,
    Lanes,
    Vector,
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


class Halfway(NamedTuple):
    """Cones about the half vectors of sixteen blocks of lights, and their θ_d.

    axis          (a + b)/‖a + b‖, a and b the axes of the cones about w and about v
    cos_h, sin_h  of the half angle
    theta_d       that of a and b
    sin_alone     the sine of the half angle of a cone about the h of one view
    """

    axis: Vector
    cos_h: Lanes
    sin_h: Lanes
    theta_d: Lanes
    sin_alone: Lanes


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


@inlined
def chord(cosine: Lanes) -> Lanes:
    """2 sin(α/2), the distance between unit vectors at an angle α, from cos α."""
    return sqrt(2.0 * maximum(1.0 - cosine, 0.0))


@inlined
def half_angle(sine: Lanes) -> tuple[Lanes, Lanes]:
    """Cosine and sine of a cone's half angle below π/2 from its sine.

    From WHOLE_SPHERE on it is the whole sphere, whose half angle is π.
    """
    whole = sine > WHOLE_SPHERE
    cosine = choose(whole, -1.0, sqrt(maximum(1.0 - sine * sine, 0.0)))
    return cosine, choose(whole, 0.0, sine)


@inlined
def cone_of_h(w: Vector, chord_w: Lanes, v: Triple, chord_v: Lanes) -> Halfway:
    """The cones about the half vectors h of sixteen blocks of lights.

    w, chord_w  axes of the cones about w, and `chord` of their half angles
    v, chord_v  the same of the cone about the tile's views
    """
    (wx, wy, wz), (vx, vy, vz) = w, v
    sx, sy, sz = wx + vx, wy + vy, wz + vz
    t = wx - vx, wy - vy, wz - vz
    s_square = maximum(dot((sx, sy, sz), (sx, sy, sz)), LEAST_SQUARE)
    inverse = 1.0 / sqrt(s_square)
    axis = sx * inverse, sy * inverse, sz * inverse
    gap = chord_w + chord_v
    cos_h, sin_h = half_angle(fma(gap, inverse, 1e-6))
    theta_d = angle(dot(t, t), s_square)
    # for one pixel's view the cone is narrower, and about another axis
    alone = chord_w / maximum(1.0 / inverse - gap, 1e-6) + 1e-6
    return Halfway(axis, cos_h, sin_h, theta_d, alone)


@inlined
def bound_blocks(
    cones: np.ndarray,
    wide_block: int,
    ranges: np.ndarray,
    normals: Cone,
    views: Cone,
    many: int,
    scratch: np.ndarray,
) -> None:
    """Write what a tile's list needs to know of sixteen blocks, above all the lobes' bounds.

    normals, views  the cones about the tile's normals and views
    """
    o, b = CONE_STRIDE * wide_block, SELECT_VIEW_STRIDE * wide_block
    nx, ny, nz, cos_n, sin_n = normals
    vx, vy, vz, cos_v, _ = views
    axis = along_axis(cones, o + LANES * CONE_W_X, nx, ny, nz)
    cos_w, sin_w = load(cones, o + LANES * CONE_W_COS), load(cones, o + LANES * CONE_W_SIN)
    n_w = nearest_cosine(axis, cos_w, sin_w, cos_n, sin_n)
    if not anywhere(n_w > 0.0):
        clear(scratch, b + LANES * SELECT_BOUND, many)
        return
    w = w_of(cones, o + LANES * CONE_W_X)
    half = cone_of_h(w, chord(cos_w), (vx, vy, vz), chord(splat(cos_v)))
    store(scratch, b + LANES * SELECT_THETA, half.theta_d * BINS_PER_RADIAN)
    look_up_ranges(scratch, b, many, ranges)
    cos_1, sin_1 = half_angle(half.sin_alone)
    store(scratch, b + LANES * SELECT_H_COS, cos_1)
    store(scratch, b + LANES * SELECT_H_SIN, sin_1)
    (hx, hy, hz), cos_h, sin_h = half.axis, half.cos_h, half.sin_h
    axis = fma(hx, nx, fma(hy, ny, hz * nz))
    c = maximum(nearest_cosine(axis, cos_h, sin_h, cos_n, sin_n), 1e-12)
    weight = maximum(n_w, 0.0) * load(cones, o + LANES * CONE_ENERGY)
    gammas, kappas = b + LANES * SELECT_GAMMA, b + LANES * SELECT_KAPPA
    bound_lobes(scratch, b, many, scratch, gammas, kappas, log2(c, 1.0 - c), weight)


@inlined
def list_blocks(
    cones: np.ndarray,
    wide_block: int,
    room: int,
    many: int,
    threshold: float,
    scratch: np.ndarray,
    entry: int,
    cuts: np.ndarray,
    entries: np.ndarray,
) -> int:
    """Write the entries of those of sixteen blocks that the list needs, from `entry` on.

    threshold  on the bounds of `bound_blocks`
    Returns    the place of the next entry
    """
    b = SELECT_VIEW_STRIDE * wide_block
    if not anywhere(highest_bound(scratch, b, many) > threshold):
        return entry
    cos_h, sin_h = load(scratch, b + LANES * SELECT_H_COS), load(scratch, b + LANES * SELECT_H_SIN)
    gammas, kappas = b + LANES * SELECT_GAMMA, b + LANES * SELECT_KAPPA
    reach = cut_lobes(scratch, b, many, scratch, gammas, kappas, threshold, cos_h, sin_h)
    store(scratch, b + LANES * SELECT_REACH, reach)
    for lane in range(LANES):
        block = LANES * wide_block + lane
        if block < room and is_listed(scratch, b + LANES * SELECT_WEIGHT + lane, many):
            to = VIEW_CUTS * entry
            write_entry(scratch, b, lane, many, block, entry, cuts, to, entries)
            for i in range(3):
                axis_at = CONE_STRIDE * wide_block + LANES * (CONE_W_X + i) + lane
                cuts[to + CUT_AXIS + i] = cones[axis_at]
            entry += 1
    return entry


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
        normals, views = cone_about(n, start, count), cone_about(v, start, count)
        for wide_block in range(wide_blocks):
            bound_blocks(cones, wide_block, ranges, normals, views, many, scratch)
        threshold = threshold_within(scratch, SELECT_VIEW_STRIDE, wide_blocks, many, budget[0])
        entry = room * tile
        for wide_block in range(wide_blocks):
            entry = list_blocks(
                cones, wide_block, room, many, threshold, scratch, entry, cuts, entries
            )
        lengths[tile] = entry - room * tile
