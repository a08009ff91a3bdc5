"""Half vectors and θ_d, and how they change, for second derivatives with a view per pixel.

Letters as in learn.engines.general_second: n' and v' are the direction, c' and θ' the changes along
it, d = t/‖t‖.

With u what of n stands across h, N = u·v', and v'_⊥ what of v' does, the derivatives are

    by n: w of μ, h − n of c, and of c' v'_⊥/‖s‖ − n'
    by v: u/‖s‖ of c, and of c' (what of n' stands across h)/‖s‖ − (N h + c v'_⊥ + (h·v') u)/‖s‖²;
          −¼ (‖s‖ d + ‖t‖ h) of θ_d, and of θ'
          −¼ ((d·v') h − (h·v') d − (‖s‖/‖t‖) (what of v' stands across d) + (‖t‖/‖s‖) v'_⊥)
"""

from typing import NamedTuple

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.halfway import LEAST_SQUARE, HalfVectors
from learn.engines.splines import ANGLE_TO_X
from learn.engines.triples import Triple, add_vector, dot
from learn.engines.vector import Lanes, Vector, fma, maximum, sqrt


class Angles(NamedTuple):
    """What h and θ_d are made of, for one pixel and sixteen lights, camera frame.

    h, d                  s/‖s‖ and t/‖t‖
    n_across              u, what of n stands across h
    length_s, length_t    ‖s‖ and ‖t‖; inverse_s, inverse_t: 1/‖s‖, and 1/‖t‖ held finite
    """

    h: Vector
    d: Vector
    n_across: Vector
    length_s: Lanes
    length_t: Lanes
    inverse_s: Lanes
    inverse_t: Lanes


class Along(NamedTuple):
    """The direction (n', v') of one pixel, seen from sixteen half vectors.

    n, v      n' and v'
    h_v, d_v  h·v' and d·v'
    v_across  what of v' stands across h; n_v: N = u·v'
    """

    n: Triple
    v: Triple
    h_v: Lanes
    d_v: Lanes
    v_across: Vector
    n_v: Lanes


@inlined
def angles_of(half: HalfVectors, n: Triple, t: Vector, t_square: Lanes) -> Angles:
    """The parts of half vectors h and of θ_d; t: w − v, and its ‖t‖²."""
    (x, y, z), inverse_s = half.offset, half.inverse_s
    inverse_t = 1.0 / sqrt(maximum(t_square, LEAST_SQUARE))
    hx, hy, hz = x + n[0], y + n[1], z + n[2]
    x_h = dot(half.offset, (hx, hy, hz))  # (h − n)·h is ½‖h − n‖², which keeps its digits
    return Angles(
        (hx, hy, hz),
        (t[0] * inverse_t, t[1] * inverse_t, t[2] * inverse_t),
        (fma(x_h, hx, 0.0 - x), fma(x_h, hy, 0.0 - y), fma(x_h, hz, 0.0 - z)),
        half.s_square * inverse_s,
        t_square * inverse_t,
        inverse_s,
        inverse_t,
    )


@inlined
def along_of(angles: Angles, n_along: Triple, v_along: Triple) -> Along:
    """How the direction (n', v') lies to h, d and n."""
    (hx, hy, hz), (qx, qy, qz) = angles.h, v_along
    h_v, d_v = dot(angles.h, v_along), dot(angles.d, v_along)
    v_across = qx - h_v * hx, qy - h_v * hy, qz - h_v * hz
    return Along(n_along, v_along, h_v, d_v, v_across, dot(angles.n_across, v_along))


@inlined
def x_along_of(angles: Angles, along: Along) -> Lanes:
    """x' = 8/π θ', with θ' = −¼ (‖s‖ d + ‖t‖ h)·v'."""
    return -0.25 * ANGLE_TO_X * fma(angles.length_s, along.d_v, angles.length_t * along.h_v)


@inlined
def add_by_n(
    scratch: np.ndarray,
    at: int,
    by_w: Lanes,
    w: Vector,
    by_c: Lanes,
    offset: Vector,
    by_c_along: Lanes,
    inverse_s: Lanes,
    along: Along,
) -> None:
    """Add the derivative by n to the three rows from `at` on.

    by_w, by_c, by_c_along  derivatives by μ, c and c'; offset: h − n
    """
    to_h, (qx, qy, qz), (ax, ay, az) = by_c_along * inverse_s, along.v_across, along.n
    (x, y, z), (wx, wy, wz) = offset, w
    value = (
        fma(by_w, wx, by_c * x) + (to_h * qx - by_c_along * ax),
        fma(by_w, wy, by_c * y) + (to_h * qy - by_c_along * ay),
        fma(by_w, wz, by_c * z) + (to_h * qz - by_c_along * az),
    )
    add_vector(scratch, at, value)


@inlined
def add_by_v(
    scratch: np.ndarray,
    at: int,
    by_c: Lanes,
    by_c_along: Lanes,
    by_x: Lanes,
    by_x_along: Lanes,
    c: Lanes,
    angles: Angles,
    along: Along,
) -> None:
    """Add the derivative by v, tangential, to the three rows from `at` on.

    by_c, by_c_along, by_x, by_x_along  derivatives by c, c', x and x'
    """
    inverse_s, inverse_t = angles.inverse_s, angles.inverse_t
    to_h = by_c_along * inverse_s
    twice = to_h * inverse_s
    by_theta, by_theta_along = by_x * (-0.25 * ANGLE_TO_X), by_x_along * (-0.25 * ANGLE_TO_X)
    far = by_theta_along * angles.length_s * inverse_t
    near = by_theta_along * angles.length_t * inverse_s
    # the parts along u, h, d, and along what of v' stands across h
    part_u = fma(by_c, inverse_s, 0.0 - twice * along.h_v)
    from_c = fma(to_h, dot(angles.h, along.n), twice * along.n_v)
    part_h = fma(by_theta, angles.length_t, by_theta_along * along.d_v) - from_c
    part_d = fma(by_theta, angles.length_s, far * along.d_v) - by_theta_along * along.h_v
    part_v = near - twice * c
    parts = part_u, part_h, part_d
    (ux, uy, uz), (hx, hy, hz), (dx, dy, dz) = angles.n_across, angles.h, angles.d
    (ax, ay, az), (vx, vy, vz), (qx, qy, qz) = along.n, along.v, along.v_across
    value = (
        dot(parts, (ux, hx, dx)) + (part_v * qx + to_h * ax - far * vx),
        dot(parts, (uy, hy, dy)) + (part_v * qy + to_h * ay - far * vy),
        dot(parts, (uz, hz, dz)) + (part_v * qz + to_h * az - far * vz),
    )
    add_vector(scratch, at, value)
