"""CUDA kernels for a distant viewer, in Triton, tiled over pixels and lights.

The sum is that of learn.engines.distant.

n         (P, 3) unit normals, camera frame, group after group
offsets    (G + 1,) int32: the pixels of group j are offsets[j] … offsets[j + 1] − 1
geometry  (9, T): w (3 rows), h (3 rows), and what rounding took off h (3 rows)
energy    (G, 3, T): radiance × solid angle
lobes     (G, 18, T): rows 6 s + 2 k (γ) and 6 s + 2 k + 1 (κ log2 e) of lobe s, channel k
G groups of pixels, each of one material under one light: a training batch has as many as pictures,
with few pixels each, so that all of them are summed by one launch. T lights, a multiple of LIGHTS.
float32 throughout; nothing of size pixels × lights is ever stored,
values of the forward pass are computed again. Derivatives by pixels and by lights are two passes,
each the only writer of what it writes: no atomics, the same bits every time.

No accelerator was at hand when these were written: tests run them through Triton's interpreter
(TRITON_INTERPRET=1) on the CPU. The tile sizes are estimates.
"""

import triton
import triton.language as tl

from learn.engines.triton_parts import exp2, exp2m1, peak_cosine, rows, vectors

PIXELS, LIGHTS = 32, 32  # of a tile
# parts of a group's pixels in the pass over lights, at most; a function of the largest group alone,
# so that sums do not depend on the device
SPLITS = 16
LN2 = tl.constexpr(0.6931471805599453)


@triton.jit
def pixels_of(offsets: tl.tensor, group: int, PIXELS: tl.constexpr) -> tuple[tl.tensor, tl.tensor]:
    """This program's pixels of a group, and which of them the group has."""
    p = tl.load(offsets + group) + tl.program_id(0) * PIXELS + tl.arange(0, PIXELS)
    return p, p < tl.load(offsets + group + 1)


@triton.jit
def half_offset(
    geometry: tl.tensor, t: tl.tensor, lights: int, nx: tl.tensor, ny: tl.tensor, nz: tl.tensor
) -> tuple[tl.tensor, tl.tensor, tl.tensor]:
    hx, hy, hz = rows(geometry, 3, t, lights)
    rx, ry, rz = rows(geometry, 6, t, lights)
    return (hx - nx) + rx, (hy - ny) + ry, (hz - nz) + rz


@triton.jit
def lobe(
    lobes: tl.tensor, row: int, t: tl.tensor, lights: int, log_c: tl.tensor
) -> tuple[tl.tensor, tl.tensor]:
    """Of the lobe and channel at `row`: F and dF/dc · c log2 e, over one tile."""
    gamma = tl.load(lobes + row * lights + t)[None, :]
    kappa = tl.load(lobes + (row + 1) * lights + t)[None, :]
    exponent = kappa * exp2(gamma * log_c)
    value = exp2m1(exponent)
    return value, (value + 1.0) * exponent * gamma


@triton.jit
def channel(
    lobes: tl.tensor, k: int, t: tl.tensor, lights: int, log_c: tl.tensor
) -> tuple[tl.tensor, tl.tensor]:
    """The three lobes of channel k together."""
    f0, d0 = lobe(lobes, 2 * k, t, lights, log_c)
    f1, d1 = lobe(lobes, 2 * k + 6, t, lights, log_c)
    f2, d2 = lobe(lobes, 2 * k + 12, t, lights, log_c)
    return f0 + f1 + f2, d0 + d1 + d2


@triton.jit
def forward(
    n: tl.tensor,
    offsets: tl.tensor,
    geometry: tl.tensor,
    energy: tl.tensor,
    lobes: tl.tensor,
    radiance: tl.tensor,
    lights: int,
    PIXELS: tl.constexpr,
    LIGHTS: tl.constexpr,
) -> None:
    """Radiance (P, 3); one program a tile of pixels of one group."""
    group = tl.program_id(1)
    p, inside = pixels_of(offsets, group, PIXELS)
    energy += group * 3 * lights
    lobes += group * 18 * lights
    nx, ny, nz = vectors(n, p, inside)
    i0 = tl.zeros((PIXELS,), tl.float32)
    i1 = tl.zeros((PIXELS,), tl.float32)
    i2 = tl.zeros((PIXELS,), tl.float32)
    for start in range(0, lights, LIGHTS):
        t = start + tl.arange(0, LIGHTS)
        wx, wy, wz = rows(geometry, 0, t, lights)
        n_w = tl.maximum(nx * wx + ny * wy + nz * wz, 0.0)
        if tl.max(n_w) > 0.0:
            x, y, z = half_offset(geometry, t, lights, nx, ny, nz)
            log_c = peak_cosine(x, y, z)[1]
            e0, e1, e2 = rows(energy, 0, t, lights)
            i0 += tl.sum(channel(lobes, 0, t, lights, log_c)[0] * n_w * e0, 1)
            i1 += tl.sum(channel(lobes, 1, t, lights, log_c)[0] * n_w * e1, 1)
            i2 += tl.sum(channel(lobes, 2, t, lights, log_c)[0] * n_w * e2, 1)
    tl.store(radiance + 3 * p, i0, mask=inside)
    tl.store(radiance + 3 * p + 1, i1, mask=inside)
    tl.store(radiance + 3 * p + 2, i2, mask=inside)


@triton.jit
def backward_pixels(
    n: tl.tensor,
    offsets: tl.tensor,
    geometry: tl.tensor,
    energy: tl.tensor,
    lobes: tl.tensor,
    g: tl.tensor,
    by_n: tl.tensor,
    lights: int,
    PIXELS: tl.constexpr,
    LIGHTS: tl.constexpr,
) -> None:
    """Derivative by n (P, 3), tangential up to a radial part; programs as of `forward`."""
    group = tl.program_id(1)
    p, inside = pixels_of(offsets, group, PIXELS)
    energy += group * 3 * lights
    lobes += group * 18 * lights
    nx, ny, nz = vectors(n, p, inside)
    g0, g1, g2 = vectors(g, p, inside)
    bx = tl.zeros((PIXELS,), tl.float32)
    by = tl.zeros((PIXELS,), tl.float32)
    bz = tl.zeros((PIXELS,), tl.float32)
    for start in range(0, lights, LIGHTS):
        t = start + tl.arange(0, LIGHTS)
        wx, wy, wz = rows(geometry, 0, t, lights)
        n_w = tl.maximum(nx * wx + ny * wy + nz * wz, 0.0)
        if tl.max(n_w) > 0.0:
            x, y, z = half_offset(geometry, t, lights, nx, ny, nz)
            c, log_c = peak_cosine(x, y, z)
            e0, e1, e2 = rows(energy, 0, t, lights)
            f0, d0 = channel(lobes, 0, t, lights, log_c)
            f1, d1 = channel(lobes, 1, t, lights, log_c)
            f2, d2 = channel(lobes, 2, t, lights, log_c)
            by_w = tl.where(n_w > 0.0, f0 * g0 * e0 + f1 * g1 * e1 + f2 * g2 * e2, 0.0)
            by_c = (d0 * g0 * e0 + d1 * g1 * e1 + d2 * g2 * e2) * n_w * LN2 / c
            bx += tl.sum(by_w * wx + by_c * x, 1)
            by += tl.sum(by_w * wy + by_c * y, 1)
            bz += tl.sum(by_w * wz + by_c * z, 1)
    tl.store(by_n + 3 * p, bx, mask=inside)
    tl.store(by_n + 3 * p + 1, by, mask=inside)
    tl.store(by_n + 3 * p + 2, bz, mask=inside)


@triton.jit
def lobe_sums(
    lobes: tl.tensor,
    row: int,
    t: tl.tensor,
    lights: int,
    log_c: tl.tensor,
    weight: tl.tensor,
    by_kappa: tl.tensor,
    by_gamma: tl.tensor,
) -> tuple[tl.tensor, tl.tensor, tl.tensor]:
    """F, and the two sums over pixels of learn.engines.distant.backward with this tile added."""
    gamma = tl.load(lobes + row * lights + t)[None, :]
    kappa = tl.load(lobes + (row + 1) * lights + t)[None, :]
    power = exp2(gamma * log_c)
    value = exp2m1(kappa * power)
    q = weight * (value + 1.0) * power
    return value, by_kappa + tl.sum(q, 0), by_gamma + tl.sum(q * log_c, 0)


@triton.jit
def backward_lights(
    n: tl.tensor,
    offsets: tl.tensor,
    geometry: tl.tensor,
    lobes: tl.tensor,
    g: tl.tensor,
    sums: tl.tensor,
    lights: int,
    split: int,
    PIXELS: tl.constexpr,
    LIGHTS: tl.constexpr,
) -> None:
    """Sums over a part of a group's pixels: one program a tile of lights, a part and a channel.

    The third place of the grid is 3 times the group plus the channel.

    split  pixels of a part, a multiple of PIXELS
    sums   (G, parts, 3 channels, 7, T) out: Σ g F max(0, n·w), then of each lobe Σ g max(0, n·w) x
           c^γ and the same times log2 c
    """
    t = tl.program_id(0) * LIGHTS + tl.arange(0, LIGHTS)
    group, k = tl.program_id(2) // 3, tl.program_id(2) % 3
    lobes += group * 18 * lights
    wx, wy, wz = rows(geometry, 0, t, lights)
    energy = tl.zeros((LIGHTS,), tl.float32)
    a0 = tl.zeros((LIGHTS,), tl.float32)
    a1 = tl.zeros((LIGHTS,), tl.float32)
    a2 = tl.zeros((LIGHTS,), tl.float32)
    b0 = tl.zeros((LIGHTS,), tl.float32)
    b1 = tl.zeros((LIGHTS,), tl.float32)
    b2 = tl.zeros((LIGHTS,), tl.float32)
    end = tl.load(offsets + group + 1)
    first = tl.load(offsets + group) + tl.program_id(1) * split
    for start in range(first, tl.minimum(first + split, end), PIXELS):
        p = start + tl.arange(0, PIXELS)
        inside = p < end
        nx, ny, nz = vectors(n, p, inside)
        n_w = tl.maximum(nx * wx + ny * wy + nz * wz, 0.0)
        if tl.max(n_w) > 0.0:
            weight = n_w * tl.load(g + 3 * p + k, mask=inside, other=0.0)[:, None]
            x, y, z = half_offset(geometry, t, lights, nx, ny, nz)
            log_c = peak_cosine(x, y, z)[1]
            f0, a0, b0 = lobe_sums(lobes, 2 * k, t, lights, log_c, weight, a0, b0)
            f1, a1, b1 = lobe_sums(lobes, 2 * k + 6, t, lights, log_c, weight, a1, b1)
            f2, a2, b2 = lobe_sums(lobes, 2 * k + 12, t, lights, log_c, weight, a2, b2)
            energy += tl.sum((f0 + f1 + f2) * weight, 0)
    part = group * tl.num_programs(1) + tl.program_id(1)
    out = sums + (part * 3 + k) * 7 * lights + t
    tl.store(out, energy)
    tl.store(out + lights, a0)
    tl.store(out + 2 * lights, b0)
    tl.store(out + 3 * lights, a1)
    tl.store(out + 4 * lights, b1)
    tl.store(out + 5 * lights, a2)
    tl.store(out + 6 * lights, b2)
