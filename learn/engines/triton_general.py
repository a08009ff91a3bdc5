"""CUDA kernels for a view vector per pixel, in Triton, tiled over pixels and lights.

The sum is that of learn.engines.general.

n, v      (P, 3) unit normals, and unit vectors to the viewer, camera frame
short     (P,) 1/‖v‖ − 1: what v lacks of unit length after rounding
geometry  (6, T): w (3 rows), and what rounding took off w (3 rows)
energy    (3, T): radiance × solid angle
m         (3 lobes, 3 channels, 2, 6): control values of γ and of κ log2 e
steps     (3 lobes, 3 channels, 2, 5): slopes of the splines of γ ln² 2 and of κ
          (learn.engines.lights.spline_steps)
Formulas, and why s keeps its rounding error: learn.engines.general. Passes and promises:
learn.engines.triton_distant.
"""

import triton
import triton.language as tl

from learn.engines.triton_parts import exp2, exp2m1, peak_cosine, rows, vectors

PIXELS, LIGHTS = 32, 32  # of a tile
SPLITS = 16  # parts of the pixels in the pass over lights
LN2 = tl.constexpr(0.6931471805599453)
ANGLE_TO_X = tl.constexpr(2.546479089470325)
LEAST_SQUARE = tl.constexpr(1e-9)


@triton.jit
def two_sum(
    w: tl.tensor, w_rest: tl.tensor, v: tl.tensor, short: tl.tensor
) -> tuple[tl.tensor, tl.tensor]:
    """One component of s = w + v, and what rounding took off it."""
    s = w + v
    part = s - w
    return s, ((w - (s - part)) + (v - part)) + (w_rest + v * short)


@triton.jit
def square(x: tl.tensor, y: tl.tensor, z: tl.tensor) -> tl.tensor:
    return x * x + y * y + z * z


@triton.jit
def angle(y_squared: tl.tensor, x_squared: tl.tensor) -> tl.tensor:
    """arctan(√y² / √x²) in [0, π/2]."""
    z = tl.minimum(y_squared, x_squared) / tl.maximum(y_squared, x_squared)
    p = 0.10640924 + z * (-0.07504274 + z * (0.04269128 + z * (-0.01606848 + z * 0.00284985)))
    a = tl.sqrt(z) * (0.99999998 + z * (-0.33333073 + z * (0.19992619 + z * (-0.14203642 + z * p))))
    return tl.where(y_squared > x_squared, 1.5707963267948966 - a, a)


@triton.jit
def positive_square(a: tl.tensor) -> tl.tensor:
    a = tl.maximum(a, 0.0)
    return a * a


@triton.jit
def end(x: tl.tensor) -> tuple[tl.tensor, tl.tensor]:
    return positive_square(1.0 - x), tl.where(
        x < 1.0, x * (2.0 - 1.5 * x), 0.5 * positive_square(2.0 - x)
    )


@triton.jit
def bump(distance: tl.tensor) -> tl.tensor:
    return tl.where(
        distance < 0.5, 0.75 - distance * distance, 0.5 * positive_square(1.5 - distance)
    )


@triton.jit
def basis(x: tl.tensor) -> tuple[tl.tensor, tl.tensor, tl.tensor, tl.tensor, tl.tensor, tl.tensor]:
    """The six spline functions at x = θ_d · 8/π."""
    b0, b1 = end(x)
    b5, b4 = end(4.0 - x)
    return b0, b1, bump(tl.abs(x - 1.5)), bump(tl.abs(x - 2.5)), b4, b5


@triton.jit
def curve(
    m: tl.tensor,
    o: int,
    b0: tl.tensor,
    b1: tl.tensor,
    b2: tl.tensor,
    b3: tl.tensor,
    b4: tl.tensor,
    b5: tl.tensor,
) -> tl.tensor:
    low = tl.load(m + o) * b0 + tl.load(m + o + 1) * b1 + tl.load(m + o + 2) * b2
    return low + tl.load(m + o + 3) * b3 + tl.load(m + o + 4) * b4 + tl.load(m + o + 5) * b5


@triton.jit
def slope(steps: tl.tensor, o: int, x: tl.tensor) -> tl.tensor:
    """Derivative by x of the curve with steps at o: Σ tent_j step_j."""
    result = tl.load(steps + o) * tl.maximum(1.0 - x, 0.0) + tl.load(steps + o + 4) * tl.maximum(
        x - 3.0, 0.0
    )
    result += tl.load(steps + o + 1) * tl.maximum(1.0 - tl.abs(x - 1.0), 0.0)
    result += tl.load(steps + o + 2) * tl.maximum(1.0 - tl.abs(x - 2.0), 0.0)
    return result + tl.load(steps + o + 3) * tl.maximum(1.0 - tl.abs(x - 3.0), 0.0)


@triton.jit
def place(
    geometry: tl.tensor,
    t: tl.tensor,
    lights: int,
    nx: tl.tensor,
    ny: tl.tensor,
    nz: tl.tensor,
    vx: tl.tensor,
    vy: tl.tensor,
    vz: tl.tensor,
    short: tl.tensor,
) -> tuple[
    tl.tensor,
    tl.tensor,
    tl.tensor,
    tl.tensor,
    tl.tensor,
    tl.tensor,
    tl.tensor,
    tl.tensor,
    tl.tensor,
]:
    """n·w, h − n (3), s (3), ‖s‖², ‖t‖² of a tile."""
    wx, wy, wz = rows(geometry, 0, t, lights)
    qx, qy, qz = rows(geometry, 3, t, lights)
    sx, rx = two_sum(wx, qx, vx, short)
    sy, ry = two_sum(wy, qy, vy, short)
    sz, rz = two_sum(wz, qz, vz, short)
    s_square = tl.maximum(square(sx + rx, sy + ry, sz + rz), LEAST_SQUARE)
    inverse = 1.0 / tl.sqrt(s_square)
    x = tl.fma(rx, inverse, tl.fma(sx, inverse, -nx))
    y = tl.fma(ry, inverse, tl.fma(sy, inverse, -ny))
    z = tl.fma(rz, inverse, tl.fma(sz, inverse, -nz))
    n_w = tl.maximum(nx * wx + ny * wy + nz * wz, 0.0)
    return n_w, x, y, z, sx, sy, sz, s_square, square(wx - vx, wy - vy, wz - vz)


@triton.jit
def lobe(
    m: tl.tensor,
    o: int,
    log_c: tl.tensor,
    b0: tl.tensor,
    b1: tl.tensor,
    b2: tl.tensor,
    b3: tl.tensor,
    b4: tl.tensor,
    b5: tl.tensor,
) -> tuple[tl.tensor, tl.tensor, tl.tensor, tl.tensor]:
    """γ, c^γ, exponent κ log2 e c^γ and F of the lobe and channel at offset o."""
    gamma = curve(m, o, b0, b1, b2, b3, b4, b5)
    power = exp2(gamma * log_c)
    exponent = curve(m, o + 6, b0, b1, b2, b3, b4, b5) * power
    return gamma, power, exponent, exp2m1(exponent)


@triton.jit
def channel(
    m: tl.tensor,
    k: int,
    log_c: tl.tensor,
    b0: tl.tensor,
    b1: tl.tensor,
    b2: tl.tensor,
    b3: tl.tensor,
    b4: tl.tensor,
    b5: tl.tensor,
) -> tl.tensor:
    """F of channel k: its three lobes."""
    f = lobe(m, 12 * k, log_c, b0, b1, b2, b3, b4, b5)[3]
    f += lobe(m, 12 * k + 36, log_c, b0, b1, b2, b3, b4, b5)[3]
    return f + lobe(m, 12 * k + 72, log_c, b0, b1, b2, b3, b4, b5)[3]


@triton.jit
def forward(
    n: tl.tensor,
    v: tl.tensor,
    short: tl.tensor,
    geometry: tl.tensor,
    energy: tl.tensor,
    m: tl.tensor,
    radiance: tl.tensor,
    pixels: int,
    lights: int,
    PIXELS: tl.constexpr,
    LIGHTS: tl.constexpr,
) -> None:
    """Radiance (P, 3); one program a tile of pixels."""
    p = tl.program_id(0) * PIXELS + tl.arange(0, PIXELS)
    inside = p < pixels
    nx, ny, nz = vectors(n, p, inside)
    vx, vy, vz = vectors(v, p, inside)
    lack = tl.load(short + p, mask=inside, other=0.0)[:, None]
    i0 = tl.zeros((PIXELS,), tl.float32)
    i1 = tl.zeros((PIXELS,), tl.float32)
    i2 = tl.zeros((PIXELS,), tl.float32)
    for start in range(0, lights, LIGHTS):
        t = start + tl.arange(0, LIGHTS)
        n_w, x, y, z, _sx, _sy, _sz, s_square, t_square = place(
            geometry, t, lights, nx, ny, nz, vx, vy, vz, lack
        )
        if tl.max(n_w) > 0.0:
            log_c = peak_cosine(x, y, z)[1]
            b0, b1, b2, b3, b4, b5 = basis(angle(t_square, s_square) * ANGLE_TO_X)
            e0, e1, e2 = rows(energy, 0, t, lights)
            i0 += tl.sum(channel(m, 0, log_c, b0, b1, b2, b3, b4, b5) * n_w * e0, 1)
            i1 += tl.sum(channel(m, 1, log_c, b0, b1, b2, b3, b4, b5) * n_w * e1, 1)
            i2 += tl.sum(channel(m, 2, log_c, b0, b1, b2, b3, b4, b5) * n_w * e2, 1)
    tl.store(radiance + 3 * p, i0, mask=inside)
    tl.store(radiance + 3 * p + 1, i1, mask=inside)
    tl.store(radiance + 3 * p + 2, i2, mask=inside)


@triton.jit
def backward_pixels(
    n: tl.tensor,
    v: tl.tensor,
    short: tl.tensor,
    geometry: tl.tensor,
    energy: tl.tensor,
    m: tl.tensor,
    steps: tl.tensor,
    g: tl.tensor,
    by_n: tl.tensor,
    by_v: tl.tensor,
    pixels: int,
    lights: int,
    PIXELS: tl.constexpr,
    LIGHTS: tl.constexpr,
) -> None:
    """Derivatives by n and v (P, 3), right in their tangential parts; one program per tile."""
    p = tl.program_id(0) * PIXELS + tl.arange(0, PIXELS)
    inside = p < pixels
    nx, ny, nz = vectors(n, p, inside)
    vx, vy, vz = vectors(v, p, inside)
    lack = tl.load(short + p, mask=inside, other=0.0)[:, None]
    n0 = tl.zeros((PIXELS,), tl.float32)
    n1 = tl.zeros((PIXELS,), tl.float32)
    n2 = tl.zeros((PIXELS,), tl.float32)
    v0 = tl.zeros((PIXELS,), tl.float32)
    v1 = tl.zeros((PIXELS,), tl.float32)
    v2 = tl.zeros((PIXELS,), tl.float32)
    for start in range(0, lights, LIGHTS):
        t = start + tl.arange(0, LIGHTS)
        n_w, x, y, z, sx, sy, sz, s_square, t_square = place(
            geometry, t, lights, nx, ny, nz, vx, vy, vz, lack
        )
        if tl.max(n_w) > 0.0:
            c, log_c = peak_cosine(x, y, z)
            at = angle(t_square, s_square) * ANGLE_TO_X
            b0, b1, b2, b3, b4, b5 = basis(at)
            by_w = tl.zeros((PIXELS, LIGHTS), tl.float32)
            by_c = tl.zeros((PIXELS, LIGHTS), tl.float32)
            by_x = tl.zeros((PIXELS, LIGHTS), tl.float32)
            for i in range(9):  # lobe i // 3, channel i % 3
                o = 12 * i
                ge = (
                    tl.load(g + 3 * p + i % 3, mask=inside, other=0.0)[:, None]
                    * tl.load(energy + (i % 3) * lights + t)[None, :]
                )
                gamma, power, exponent, f = lobe(m, o, log_c, b0, b1, b2, b3, b4, b5)
                weight = ge * n_w * (f + 1.0)
                by_w += ge * f
                by_c += weight * exponent * gamma
                by_x += weight * (
                    exponent * log_c * slope(steps, 10 * i, at)
                    + power * slope(steps, 10 * i + 5, at)
                )
            by_w = tl.where(n_w > 0.0, by_w, 0.0)
            by_c *= LN2 / c
            wx, wy, wz = rows(geometry, 0, t, lights)
            n0 += tl.sum(by_w * wx + by_c * x, 1)
            n1 += tl.sum(by_w * wy + by_c * y, 1)
            n2 += tl.sum(by_w * wz + by_c * z, 1)
            inverse = 1.0 / tl.sqrt(s_square)
            by_c *= inverse
            hx, hy, hz = x + nx, y + ny, z + nz
            along = by_c * (x * hx + y * hy + z * hz)
            by_theta = (
                by_x * (0.25 * ANGLE_TO_X) * inverse / tl.sqrt(tl.maximum(t_square, LEAST_SQUARE))
            )
            by_t, by_s = by_theta * s_square, by_theta * t_square
            v0 += tl.sum(along * hx - by_c * x - by_t * (wx - vx) - by_s * sx, 1)
            v1 += tl.sum(along * hy - by_c * y - by_t * (wy - vy) - by_s * sy, 1)
            v2 += tl.sum(along * hz - by_c * z - by_t * (wz - vz) - by_s * sz, 1)
    tl.store(by_n + 3 * p, n0, mask=inside)
    tl.store(by_n + 3 * p + 1, n1, mask=inside)
    tl.store(by_n + 3 * p + 2, n2, mask=inside)
    tl.store(by_v + 3 * p, v0, mask=inside)
    tl.store(by_v + 3 * p + 1, v1, mask=inside)
    tl.store(by_v + 3 * p + 2, v2, mask=inside)


@triton.jit
def add_curve(
    q: tl.tensor,
    b0: tl.tensor,
    b1: tl.tensor,
    b2: tl.tensor,
    b3: tl.tensor,
    b4: tl.tensor,
    b5: tl.tensor,
    sums: tl.tensor,
) -> tl.tensor:
    """sums (8,) += Σ q b_t in places 0 … 5."""
    i = tl.arange(0, 8)
    sums += tl.where(i == 0, tl.sum(q * b0), 0.0) + tl.where(i == 1, tl.sum(q * b1), 0.0)
    sums += tl.where(i == 2, tl.sum(q * b2), 0.0) + tl.where(i == 3, tl.sum(q * b3), 0.0)
    return sums + tl.where(i == 4, tl.sum(q * b4), 0.0) + tl.where(i == 5, tl.sum(q * b5), 0.0)


@triton.jit
def backward_lights(
    n: tl.tensor,
    v: tl.tensor,
    short: tl.tensor,
    geometry: tl.tensor,
    energy: tl.tensor,
    m: tl.tensor,
    g: tl.tensor,
    energy_sums: tl.tensor,
    m_sums: tl.tensor,
    pixels: int,
    lights: int,
    split: int,
    PIXELS: tl.constexpr,
    LIGHTS: tl.constexpr,
) -> None:
    """Sums over one part of the pixels: one program per tile of lights, part, lobe and channel.

    split        pixels of a part, a multiple of PIXELS
    energy_sums  (SPLITS, 9, T) out: Σ g F max(0, n·w) of lobe i // 3, channel i % 3
    m_sums       (light tiles, SPLITS, 9, 2, 8) out: derivatives by γ ln² 2 and by κ in the first
                 six places
    """
    t = tl.program_id(0) * LIGHTS + tl.arange(0, LIGHTS)
    i = tl.program_id(2)
    energy_k = tl.load(energy + (i % 3) * lights + t)[None, :]
    total = tl.zeros((LIGHTS,), tl.float32)
    by_gamma = tl.zeros((8,), tl.float32)
    by_kappa = tl.zeros((8,), tl.float32)
    first = tl.program_id(1) * split
    for start in range(first, tl.minimum(first + split, pixels), PIXELS):
        p = start + tl.arange(0, PIXELS)
        inside = p < pixels
        nx, ny, nz = vectors(n, p, inside)
        vx, vy, vz = vectors(v, p, inside)
        lack = tl.load(short + p, mask=inside, other=0.0)[:, None]
        n_w, x, y, z, _sx, _sy, _sz, s_square, t_square = place(
            geometry, t, lights, nx, ny, nz, vx, vy, vz, lack
        )
        if tl.max(n_w) > 0.0:
            log_c = peak_cosine(x, y, z)[1]
            b0, b1, b2, b3, b4, b5 = basis(angle(t_square, s_square) * ANGLE_TO_X)
            _gamma, power, exponent, f = lobe(m, 12 * i, log_c, b0, b1, b2, b3, b4, b5)
            weight = n_w * tl.load(g + 3 * p + i % 3, mask=inside, other=0.0)[:, None]
            total += tl.sum(f * weight, 0)
            q = weight * energy_k * (f + 1.0)
            by_gamma = add_curve(q * exponent * log_c, b0, b1, b2, b3, b4, b5, by_gamma)
            by_kappa = add_curve(q * power, b0, b1, b2, b3, b4, b5, by_kappa)
    tl.store(energy_sums + (tl.program_id(1) * 9 + i) * lights + t, total)
    out = (
        m_sums
        + ((tl.program_id(0) * tl.num_programs(1) + tl.program_id(1)) * 9 + i) * 16
        + tl.arange(0, 8)
    )
    tl.store(out, by_gamma)
    tl.store(out + 8, by_kappa)
