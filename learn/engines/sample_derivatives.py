"""Kernels of the derivatives of the half-vector quadrature of learn.engines.sample_directions.

Letters and arrays as there. The backward pass holds w_i and dω_i, as learn.methods.half_vectors
says, and computes the rest again:

    ∂μ/∂n = w    ∂c/∂n = h − c n    ∂c/∂v = (n − c h)/‖w + v‖, with ‖w + v‖ = 2 v·h    θ_d as in
    learn.engines.general
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.distant import LN2, is_seen
from learn.engines.exponentials import angle
from learn.engines.footprints import (
    TINY,
    Footprint,
    footprint,
    gather,
    in_one_texel,
    scatter,
    store_footprint,
    texel_of,
)
from learn.engines.general import Material, Spline, by_s_and_t, channel_backward
from learn.engines.halfway import LEAST_SQUARE
from learn.engines.layout import (
    FOOTPRINT_BY_M,
    FOOTPRINT_BY_N,
    FOOTPRINT_BY_V,
    FOOTPRINT_LIGHT,
    LANES,
    NEGLIGIBLE,
    SAMPLE_CHUNKS,
    SAMPLE_SCRATCH,
    SAMPLE_STRIDE,
    SAMPLE_TILE,
    VALUES,
)
from learn.engines.sample_directions import Sample, mirror, sample_at, tangents
from learn.engines.splines import basis, tents
from learn.engines.triples import (
    Triple,
    add_vector,
    clear,
    combined,
    difference,
    dot,
    vector_at,
    write_sums,
)
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

BACKWARD = types.void(*[types.int64] * 8, *[FLOAT_POINTER] * 14)


class Reflection(NamedTuple):
    """What sixteen half vectors h about a pixel's normal reflect, camera frame.

    across  h − c n, which stands across n
    cos_d   v·h
    w       2 (v·h) h − v, and n_w its n·w
    spread  dω = 4 (v·h) dω_h in sr, 0 where h faces away
    """

    across: Vector
    cos_d: Lanes
    w: Vector
    n_w: Lanes
    spread: Lanes


class LightMap(NamedTuple):
    """The light's radiance (height, width, 3), and its size."""

    light: np.ndarray
    height: int
    width: int


@inlined
def reflection(sample: Sample, n: Triple, u: Triple, t: Triple, v: Triple) -> Reflection:
    """The directions into which half vectors about n mirror the view; u, t: axes across n."""
    q, r, c = sample.x, sample.y, sample.c
    x, y, z = fma(q, u[0], r * t[0]), fma(q, u[1], r * t[1]), fma(q, u[2], r * t[2])
    h = fma(c, n[0], x), fma(c, n[1], y), fma(c, n[2], z)
    cos_d = dot(h, v)
    w = mirror(h, cos_d, v)
    spread = maximum(cos_d, 0.0) * sample.solid_angle * 4.0
    return Reflection((x, y, z), cos_d, w, dot(w, n), spread)


@inlined
def look_up_light(scratch: np.ndarray, work: int, texels: LightMap, at: Footprint) -> int:
    """Write the footprints, and the mean light in them, into a chunk's rows.

    work     offset of the rows
    Returns  the place of the first channel of the texel in which all footprints lie, or −1
    """
    light, height, width = texels
    store_footprint(scratch, work, at)
    if not in_one_texel(at):
        gather(scratch, work, light, height, width)
        return -1
    texel = 3 * texel_of(at, height, width)
    for k in range(3):
        store(scratch, work + LANES * (FOOTPRINT_LIGHT + k), splat(light[texel + k]))
    return texel


@inlined
def add_by_light(
    scratch: np.ndarray, work: int, texel: int, texels: LightMap, light_sums: np.ndarray, to: int
) -> None:
    """Add the derivatives by the lanes' light, a chunk's first three rows, to those by its texels.

    texel  as of `look_up_light`; to: where the chunk's map begins in light_sums
    """
    if texel < 0:
        scatter(scratch, work, light_sums, to, texels.height, texels.width)
        return
    for k in range(3):
        light_sums[to + texel + k] += lane_sum(load(scratch, work + LANES * k))


@inlined
def samples_backward(
    material: Material,
    log_c: Lanes,
    nearest: float,
    spline: Spline,
    mu: Lanes,
    spread: Lanes,
    g: np.ndarray,
    p: int,
    scratch: np.ndarray,
    work: int,
    by_m: int,
    with_view: int,
) -> Vector:
    """Derivatives of Σ_k g_k I_k of one pixel and sixteen samples: by n·w, by c, and by x.

    That by c is × c log2 e; x is the spline's. Those by the light seen are written into a chunk's
    first three rows, and those by m are added.

    nearest     the largest log2 c
    mu, spread  max(0, n·w) dω, and dω
    g           (P, 3) of which the pixel's begins at place p
    work, by_m  offsets in scratch of the chunk's rows, and of the sums by m
    """
    by_w, by_c, by_x = splat(0.0), splat(0.0), splat(0.0)
    for k in range(3):
        seen = load(scratch, work + LANES * (FOOTPRINT_LIGHT + k)) * g[p + k]
        weight = mu * seen
        f, d_c, d_x = channel_backward(
            material, k, NEGLIGIBLE, nearest, log_c, spline, weight, scratch, by_m, with_view
        )
        store(scratch, work + LANES * k, f * mu * g[p + k])
        by_w = fma(f * spread, seen, by_w)
        by_c = fma(d_c, weight, by_c)
        by_x = fma(d_x, weight, by_x)
    return by_w, by_c, by_x


@inlined
def add_by_view(
    sums: np.ndarray,
    a: int,
    sample: Sample,
    ray: Reflection,
    n: Triple,
    v: Triple,
    s_square: Lanes,
    t_square: Lanes,
    by_c: Lanes,
    by_x: Lanes,
) -> None:
    """Add the derivative by the view to the three rows from offset a on.

    s_square, t_square  ‖w + v‖² and ‖w − v‖²
    by_c, by_x          derivatives by c and by the spline's x
    n − c h is taken as sin² θ n − c (h − c n): nothing cancels at a lobe's peak.
    """
    (x, y, z), (wx, wy, wz), (vx, vy, vz) = ray.across, ray.w, v
    inverse = 1.0 / sqrt(s_square)
    by_c = by_c * inverse
    across, along = by_c * fma(sample.x, sample.x, sample.y * sample.y), by_c * sample.c
    by_s, by_t = by_s_and_t(by_x, s_square, t_square, inverse)
    value = (
        across * n[0] - along * x - by_t * (wx - vx) - by_s * (wx + vx),
        across * n[1] - along * y - by_t * (wy - vy) - by_s * (wy + vy),
        across * n[2] - along * z - by_t * (wz - vz) - by_s * (wz + vz),
    )
    add_vector(sums, a, value)


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
    material, texels = Material(m, steps, least), LightMap(light, height, width)
    for chunk in range(first, last):
        work = SAMPLE_SCRATCH * chunk
        n_sums, v_sums = work + LANES * FOOTPRINT_BY_N, work + LANES * FOOTPRINT_BY_V
        by_m = work + LANES * FOOTPRINT_BY_M
        for tile in range(chunk * tiles // SAMPLE_CHUNKS, (chunk + 1) * tiles // SAMPLE_CHUNKS):
            clear(scratch, by_m, VALUES)
            for p in range(3 * SAMPLE_TILE * tile, 3 * min(SAMPLE_TILE * (tile + 1), pixels), 3):
                normal, view = vector_at(n, p), vector_at(v, p)
                u_axis, t_axis = tangents(normal[0], normal[1], normal[2])
                clear(scratch, n_sums, 6)
                for block in range(blocks):
                    sample = sample_at(around, SAMPLE_STRIDE * block)
                    nearest = lane_max(sample.log_c)
                    if not is_seen(nearest, least, 0, NEGLIGIBLE):
                        break  # samples farther out see less
                    ray = reflection(sample, normal, u_axis, t_axis, view)
                    mu = maximum(ray.n_w, 0.0) * ray.spread
                    if not anywhere(mu > 0.0):
                        continue
                    at = footprint(ray.w, ray.spread, rotation, height, width)
                    texel = look_up_light(scratch, work, texels, at)
                    t = difference(ray.w, view)
                    t_square = dot(t, t)
                    s_square = maximum(4.0 * ray.cos_d * ray.cos_d, LEAST_SQUARE)
                    theta_d = angle(t_square, s_square)
                    by_w, by_c, by_x = samples_backward(
                        material, sample.log_c, nearest, Spline(basis(theta_d), tents(theta_d)),
                        mu, ray.spread, g, p, scratch, work, by_m, with_view,
                    )  # fmt: skip
                    if with_light:
                        to = 3 * height * width * chunk
                        add_by_light(scratch, work, texel, texels, light_sums, to)
                    by_w = select(ray.n_w > 0.0, by_w, 0.0)
                    by_c = by_c * LN2 / maximum(sample.c, TINY)
                    add_vector(scratch, n_sums, combined(by_w, ray.w, by_c, ray.across))
                    if with_view:
                        add_by_view(
                            scratch, v_sums, sample, ray, normal, view, s_square, t_square,
                            by_c, by_x,
                        )  # fmt: skip
                write_sums(scratch, n_sums, 3, by_n, p)
                if with_view:
                    write_sums(scratch, v_sums, 3, by_v, p)
            write_sums(scratch, by_m, VALUES, m_sums, VALUES * tile)
