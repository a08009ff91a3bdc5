"""The loops of shaders.direct_light, compiled by numba.

They evaluate the closed forms of shaders.closures, whose letters they have, in float32, where
polynomials stand for exponentials and logarithms: they are inlined, and sixteen lanes wide.
tests/shaders/test_direct_light.py compares them with shaders.closures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

DIFFUSE, GGX, BECKMANN, ASHIKHMIN_SHIRLEY, SHEEN = range(5)
KINDS = {"diffuse": 0, "ggx": 1, "beckmann": 2, "ashikhmin_shirley": 3, "sheen": 4}
LEAST_EXTENT = np.float32(3)  # in units of tan θ_h / α
SHORT_TAILED = np.float32(25)  # t at which exponential lobes have ended
ONE = np.float32(1)
HALF = np.float32(0.5)
LEAST = np.float32(1e-4)  # cosine; shaders.closures.MIN_COS
PI = np.float32(math.pi)
GOLDEN = np.float32((math.sqrt(5) - 1) / 2)
SHIFT = np.float32(0.7548776662)  # irrational, and independent of the golden ratio

_inlined = njit(forceinline=True, fastmath=True, error_model="numpy")


def _compiled(function: Callable[..., Any]) -> Any:
    """Return the function compiled, from numba's cache where a folder for it can be written."""
    options: dict[str, Any] = {"fastmath": True, "error_model": "numpy", "nogil": True}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # neither beside this file nor in the user's cache folder
        return njit(**options)(function)


@_inlined
def _exp(x):
    """e^x for x ≤ 0: relative error below 3e-4 to −5, 0.3 % to −10."""
    y = max(x, np.float32(-80)) * np.float32(1 / 256)
    y = ONE + y + HALF * y * y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    return y


@_inlined
def _log(c):
    """Logarithm of c in (0, 1]: relative error below 1e-4 above 0.4, 2 % at 0.1."""
    z = (c - ONE) / (c + ONE)
    s = z * z
    tail = np.float32(1 / 9) + s * (np.float32(1 / 11) + s * np.float32(1 / 13))
    tail = np.float32(1 / 5) + s * (np.float32(1 / 7) + s * tail)
    return np.float32(2) * z * (ONE + s * (np.float32(1 / 3) + s * tail))


@_inlined
def _arctan(y, x):
    """Angle of (x, y) in radians, 1e-5."""
    ax, ay = abs(x), abs(y)
    small = min(ax, ay) / max(max(ax, ay), np.float32(1e-20))
    s = small * small
    a = np.float32(-0.01172120) * s + np.float32(0.05265332)
    a = a * s - np.float32(0.11643287)
    a = a * s + np.float32(0.19354346)
    a = a * s - np.float32(0.33262347)
    a = (a * s + np.float32(0.99997726)) * small
    a = np.float32(math.pi / 2) - a if ay > ax else a
    a = PI - a if x < 0 else a
    return -a if y < 0 else a


@_inlined
def _ggx(alpha, ci, co, ch, cd):
    a2 = alpha * alpha
    spread = (ONE - ch * ch) + a2 * ch * ch
    d = a2 / (PI * spread * spread)
    root_i = math.sqrt(ci * ci + a2 * (ONE - ci * ci))
    root_o = math.sqrt(co * co + a2 * (ONE - co * co))
    # cos_i cos_o of the denominator, multiplied into the roots
    return d / (HALF * (root_i * co + root_o * ci)) * np.float32(0.25)


@_inlined
def _smith(c, alpha):
    x = c / (math.sqrt(ONE - c * c + np.float32(1e-12)) * alpha)
    near = min(x, np.float32(1.6))
    value = (ONE - np.float32(1.259) * near + np.float32(0.396) * near * near) / (
        np.float32(3.535) * near + np.float32(2.181) * near * near + np.float32(1e-30)
    )
    return value if x < np.float32(1.6) else np.float32(0)


@_inlined
def _beckmann(alpha, ci, co, ch, cd):
    c2 = ch * ch
    a2 = alpha * alpha
    d = _exp(-(ONE - c2) / (c2 * a2)) / (PI * a2 * c2 * c2)
    return d / (ONE + _smith(ci, alpha) + _smith(co, alpha)) / (np.float32(4) * ci * co)


@_inlined
def _ashikhmin_shirley(alpha, ci, co, ch, cd):
    n = np.float32(2) / (alpha * alpha) - np.float32(2)
    return (n + ONE) / (np.float32(8) * PI) * _exp(n * _log(ch)) / (cd * max(ci, co))


@_inlined
def _sheen(alpha, ci, co, ch, cd):
    s2 = max(ONE - ch * ch, np.float32(1e-9))
    a2 = alpha * alpha
    d = _exp(-ch * ch / (s2 * a2)) / (a2 * PI * s2 * s2)
    q = np.float32(2) * max(ch / cd, np.float32(1e-5))
    return np.float32(0.25) * d * min(q * min(ci, co), ONE) / (ci * co)


@_inlined
def _value(kind, alpha, ci, co, ch, cd):
    if kind == GGX:
        return _ggx(alpha, ci, co, ch, cd)
    if kind == BECKMANN:
        return _beckmann(alpha, ci, co, ch, cd)
    if kind == ASHIKHMIN_SHIRLEY:
        return _ashikhmin_shirley(alpha, ci, co, ch, cd)
    if kind == SHEEN:
        return _sheen(alpha, ci, co, ch, cd)
    return ONE / PI


@_inlined
def _share(t, end):
    """The share of a lobe that samples cover."""
    x = min(max(np.float32(2) * math.sqrt(t / end) - ONE, np.float32(0)), ONE)
    return ONE - x * x * (np.float32(3) - np.float32(2) * x)


@_inlined
def _row(kind, n, alpha, tilt, end, wx, wy, wz, hx, hy, hz, f):
    """Fill f (T,) with f · cos_i of one closure at one normal for lights w with half vectors h.

    end  t at which samples take over, 0: nowhere
    """
    nx, ny, co = n[0], n[1], n[2]
    sin2_o = ONE - co * co
    scale = ONE / math.sqrt(ONE + tilt * tilt * sin2_o)
    o = min(max(scale * (co + tilt * sin2_o), LEAST), ONE)
    seen = scale * (co + tilt * sin2_o) > LEAST
    for j in range(len(wx)):
        cos_i = nx * wx[j] + ny * wy[j] + co * wz[j]
        cos_h = nx * hx[j] + ny * hy[j] + co * hz[j]
        cd = max(hz[j], np.float32(1e-6))
        along = cd - co * cos_h
        ci = scale * (cos_i + tilt * (np.float32(2) * cd * along - sin2_o))
        ch = scale * (cos_h + tilt * along)
        lit = seen and cos_i > LEAST and ci > LEAST and ch > LEAST
        ci = min(max(ci, LEAST), ONE)
        ch = min(max(ch, LEAST), ONE)
        value = _value(kind, alpha, ci, o, ch, cd) * ci
        if end > 0:
            t = (ONE - ch * ch) / (ch * ch * alpha * alpha)
            value *= ONE - _share(t, end)
        f[j] = value if lit else np.float32(0)


@_inlined
def _parameters(table, co, values):
    """Set values (5,) to α, tilt and the weights of three channels at n·v = co."""
    last = len(table) - 1
    place = min(max(ONE - co, np.float32(0)), ONE) * np.float32(last)
    low = min(int(place), last - 1)
    t = place - np.float32(low)
    for m in range(5):
        values[m] = table[low, m] + t * (table[low + 1, m] - table[low, m])
    values[0] = math.exp(values[0])


@_inlined
def _end(alpha, extent):
    """t at which samples of a narrow lobe end; extent: tan θ_h, 0: there are no samples."""
    if extent <= 0:
        return np.float32(0)
    tan = max(extent / alpha, LEAST_EXTENT)
    return tan * tan


@_compiled
def add_lights(
    kind: int,
    n: np.ndarray,
    table: np.ndarray,
    extent: np.float32,
    w: np.ndarray,
    h: np.ndarray,
    energy: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add to out (N, 3) what one closure reflects of lights.

    n      (N, 3)
    table  (S, 5) log α, tilt and weights at equal steps of 1 − n·v
    extent  of `add_samples`, whose share is left out; 0: nothing is
    w, h, energy  (3, T) float32
    """
    f = np.empty(w.shape[1], np.float32)
    v = np.empty(5, np.float32)
    for i in range(len(n)):
        _parameters(table, n[i, 2], v)
        e = _end(v[0], extent)
        if kind == 0:
            _row(0, n[i], v[0], v[1], e, w[0], w[1], w[2], h[0], h[1], h[2], f)
        elif kind == 1:
            _row(1, n[i], v[0], v[1], e, w[0], w[1], w[2], h[0], h[1], h[2], f)
        elif kind == 2:
            _row(2, n[i], v[0], v[1], e, w[0], w[1], w[2], h[0], h[1], h[2], f)
        elif kind == 3:
            _row(3, n[i], v[0], v[1], e, w[0], w[1], w[2], h[0], h[1], h[2], f)
        else:
            _row(4, n[i], v[0], v[1], e, w[0], w[1], w[2], h[0], h[1], h[2], f)
        for c in range(3):
            total = np.float32(0)
            for j in range(len(f)):
                total += f[j] * energy[c, j]
            out[i, c] += total * v[2 + c]


@_inlined
def _samples(kind, first, n, alpha, tilt, end, light, to_light, count, out):
    """Set out (3,) to what one closure reflects at one normal from within its extent."""
    height, width = light.shape[0], light.shape[1]
    co = n[2]
    sin2_o = ONE - co * co
    scale = ONE / math.sqrt(ONE + tilt * tilt * sin2_o)
    o = scale * (co + tilt * sin2_o)
    out[0] = out[1] = out[2] = np.float32(0)
    if o <= LEAST:
        return
    # the lobe's axis, and two directions across it
    ax, ay = scale * (n[0] - tilt * co * n[0]), scale * (n[1] - tilt * co * n[1])
    az = o
    side = math.sqrt(ax * ax + ay * ay)
    if side > np.float32(1e-6):
        xx, xy, xz = ay / side, -ax / side, np.float32(0)
    else:
        xx, xy, xz = ONE, np.float32(0), np.float32(0)
    yx, yy, yz = ay * xz - az * xy, az * xx - ax * xz, ax * xy - ay * xx
    shift = (np.float32(first % 65536) * GOLDEN) % ONE
    turn = np.float32(2) * PI * ((np.float32(first % 65536) * SHIFT) % ONE)
    most = end / (ONE + end) if kind == GGX else ONE - math.exp(-end)
    tail = ONE - ONE / math.sqrt(ONE + end)
    a2 = alpha * alpha
    for j in range(2 * count):
        u = (np.float32(j % count) + shift) / np.float32(count)
        if j >= count:
            t = ONE / ((ONE - u * tail) * (ONE - u * tail)) - ONE
        elif kind == GGX:
            t = u * most / (ONE - u * most)
        else:
            t = np.float32(-math.log(ONE - u * most))
        r = np.float32(ONE / math.sqrt(ONE + t))
        density = r * r * r * r if kind == GGX else _exp(-t)
        c2 = ONE / (ONE + a2 * t)
        cos = math.sqrt(c2)
        p = (density / most + HALF * r * r * r / tail) / (np.float32(2) * PI * a2 * cos * c2)
        sin = alpha * math.sqrt(t) * cos
        phi = turn + np.float32(2) * PI * ((np.float32(j) * GOLDEN) % ONE)
        sx, sy = sin * math.cos(phi), sin * math.sin(phi)
        hx, hy, hz = (
            ax * cos + xx * sx + yx * sy,
            ay * cos + xy * sx + yy * sy,
            az * cos + xz * sx + yz * sy,
        )
        wx, wy, wz = np.float32(2) * hz * hx, np.float32(2) * hz * hy, np.float32(2) * hz * hz - ONE
        cos_i = wx * n[0] + wy * n[1] + wz * co
        ci = wx * ax + wy * ay + wz * az
        if cos_i <= LEAST or ci <= LEAST or hz <= LEAST:
            continue
        value = _value(kind, alpha, min(ci, ONE), min(o, ONE), min(cos, ONE), hz)
        value *= ci * np.float32(4) * hz / (np.float32(2 * count) * p)
        if kind == GGX:
            value *= _share(t, end)
        lx = to_light[0, 0] * wx + to_light[0, 1] * wy + to_light[0, 2] * wz
        ly = to_light[1, 0] * wx + to_light[1, 1] * wy + to_light[1, 2] * wz
        lz = to_light[2, 0] * wx + to_light[2, 1] * wy + to_light[2, 2] * wz
        polar = _arctan(math.sqrt(lx * lx + lz * lz), ly)
        row = min(int(polar / PI * np.float32(height)), height - 1)
        around = _arctan(lz, lx) / (np.float32(2) * PI)
        around = around + ONE if around < 0 else around
        column = min(int(around * np.float32(width)), width - 1)
        out[0] += value * light[row, column, 0]
        out[1] += value * light[row, column, 1]
        out[2] += value * light[row, column, 2]


@_compiled
def add_samples(
    kind: int,
    n: np.ndarray,
    table: np.ndarray,
    extent: np.float32,
    light: np.ndarray,
    to_light: np.ndarray,
    count: int,
    out: np.ndarray,
) -> None:
    """Add to out (N, 3) what one narrow closure reflects from within its extent.

    extent  tan θ_h up to which a long-tailed lobe (GGX) is sampled
    light  (height, width, 3) float32; to_light (3, 3) from the camera frame to the light frame
    count  directions of each of the two distributions
    """
    here = np.empty(3, np.float32)
    v = np.empty(5, np.float32)
    for i in range(len(n)):
        _parameters(table, n[i, 2], v)
        e = _end(v[0], extent) if kind == GGX else SHORT_TAILED
        if kind == 1:
            _samples(1, i, n[i], v[0], v[1], e, light, to_light, count, here)
        elif kind == 2:
            _samples(2, i, n[i], v[0], v[1], e, light, to_light, count, here)
        else:
            _samples(3, i, n[i], v[0], v[1], e, light, to_light, count, here)
        for c in range(3):
            out[i, c] += here[c] * v[2 + c]


@_inlined
def _catmull_rom(f, weights):
    f2 = f * f
    f3 = f2 * f
    weights[0] = HALF * (np.float32(2) * f2 - f - f3)
    weights[1] = HALF * (np.float32(2) - np.float32(5) * f2 + np.float32(3) * f3)
    weights[2] = HALF * (f + np.float32(4) * f2 - np.float32(3) * f3)
    weights[3] = HALF * (f3 - f2)


@_compiled
def interpolate(n: np.ndarray, nodes: np.ndarray, known: np.ndarray, out: np.ndarray) -> int:
    """Add to out (N, 3) the map's radiance at normals, by Catmull–Rom splines over 4 × 4 nodes.

    nodes (S, S, 3); known (S, S) uint8. Where a node is not known nothing is added, and it is
    marked with 2: the caller computes these and begins again.
    Returns  the number of nodes that are marked
    """
    size = nodes.shape[0]
    marked = 0
    x = np.empty(4, np.float32)
    y = np.empty(4, np.float32)
    for i in range(len(n)):
        flat = math.sqrt(n[i, 0] * n[i, 0] + n[i, 1] * n[i, 1])
        theta = _arctan(flat, n[i, 2]) * np.float32(2 / math.pi)
        along = theta / max(flat, np.float32(1e-12))
        px = (along * n[i, 0] + ONE) * HALF * np.float32(size - 3) + ONE
        py = (along * n[i, 1] + ONE) * HALF * np.float32(size - 3) + ONE
        column = min(max(int(px), 1), size - 3)
        row = min(max(int(py), 1), size - 3)
        _catmull_rom(px - np.float32(column), x)
        _catmull_rom(py - np.float32(row), y)
        r = g = b = np.float32(0)
        complete = True
        for a in range(4):
            for c in range(4):
                k, m = row - 1 + a, column - 1 + c
                if known[k, m] != 1:
                    complete = False
                    if known[k, m] == 0:
                        known[k, m] = 2
                        marked += 1
                weight = y[a] * x[c]
                r += weight * nodes[k, m, 0]
                g += weight * nodes[k, m, 1]
                b += weight * nodes[k, m, 2]
        if complete:
            out[i, 0] += max(r, np.float32(0))
            out[i, 1] += max(g, np.float32(0))
            out[i, 2] += max(b, np.float32(0))
    return marked
