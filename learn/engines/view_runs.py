"""Runs of pixels whose views are so close together that they share the work of one view.

What a view costs beyond a distant viewer is h and the spline values, for each pixel and light. A
run of neighbouring pixels computes both once for each block of lights, at the mean v̄ of its views,
and a pixel with the view v = v̄ + d corrects them:

    h = (s̄ + d)/‖s̄ + d‖,  s̄ = w + v̄:  exact; with h̄ = s̄/‖s̄‖ and ε = d/‖s̄‖,
        ‖s̄ + d‖ = ‖s̄‖ √(1 + y),  y = 2 h̄·ε + ε·ε
    x = x̄ + δ,  δ = −(w·d) 8/π /(‖s̄‖ ‖t̄‖),  t̄ = w − v̄:  to first order, x of learn.engines.splines
    γ = γ(x̄) + δ γ′(x̄), and κ likewise:  to first order

The error is of second order in d, which `limit` bounds: a tile is cut into runs of 16, 4 or 1
pixels, the longest that keep it. In runs of one pixel d is what rounding took off v.

A run's part of the scratch is described in learn.engines.layout (VIEW_…).
"""

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.distant import peak_cosine, w_of
from learn.engines.exponentials import angle
from learn.engines.halfway import LEAST_SQUARE, shortfall, two_sum
from learn.engines.layout import (
    BASIS_STRIDE,
    CHANNEL_VALUES,
    CULLED_TILE,
    KAPPA_VALUES,
    LANES,
    RUN_CHANNEL_STRIDE,
    RUN_GAMMA,
    RUN_GAMMA_SLOPE,
    RUN_KAPPA,
    RUN_KAPPA_SLOPE,
    VIEW_BASIS,
    VIEW_CENTRES,
    VIEW_LOBE_SUMS,
    VIEW_LOBES,
    VIEW_OFFSETS,
    W_REST_X,
    W_REST_Y,
    W_REST_Z,
)
from learn.engines.splines import ANGLE_TO_X, Basis, add_curve, basis, curve, tents
from learn.engines.triples import Triple, dot
from learn.engines.vector import (
    Lanes,
    Vector,
    fma,
    lane_max,
    load,
    maximum,
    minimum,
    single,
    splat,
    sqrt,
    store,
)

CLOSE = 0.1  # ‖ε‖ up to which a polynomial serves for 1/√(1 + y): 4e-4 off, along h alone
LEAST_DISTANCE = 1e-4  # of views, for which slopes are held finite
LARGEST_KAPPA = 126.0  # κ log2 e that exp2m1 takes
# v̄, then h̄ and what rounding took off it, 1/‖s̄‖, δ per w·d, and whether all ‖ε‖ are small
Shared = tuple[Vector, Vector, Vector, Lanes, Lanes, bool]


@inlined
def make_runs(
    v: np.ndarray, start: int, count: int, limit: float, scratch: np.ndarray, a: int
) -> int:
    """The number of pixels in each run of a tile whose scratch begins at a.

    limit  the longest ‖d‖; the offsets and the runs' views are written
    """
    run = LANES
    while run > 1:
        widest = single(0.0)
        for first in range(0, count, run):
            widest = max(widest, write_run(v, start, first, min(run, count - first), scratch, a))
        if widest <= limit * limit:
            return run
        run //= 4
    for j in range(count):
        write_run(v, start, j, 1, scratch, a)
    return run


@inlined
def write_run(
    v: np.ndarray, start: int, first: int, length: int, scratch: np.ndarray, a: int
) -> float:
    """Write a run's view and its pixels' offsets; returns the largest ‖d‖²."""
    x, y, z, widest = 0.0, 0.0, 0.0, single(0.0)
    for p in range(start + first, start + first + length):
        x, y, z = x + v[3 * p], y + v[3 * p + 1], z + v[3 * p + 2]
    c, o = a + VIEW_CENTRES + first, a + VIEW_OFFSETS + first
    scratch[c], scratch[c + CULLED_TILE] = x / length, y / length
    scratch[c + 2 * CULLED_TILE] = z / length
    for j in range(length):
        p = 3 * (start + first + j)
        short = shortfall(v[p], v[p + 1], v[p + 2])  # of a unit vector in float32
        dx = (v[p] - scratch[c]) + v[p] * short
        dy = (v[p + 1] - scratch[c + CULLED_TILE]) + v[p + 1] * short
        dz = (v[p + 2] - scratch[c + 2 * CULLED_TILE]) + v[p + 2] * short
        d_square = dx * dx + dy * dy + dz * dz
        scratch[o + j], scratch[o + CULLED_TILE + j] = dx, dy
        scratch[o + 2 * CULLED_TILE + j], scratch[o + 3 * CULLED_TILE + j] = dz, d_square
        widest = max(widest, d_square)
    return widest


@inlined
def distance(scratch: np.ndarray, a: int, first: int, length: int) -> float:
    """The largest ‖d‖ of a run."""
    widest = single(LEAST_DISTANCE * LEAST_DISTANCE)
    for j in range(first, first + length):
        widest = max(widest, scratch[a + VIEW_OFFSETS + 3 * CULLED_TILE + j])
    return single(widest**0.5)


@inlined
def shared(geometry: np.ndarray, o: int, scratch: np.ndarray, c: int, furthest: float) -> Shared:
    """What a run shares at a block of lights; c: place of its view's x, furthest: largest ‖d‖."""
    vx, vy, vz = scratch[c], scratch[c + CULLED_TILE], scratch[c + 2 * CULLED_TILE]
    wx, wy, wz = w_of(geometry, o)
    sx, rx = two_sum(wx, splat(vx))
    sy, ry = two_sum(wy, splat(vy))
    sz, rz = two_sum(wz, splat(vz))
    rx = rx + load(geometry, o + LANES * W_REST_X)
    ry = ry + load(geometry, o + LANES * W_REST_Y)
    rz = rz + load(geometry, o + LANES * W_REST_Z)
    s, t = (sx + rx, sy + ry, sz + rz), (wx - vx, wy - vy, wz - vz)
    s_square = maximum(dot(s, s), LEAST_SQUARE)
    inverse = 1.0 / sqrt(s_square)
    hx, hy, hz = sx * inverse, sy * inverse, sz * inverse
    # what rounding took off: fma(s, inverse, −h) is exact
    lx = fma(rx, inverse, fma(sx, inverse, 0.0 - hx))
    ly = fma(ry, inverse, fma(sy, inverse, 0.0 - hy))
    lz = fma(rz, inverse, fma(sz, inverse, 0.0 - hz))
    t_square = dot(t, t)
    # sin 2θ_d is held at ‖d‖: near its ends θ_d changes by ‖d‖/2 at most
    sine = maximum(sqrt(s_square * t_square), 2.0 * furthest)
    close = lane_max(inverse) * furthest < CLOSE
    return (vx, vy, vz), (hx, hy, hz), (lx, ly, lz), inverse, ANGLE_TO_X / sine, close


@inlined
def of_pixel(
    run: Shared, scratch: np.ndarray, d: int, n: Triple
) -> tuple[Vector, Lanes, Lanes, Lanes]:
    """h − n, 1/‖s‖, c and log2 c of a pixel; d: place of its offset's x."""
    (hx, hy, hz), (lx, ly, lz), inverse = run[1], run[2], run[3]
    dx, dy, dz = scratch[d], scratch[d + CULLED_TILE], scratch[d + 2 * CULLED_TILE]
    along = fma(hx, dx, fma(hy, dy, hz * dz))
    y = inverse * fma(along, 2.0, inverse * scratch[d + 3 * CULLED_TILE])
    if run[5]:
        less = y * fma(y, fma(y, -0.3125, 0.375), -0.5)
    else:
        less = 1.0 / sqrt(maximum(1.0 + y, LEAST_SQUARE * inverse * inverse)) - 1.0
    scale = fma(inverse, less, inverse)
    ox = ((hx - n[0]) + lx) + fma(hx, less, scale * dx)
    oy = ((hy - n[1]) + ly) + fma(hy, less, scale * dy)
    oz = ((hz - n[2]) + lz) + fma(hz, less, scale * dz)
    offset = ox, oy, oz
    c, log_c = peak_cosine(offset)
    return offset, scale, c, log_c


@inlined
def turn(geometry: np.ndarray, o: int, run: Shared, scratch: np.ndarray, d: int) -> Lanes:
    """δ of a pixel."""
    wx, wy, wz = w_of(geometry, o)
    dx, dy, dz = scratch[d], scratch[d + CULLED_TILE], scratch[d + 2 * CULLED_TILE]
    return (0.0 - run[4]) * fma(wx, dx, fma(wy, dy, wz * dz))


@inlined
def make_lobes(
    geometry: np.ndarray,
    o: int,
    run: Shared,
    furthest: float,
    alone: bool,
    many: int,
    values: np.ndarray,
    scratch: np.ndarray,
    a: int,
) -> None:
    """Write a run's lobes and their slopes, and the basis.

    alone  whether there is one pixel, and no derivative by its view: slopes are 0

    A slope is held where the first order would take a value below 0 or a κ beyond exp2m1.
    """
    wx, wy, wz = w_of(geometry, o)
    vx, vy, vz = run[0]
    s, t = (wx + vx, wy + vy, wz + vz), (wx - vx, wy - vy, wz - vz)
    theta_d = angle(dot(t, t), maximum(dot(s, s), LEAST_SQUARE))
    b, tent = basis(theta_d), tents(theta_d)
    slopes = (
        -2.0 * tent[0],
        fma(tent[0], 2.0, 0.0 - tent[1]),
        tent[1] - tent[2],
        tent[2] - tent[3],
        fma(tent[4], -2.0, tent[3]),
        2.0 * tent[4],
    )
    store_basis(scratch, a + VIEW_BASIS, b)
    store_basis(scratch, a + VIEW_BASIS + BASIS_STRIDE, slopes)
    steepest = 1.0 / (run[4] * furthest)
    for i in range(3 * many):
        at, to = CHANNEL_VALUES * i, a + VIEW_LOBES + RUN_CHANNEL_STRIDE * i
        gamma, kappa = curve(values, at, b), curve(values, at + KAPPA_VALUES, b)
        store(scratch, to + LANES * RUN_GAMMA, gamma)
        store(scratch, to + LANES * RUN_KAPPA, kappa)
        if alone:
            store(scratch, to + LANES * RUN_GAMMA_SLOPE, splat(0.0))
            store(scratch, to + LANES * RUN_KAPPA_SLOPE, splat(0.0))
        else:
            most, up = gamma * steepest, curve(values, at, slopes)
            store(scratch, to + LANES * RUN_GAMMA_SLOPE, minimum(maximum(up, 0.0 - most), most))
            most = maximum(minimum(kappa, LARGEST_KAPPA - kappa), 0.0) * steepest
            up = curve(values, at + KAPPA_VALUES, slopes)
            store(scratch, to + LANES * RUN_KAPPA_SLOPE, minimum(maximum(up, 0.0 - most), most))


@inlined
def add_material(many: int, scratch: np.ndarray, a: int, m_sums: np.ndarray, to: int) -> None:
    """Add a run's sums by its lobes, times the basis, to m_sums[to …] (many, 3, 2, 6, 16)."""
    at = a + VIEW_BASIS
    b = load_basis(scratch, at)
    slopes = load_basis(scratch, at + BASIS_STRIDE)
    for i in range(3 * many):
        row, sums = to + LANES * CHANNEL_VALUES * i, a + VIEW_LOBE_SUMS + RUN_CHANNEL_STRIDE * i
        add_curve(m_sums, row, load(scratch, sums + LANES * RUN_GAMMA), b)
        add_curve(m_sums, row, load(scratch, sums + LANES * RUN_GAMMA_SLOPE), slopes)
        row += LANES * KAPPA_VALUES
        add_curve(m_sums, row, load(scratch, sums + LANES * RUN_KAPPA), b)
        add_curve(m_sums, row, load(scratch, sums + LANES * RUN_KAPPA_SLOPE), slopes)


@inlined
def store_basis(scratch: np.ndarray, o: int, b: Basis) -> None:
    """Write six rows."""
    store(scratch, o, b[0])
    store(scratch, o + LANES, b[1])
    store(scratch, o + 2 * LANES, b[2])
    store(scratch, o + 3 * LANES, b[3])
    store(scratch, o + 4 * LANES, b[4])
    store(scratch, o + 5 * LANES, b[5])


@inlined
def load_basis(scratch: np.ndarray, o: int) -> Basis:
    """Six rows."""
    return (
        load(scratch, o),
        load(scratch, o + LANES),
        load(scratch, o + 2 * LANES),
        load(scratch, o + 3 * LANES),
        load(scratch, o + 4 * LANES),
        load(scratch, o + 5 * LANES),
    )
