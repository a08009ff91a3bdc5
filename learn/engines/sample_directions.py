"""Kernels of the half-vector quadrature: sample directions about each pixel's normal.

P pixels, blocks of 16 samples (LANES), ordered by radius; all arrays float32, flat, C order.
n, v      (P, 3) unit normals, and unit vectors to the viewer, camera frame
around    (blocks, 5, 16): half vectors about the z axis as sin θ cos φ, sin θ sin φ, cos θ; log2
          cos θ; solid angle
m         (3 lobes, 3 channels, 2, 6): control values of γ and of κ log2 e
least     (3 lobes,): smallest γ of a lobe that reflects, to skip blocks that it does not reach
rotation  (9,): camera_from_light, row by row
light     (height, width, 3): radiance
scratch   per call of forward: (7, 16) floats

    I_k = Σ_i F_k L_k(w_i) max(0, n·w_i) 4 (v·h_i) dω_h,   w = 2 (v·h) h − v,   cos θ_d = v·h,   c =
    n·h = cos θ

c and its logarithm belong to the sample, not to the pixel: they have full precision, however sharp
the lobe. L_k is the mean over the sample's footprint (learn.engines.footprints), whose solid angle
is dω = 4 (v·h) dω_h.

The backward pass holds w_i and dω_i, as learn.methods.half_vectors says, and computes the rest
again:

    ∂μ/∂n = w    ∂c/∂n = h − c n    ∂c/∂v = (n − c h)/‖w + v‖, with ‖w + v‖ = 2 v·h    θ_d as in
    learn.engines.general
"""

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import LN2, add_to, clear, write_sums
from learn.engines.exponentials import angle, exp2, exp2m1
from learn.engines.footprints import (
    TINY,
    add_radiance,
    footprint,
    gather,
    in_one_texel,
    scatter,
    store_footprint,
    texel_of,
)
from learn.engines.general import LEAST_SQUARE, lobe_backward, square
from learn.engines.layout import (
    CHANNEL_VALUES,
    FOOTPRINT_BY_M,
    FOOTPRINT_BY_N,
    FOOTPRINT_BY_V,
    FOOTPRINT_LIGHT,
    KAPPA_VALUES,
    LANES,
    LOBE_VALUES,
    NEGLIGIBLE,
    SAMPLE_CHUNKS,
    SAMPLE_LOG_COSINE,
    SAMPLE_SCRATCH,
    SAMPLE_SOLID_ANGLE,
    SAMPLE_STRIDE,
    SAMPLE_TILE,
    SAMPLE_X,
    SAMPLE_Y,
    SAMPLE_Z,
    VALUES,
)
from learn.engines.splines import ANGLE_TO_X, Basis, basis, curve, tents
from learn.engines.vector import (
    FLOAT_POINTER,
    Lanes,
    Vector,
    anywhere,
    fma,
    lane_max,
    lane_sum,
    load,
    maximum,
    select,
    splat,
    sqrt,
    store,
)

Triple = tuple[float, float, float]

FORWARD = types.void(*[types.int64] * 6, *[FLOAT_POINTER] * 9)
BACKWARD = types.void(*[types.int64] * 8, *[FLOAT_POINTER] * 14)


@inlined
def lobe(m: np.ndarray, o: int, log_c: Lanes, b: Basis) -> Lanes:
    """expm1(κ c^γ) of the lobe and channel at offset o."""
    return exp2m1(curve(m, o + KAPPA_VALUES, b) * exp2(curve(m, o, b) * log_c))


@inlined
def reflectance(m: np.ndarray, least: np.ndarray, log_c: Lanes, cos_d: Lanes) -> Vector:
    """F (3 channels) of sixteen samples."""
    b = basis(angle(maximum(1.0 - cos_d * cos_d, 0.0), cos_d * cos_d + TINY))
    nearest = lane_max(log_c)
    f0, f1, f2 = splat(0.0), splat(0.0), splat(0.0)
    for s in range(3):
        if nearest * least[s] > NEGLIGIBLE:
            f0 = f0 + lobe(m, LOBE_VALUES * s, log_c, b)
            f1 = f1 + lobe(m, LOBE_VALUES * s + CHANNEL_VALUES, log_c, b)
            f2 = f2 + lobe(m, LOBE_VALUES * s + 2 * CHANNEL_VALUES, log_c, b)
    return f0, f1, f2


@inlined
def tangents(nx: float, ny: float, nz: float) -> tuple[Triple, Triple]:
    """Two axes across n that turn smoothly with it (Duff et al. 2017)."""
    sign = -1.0 if nz < 0.0 else 1.0
    a = -1.0 / (sign + nz)
    u = 1.0 + sign * nx * nx * a, sign * nx * ny * a, -sign * nx
    return u, (nx * ny * a, sign + ny * ny * a, -ny)


@inlined
def mirrored(h: Vector, cos_d: Lanes, v: Triple) -> Vector:
    """w = 2 (v·h) h − v."""
    return (
        fma(2.0 * cos_d, h[0], -v[0]),
        fma(2.0 * cos_d, h[1], -v[1]),
        fma(2.0 * cos_d, h[2], -v[2]),
    )


def forward(
    first: int,
    last: int,
    pixels: int,
    blocks: int,
    height: int,
    width: int,
    n: np.ndarray,
    v: np.ndarray,
    around: np.ndarray,
    m: np.ndarray,
    least: np.ndarray,
    rotation: np.ndarray,
    light: np.ndarray,
    scratch: np.ndarray,
    radiance: np.ndarray,
) -> None:
    """Radiance (P, 3) of pixel tiles first … last − 1."""
    for p in range(first * SAMPLE_TILE, min(last * SAMPLE_TILE, pixels)):
        nx, ny, nz = n[3 * p], n[3 * p + 1], n[3 * p + 2]
        vx, vy, vz = v[3 * p], v[3 * p + 1], v[3 * p + 2]
        (ux, uy, uz), (tx, ty, tz) = tangents(nx, ny, nz)
        i0, i1, i2 = 0.0, 0.0, 0.0
        for block in range(blocks):
            o = SAMPLE_STRIDE * block
            q, r = load(around, o + LANES * SAMPLE_X), load(around, o + LANES * SAMPLE_Y)
            c = load(around, o + LANES * SAMPLE_Z)
            log_c = load(around, o + LANES * SAMPLE_LOG_COSINE)
            solid_angle = load(around, o + LANES * SAMPLE_SOLID_ANGLE)
            hx = fma(q, ux, fma(r, tx, c * nx))
            hy = fma(q, uy, fma(r, ty, c * ny))
            hz = fma(q, uz, fma(r, tz, c * nz))
            cos_d = fma(hx, vx, fma(hy, vy, hz * vz))
            wx, wy, wz = mirrored((hx, hy, hz), cos_d, (vx, vy, vz))
            n_w = fma(wx, nx, fma(wy, ny, wz * nz))
            weight = maximum(n_w, 0.0) * maximum(cos_d, 0.0) * solid_angle * 4.0
            if not anywhere(weight > 0.0):
                continue
            f0, f1, f2 = reflectance(m, least, log_c, cos_d)
            at = footprint(
                (wx, wy, wz), 4.0 * maximum(cos_d, 0.0) * solid_angle, rotation, height, width
            )
            if in_one_texel(at):
                texel = 3 * texel_of(at, height, width)
                i0 += lane_sum(f0 * weight) * light[texel]
                i1 += lane_sum(f1 * weight) * light[texel + 1]
                i2 += lane_sum(f2 * weight) * light[texel + 2]
                continue
            store(scratch, 0, f0 * weight)
            store(scratch, LANES, f1 * weight)
            store(scratch, 2 * LANES, f2 * weight)
            store_footprint(scratch, 0, at)
            i0, i1, i2 = add_radiance(scratch, light, height, width, i0, i1, i2)
        radiance[3 * p], radiance[3 * p + 1], radiance[3 * p + 2] = i0, i1, i2


def backward(
    first: int,
    last: int,
    pixels: int,
    blocks: int,
    height: int,
    width: int,
    with_view: int,
    with_light: int,
    n: np.ndarray,
    v: np.ndarray,
    around: np.ndarray,
    m: np.ndarray,
    steps: np.ndarray,
    least: np.ndarray,
    rotation: np.ndarray,
    light: np.ndarray,
    scratch: np.ndarray,
    g: np.ndarray,
    by_n: np.ndarray,
    by_v: np.ndarray,
    light_sums: np.ndarray,
    m_sums: np.ndarray,
) -> None:
    """Derivatives of Σ g·I by the pixels of chunks first … last − 1, of SAMPLE_CHUNKS.

    with_view   0: by_v is not written; with_light 0: light_sums is not written
    steps       as in learn.engines.general
    scratch     (SAMPLE_CHUNKS, SAMPLE_SCRATCH)
    g           (P, 3) derivative by radiance
    by_n, by_v  (P, 3) out: derivatives by n and by v, tangential
    light_sums  (SAMPLE_CHUNKS, height, width, 3), zeros: out, each chunk's derivative by light
    m_sums      (tiles, 108) out, as in learn.engines.general
    A tile of pixels belongs to one chunk, and chunks do not depend on the number of threads.
    """
    tiles = (pixels + SAMPLE_TILE - 1) // SAMPLE_TILE
    for chunk in range(first, last):
        work = SAMPLE_SCRATCH * chunk
        n_sums, v_sums = work + LANES * FOOTPRINT_BY_N, work + LANES * FOOTPRINT_BY_V
        by_m = work + LANES * FOOTPRINT_BY_M
        texels = 3 * height * width * chunk
        for tile in range(chunk * tiles // SAMPLE_CHUNKS, (chunk + 1) * tiles // SAMPLE_CHUNKS):
            clear(scratch, by_m, VALUES)
            for p in range(3 * SAMPLE_TILE * tile, 3 * min(SAMPLE_TILE * (tile + 1), pixels), 3):
                nx, ny, nz = n[p], n[p + 1], n[p + 2]
                vx, vy, vz = v[p], v[p + 1], v[p + 2]
                (ux, uy, uz), (tx, ty, tz) = tangents(nx, ny, nz)
                clear(scratch, n_sums, 6)
                for block in range(blocks):
                    o = SAMPLE_STRIDE * block
                    log_c = load(around, o + LANES * SAMPLE_LOG_COSINE)
                    nearest = lane_max(log_c)
                    if not (nearest * min(least[0], least[1], least[2]) > NEGLIGIBLE):
                        break  # samples farther out see less
                    q, r = load(around, o + LANES * SAMPLE_X), load(around, o + LANES * SAMPLE_Y)
                    c = load(around, o + LANES * SAMPLE_Z)
                    solid_angle = load(around, o + LANES * SAMPLE_SOLID_ANGLE)
                    # h − c n, across n
                    x, y, z = fma(q, ux, r * tx), fma(q, uy, r * ty), fma(q, uz, r * tz)
                    hx, hy, hz = fma(c, nx, x), fma(c, ny, y), fma(c, nz, z)
                    cos_d = fma(hx, vx, fma(hy, vy, hz * vz))
                    wx, wy, wz = mirrored((hx, hy, hz), cos_d, (vx, vy, vz))
                    n_w = fma(wx, nx, fma(wy, ny, wz * nz))
                    spread = maximum(cos_d, 0.0) * solid_angle * 4.0
                    mu = maximum(n_w, 0.0) * spread
                    if not anywhere(mu > 0.0):
                        continue
                    at = footprint((wx, wy, wz), spread, rotation, height, width)
                    store_footprint(scratch, work, at)
                    one_texel, texel = in_one_texel(at), 0
                    if one_texel:
                        texel = 3 * texel_of(at, height, width)
                        for k in range(3):
                            row = work + LANES * (FOOTPRINT_LIGHT + k)
                            store(scratch, row, splat(light[texel + k]))
                    else:
                        gather(scratch, work, light, height, width)
                    t_square = square(wx - vx, wy - vy, wz - vz)
                    s_square = maximum(4.0 * cos_d * cos_d, LEAST_SQUARE)
                    theta_d = angle(t_square, s_square)
                    b, tent = basis(theta_d), tents(theta_d)
                    by_w, by_c, by_x = splat(0.0), splat(0.0), splat(0.0)
                    for k in range(3):
                        seen = load(scratch, work + LANES * (FOOTPRINT_LIGHT + k)) * g[p + k]
                        weight = mu * seen
                        f, d_c, d_x = splat(0.0), splat(0.0), splat(0.0)
                        for s in range(3):
                            if nearest * least[s] > NEGLIGIBLE:
                                values = LOBE_VALUES * s + CHANNEL_VALUES * k
                                lobe_f, lobe_c, lobe_x = lobe_backward(
                                    m, steps, values, log_c, b, tent, weight, scratch, by_m,
                                    with_view,
                                )  # fmt: skip
                                f, d_c, d_x = f + lobe_f, d_c + lobe_c, d_x + lobe_x
                        store(scratch, work + LANES * k, f * mu * g[p + k])
                        by_w = fma(f * spread, seen, by_w)
                        by_c = fma(d_c, weight, by_c)
                        by_x = fma(d_x, weight, by_x)
                    if with_light:
                        if one_texel:
                            for k in range(3):
                                value = load(scratch, work + LANES * k)
                                light_sums[texels + texel + k] += lane_sum(value)
                        else:
                            scatter(scratch, work, light_sums, texels, height, width)
                    by_w = select(n_w > 0.0, by_w, 0.0)
                    by_c = by_c * LN2 / maximum(c, TINY)
                    add_to(scratch, n_sums, fma(by_w, wx, by_c * x))
                    add_to(scratch, n_sums + LANES, fma(by_w, wy, by_c * y))
                    add_to(scratch, n_sums + 2 * LANES, fma(by_w, wz, by_c * z))
                    if with_view:
                        # n − c h = sin² θ n − c (h − c n): nothing cancels at a lobe's peak
                        inverse = 1.0 / sqrt(s_square)
                        by_c = by_c * inverse
                        across, along = by_c * fma(q, q, r * r), by_c * c
                        t_length = sqrt(maximum(t_square, LEAST_SQUARE))
                        by_theta = by_x * (0.25 * ANGLE_TO_X) * inverse / t_length
                        by_t, by_s = by_theta * s_square, by_theta * t_square
                        bx = across * nx - along * x - by_t * (wx - vx) - by_s * (wx + vx)
                        by = across * ny - along * y - by_t * (wy - vy) - by_s * (wy + vy)
                        bz = across * nz - along * z - by_t * (wz - vz) - by_s * (wz + vz)
                        add_to(scratch, v_sums, bx)
                        add_to(scratch, v_sums + LANES, by)
                        add_to(scratch, v_sums + 2 * LANES, bz)
                write_sums(scratch, n_sums, 3, by_n, p)
                if with_view:
                    write_sums(scratch, v_sums, 3, by_v, p)
            write_sums(scratch, by_m, VALUES, m_sums, VALUES * tile)
