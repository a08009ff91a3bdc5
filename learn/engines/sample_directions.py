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

learn.engines.sample_derivatives has the derivatives.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from learn.engines.compilation import inlined
from learn.engines.exponentials import angle
from learn.engines.footprints import (
    TINY,
    add_radiance,
    footprint,
    in_one_texel,
    store_footprint,
    texel_of,
)
from learn.engines.general import reflectance
from learn.engines.layout import (
    LANES,
    NEGLIGIBLE,
    SAMPLE_LOG_COSINE,
    SAMPLE_SOLID_ANGLE,
    SAMPLE_STRIDE,
    SAMPLE_TILE,
    SAMPLE_X,
    SAMPLE_Y,
    SAMPLE_Z,
)
from learn.engines.splines import basis
from learn.engines.triples import (
    Triple,
    dot,
    vector_at,
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
    store,
)

FORWARD = types.void(*[types.int64] * 6, *[FLOAT_POINTER] * 9)


class Sample(NamedTuple):
    """Sixteen half vectors about the z axis, at polar angle θ and azimuth φ.

    x, y, c      sin θ cos φ, sin θ sin φ and cos θ; log_c: log2 cos θ
    solid_angle  dω_h in sr
    """

    x: Lanes
    y: Lanes
    c: Lanes
    log_c: Lanes
    solid_angle: Lanes


@inlined
def sample_at(around: np.ndarray, o: int) -> Sample:
    """The sixteen samples at offset o."""
    return Sample(
        load(around, o + LANES * SAMPLE_X),
        load(around, o + LANES * SAMPLE_Y),
        load(around, o + LANES * SAMPLE_Z),
        load(around, o + LANES * SAMPLE_LOG_COSINE),
        load(around, o + LANES * SAMPLE_SOLID_ANGLE),
    )


@inlined
def tangents(nx: float, ny: float, nz: float) -> tuple[Triple, Triple]:
    """Two axes across n that turn smoothly with it (Duff et al. 2017)."""
    sign = -1.0 if nz < 0.0 else 1.0
    a = -1.0 / (sign + nz)
    u = 1.0 + sign * nx * nx * a, sign * nx * ny * a, -sign * nx
    return u, (nx * ny * a, sign + ny * ny * a, -ny)


@inlined
def mirror(h: Vector, cos_d: Lanes, v: Triple) -> Vector:
    """The direction w = 2 (v·h) h − v into which half vectors h mirror the view."""
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
        normal, view = vector_at(n, 3 * p), vector_at(v, 3 * p)
        nx, ny, nz = normal
        (ux, uy, uz), (tx, ty, tz) = tangents(nx, ny, nz)
        i0, i1, i2 = 0.0, 0.0, 0.0
        for block in range(blocks):
            q, r, c, log_c, solid_angle = sample_at(around, SAMPLE_STRIDE * block)
            h = (
                fma(q, ux, fma(r, tx, c * nx)),
                fma(q, uy, fma(r, ty, c * ny)),
                fma(q, uz, fma(r, tz, c * nz)),
            )
            cos_d = dot(h, view)
            w = mirror(h, cos_d, view)
            weight = maximum(dot(w, normal), 0.0) * maximum(cos_d, 0.0) * solid_angle * 4.0
            if not anywhere(weight > 0.0):
                continue
            b = basis(angle(maximum(1.0 - cos_d * cos_d, 0.0), cos_d * cos_d + TINY))
            f0, f1, f2 = reflectance(m, least, NEGLIGIBLE, lane_max(log_c), log_c, b)
            at = footprint(w, 4.0 * maximum(cos_d, 0.0) * solid_angle, rotation, height, width)
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
