"""The loops of shaders.direct_light, compiled by numba.

They evaluate the closed forms of shaders.closures, whose letters they have, in float32, where
polynomials stand for exponentials and logarithms: they are inlined, and sixteen lanes wide.
tests/shaders/test_direct_light.py compares them with shaders.closures.

They are in one file because numba compiles a cached kernel again only when the file that defines it
has changed, not when another file whose functions it contains has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

DIFFUSE, GGX, BECKMANN, ASHIKHMIN_SHIRLEY, SHEEN = range(5)
KINDS = {"diffuse": 0, "ggx": 1, "beckmann": 2, "ashikhmin_shirley": 3, "sheen": 4}
LEAST_EXTENT = np.float32(3)  # in units of tan θ_h / α
SHORT_TAILED = np.float32(25)  # t at which exponential lobes have ended
ONE = np.float32(1)
HALF = np.float32(0.5)
ENDED = np.float32(20)  # of the exponent of a lobe that reflects nothing more
LEAST_WEIGHT = np.float32(1e-5)  # of a closure that Cycles keeps
LEAST_SHARE = np.float32(0.125)  # of the samples that follow a closure, before normalisation
LEAST = np.float32(1e-4)  # cosine; shaders.closures.MIN_COS
PI = np.float32(math.pi)
LN_2 = np.float32(math.log(2))
GOLDEN = np.float32((math.sqrt(5) - 1) / 2)
SHIFT = np.float32(0.7548776662)  # irrational, and independent of the golden ratio
LANES = 64  # lights, half vectors or normals that are evaluated side by side
# rows of the lanes (ROWS, LANES) of a kernel: their numbers are constants, and the lanes one array,
# so that the compiler sees that no row overlaps another
W, H, ENERGY, SUM = 0, 3, 6, 9  # three rows each: direction, half vector, radiance, Σ f cos_i
CD, P, DENSITY, BELOW = 12, 13, 14, 15
N, FACET, AXIS, X, Y, OUT = 0, 3, 6, 9, 11, 14  # of `add_samples`
ALPHA, END, MOST, TAIL, SHIFT_OF, COS, SIN, T, VALUE = 17, 18, 19, 20, 21, 22, 23, 24, 25
ACROSS, DOWN = 3, 7  # of `interpolate`: four rows each, of a spline's weights
ROWS = 26

_inlined = njit(forceinline=True, fastmath=True, error_model="numpy")
# a step of one loop only, which becomes part of it before it is compiled: compiled by itself first,
# it would add in another order
_merged = njit(inline="always", fastmath=True, error_model="numpy")


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


@intrinsic
def _bits(context, x):
    """The bits of a float32 as an int32."""
    if x != types.float32:
        return None
    return types.int32(x), lambda target, builder, signature, args: builder.bitcast(
        args[0], target.get_value_type(types.int32)
    )


@intrinsic
def _from_bits(context, x):
    """The float32 of an int32's bits."""
    if x != types.int32:
        return None
    return types.float32(x), lambda target, builder, signature, args: builder.bitcast(
        args[0], target.get_value_type(types.float32)
    )


@_inlined
def _log_of_any(c):
    """Logarithm of a normal number c > 0: absolute error below 1e-5."""
    # c = 2^power · mantissa, the mantissa from √½ to √2
    bits = np.int32(_bits(np.float32(c)) - np.int32(0x3F3504F3))  # type: ignore[call-arg]
    power = np.int32(bits >> np.int32(23))
    mantissa = _from_bits(np.int32((bits & np.int32(0x7FFFFF)) + np.int32(0x3F3504F3)))
    return np.float32(power) * LN_2 + _log(mantissa)


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
    x = c / (math.sqrt(max(ONE - c * c, np.float32(1e-12))) * alpha)
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
        lit = cos_i > LEAST and ci > LEAST and (kind == DIFFUSE or (seen and ch > LEAST))
        ci = min(max(ci, LEAST), ONE)
        ch = min(max(ch, LEAST), ONE)
        value = _value(kind, alpha, ci, o, ch, cd) * ci
        if end > 0:
            t = (ONE - ch * ch) / (ch * ch * alpha * alpha)
            value *= ONE - _share(t, end)
        f[j] = value if lit else np.float32(0)


@_inlined
def _step(table, co):
    """Return the row of a table (S, 5) before n·v = co, and the part of the step beyond it."""
    last = len(table) - 1
    place = min(max(ONE - co, np.float32(0)), ONE) * np.float32(last)
    low = min(int(place), last - 1)
    return low, place - np.float32(low)


@_inlined
def _parameters(table, co, values):
    """Set values (5,) to α, tilt and the weights of three channels at n·v = co."""
    low, t = _step(table, co)
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


@_inlined
def _evaluate(kind, n, alpha, tilt, end, lights, count, f):
    """Fill f (T,) with f · cos_i of one closure for the first lights (9, T).

    The rows are cut one by one, since a part of a matrix would not be contiguous.
    """
    x, y, z = lights[0][:count], lights[1][:count], lights[2][:count]
    hx, hy, hz = lights[3][:count], lights[4][:count], lights[5][:count]
    if kind == 0:
        _row(0, n, alpha, tilt, end, x, y, z, hx, hy, hz, f)
    elif kind == 1:
        _row(1, n, alpha, tilt, end, x, y, z, hx, hy, hz, f)
    elif kind == 2:
        _row(2, n, alpha, tilt, end, x, y, z, hx, hy, hz, f)
    elif kind == 3:
        _row(3, n, alpha, tilt, end, x, y, z, hx, hy, hz, f)
    else:
        _row(4, n, alpha, tilt, end, x, y, z, hx, hy, hz, f)


@_inlined
def _add_energy(f, lights, count, out):
    """Add to out (3,) the first lights' energies (9, T) times f (T,)."""
    for c in range(3):
        energy = lights[6 + c][:count]
        total = np.float32(0)
        for j in range(count):
            total += f[j] * energy[j]
        out[c] += total


@_compiled
def add_lights(
    kind: int,
    n: np.ndarray,
    table: np.ndarray,
    extent: np.float32,
    lights: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add to out (N, 3) what one closure of unit weight reflects of lights.

    n       (N, 3)
    table   (S, 5) log α, tilt and weights at equal steps of 1 − n·v
    extent  of `add_samples`, whose share is left out; 0: nothing is
    lights  (9, T) directions, half vectors, and radiance times solid angle
    """
    count = lights.shape[1]
    f = np.empty(count, np.float32)
    v = np.empty(5, np.float32)
    for i in range(len(n)):
        _parameters(table, n[i, 2], v)
        _evaluate(kind, n[i], v[0], v[1], _end(v[0], extent), lights, count, f)
        _add_energy(f, lights, count, out[i])


@_compiled
def list_lights(
    kinds: np.ndarray,
    n: np.ndarray,
    tables: np.ndarray,
    extents: np.ndarray,
    narrow: np.float32,
    within: np.ndarray,
    lights: np.ndarray,
    centres: np.ndarray,
    radii: np.ndarray,
    near: np.ndarray,
    out: np.ndarray,
) -> None:
    """Set out (N, 3, T + B · E) to what closures reflect of each light at normals (N, 3).

    Wide lobes, and the tails of narrow ones, reflect the T lights; narrow lobes reflect those of
    the B blocks near their axis. What a lobe reflects is in one of the two only.

    kinds    (K,) numbers of the closures; tables (K, S, 5) as of `add_lights`
    extents  (K,) as of `add_samples`, whose share is left out; 0: nothing is
    narrow   α below which lobes are narrow
    within   (K,) tan θ_h / α of the half vectors that are near; 0: the closure has no lobe
    lights   (9, T) as of `add_lights`
    centres, radii, near  as of `add_blocks`
    """
    count, (blocks, _, each) = lights.shape[1], near.shape
    f = np.empty(max(count, each), np.float32)
    v = np.empty(5, np.float32)
    for i in range(len(n)):
        out[i] = 0
        for k in range(len(kinds)):
            _parameters(tables[k], n[i, 2], v)
            if v[2] + v[3] + v[4] < LEAST_WEIGHT:
                continue
            if extents[k] > 0 and kinds[k] != GGX:
                continue
            alpha, tilt, end = v[0], v[1], _end(v[0], extents[k])
            is_narrow = within[k] > 0 and alpha < narrow and end == 0
            if not is_narrow or kinds[k] == GGX:
                _evaluate(kinds[k], n[i], alpha, tilt, end, lights, count, f)
            mx, my, mz = _mirrored(n[i], tilt)
            cone = np.float32(2) * np.float32(math.atan(within[k] * alpha))
            cos, sin = np.float32(math.cos(cone)), np.float32(math.sin(cone))
            if is_narrow and kinds[k] == GGX:
                for j in range(count):
                    is_far = mx * lights[0, j] + my * lights[1, j] + mz * lights[2, j] < cos
                    f[j] *= ONE if is_far else np.float32(0)
            if not is_narrow or kinds[k] == GGX:
                for c in range(3):
                    row, energy = out[i, c], lights[6 + c]
                    for j in range(count):
                        row[j] += v[2 + c] * f[j] * energy[j]
            if not is_narrow:
                continue
            for b in range(blocks):
                cosine = mx * centres[b, 0] + my * centres[b, 1] + mz * centres[b, 2]
                if cosine <= cos * radii[b, 0] - sin * radii[b, 1]:
                    continue
                _evaluate(kinds[k], n[i], alpha, tilt, np.float32(0), near[b], each, f)
                for c in range(3):
                    row, energy = out[i, c, count + b * each :], near[b, 6 + c]
                    for j in range(each):
                        row[j] += v[2 + c] * f[j] * energy[j]


@_inlined
def _axis(n, tilt):
    """Return the tilted normal."""
    co = n[2]
    scale = ONE / math.sqrt(ONE + tilt * tilt * (ONE - co * co))
    side = scale * (ONE - tilt * co)
    return side * n[0], side * n[1], scale * (co + tilt * (ONE - co * co))


@_inlined
def _mirrored(n, tilt):
    """Return the direction into which the tilted normal mirrors the viewer."""
    ax, ay, az = _axis(n, tilt)
    return np.float32(2) * az * ax, np.float32(2) * az * ay, np.float32(2) * az * az - ONE


@_compiled
def add_blocks(
    kind: int,
    n: np.ndarray,
    table: np.ndarray,
    within: np.float32,
    centres: np.ndarray,
    radii: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add to out (N, 3) what one closure of unit weight reflects, in detail only around its axis.

    table    as of `add_lights`
    within   tan θ_h / α of the half vectors within which a block of the light counts in detail
    centres  (B, 3) of the blocks; radii (B, 2): cosine and sine of the angle
    near     (B, 9, T) each block's lights in detail, as of `add_lights`
    far      (9, F) the same, with an equal number of lights for each block, for the blocks beyond
    """
    blocks, _, each = near.shape
    many = far.shape[1]
    few = many // blocks
    gathered = np.empty((9, blocks * each), np.float32)
    beyond = np.empty(many, np.float32)
    f = np.empty(blocks * each, np.float32)
    v = np.empty(5, np.float32)
    for i in range(len(n)):
        _parameters(table, n[i, 2], v)
        alpha, tilt = v[0], v[1]
        mx, my, mz = _mirrored(n[i], tilt)
        cone = np.float32(2) * np.float32(math.atan(within * alpha))
        cos, sin = np.float32(math.cos(cone)), np.float32(math.sin(cone))
        count = 0
        for b in range(blocks):
            cosine = mx * centres[b, 0] + my * centres[b, 1] + mz * centres[b, 2]
            limit = cos * radii[b, 0] - sin * radii[b, 1]
            is_near = cosine > limit or sin * radii[b, 0] + cos * radii[b, 1] <= 0
            if is_near:
                for m in range(9):
                    for j in range(each):
                        gathered[m, count + j] = near[b, m, j]
                count += each
            for j in range(few * b, few * b + few):
                beyond[j] = np.float32(0) if is_near else ONE
        _evaluate(kind, n[i], alpha, tilt, np.float32(0), gathered, count, f)
        _add_energy(f, gathered, count, out[i])
        if kind == GGX:
            _evaluate(kind, n[i], alpha, tilt, np.float32(0), far, many, f)
            for j in range(many):
                f[j] *= beyond[j]
            _add_energy(f, far, many, out[i])


@_inlined
def _rows(m):
    """The numbers of a matrix (3, 3), row by row."""
    return m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2]


@_inlined
def _texel(to_light, wx, wy, wz, height, width):
    """Return row and column of the map's texel in a direction of the camera frame.

    to_light  nine numbers, row by row
    """
    lx = to_light[0] * wx + to_light[1] * wy + to_light[2] * wz
    ly = to_light[3] * wx + to_light[4] * wy + to_light[5] * wz
    lz = to_light[6] * wx + to_light[7] * wy + to_light[8] * wz
    polar = _arctan(math.sqrt(lx * lx + lz * lz), ly)
    row = min(int(polar / PI * np.float32(height)), height - 1)
    around = _arctan(lz, lx) / (np.float32(2) * PI)
    around = around + ONE if around < 0 else around
    return row, min(int(around * np.float32(width)), width - 1)


@_inlined
def _lobe_samples(kind, r, j, count, light_rows, light_columns, to_light, texels):
    """Set rows T and VALUE and texels (LANES,) for direction j of each normal of the lanes r."""
    share = ONE / np.float32(2 * count)
    of = np.float32(j % count)
    per = ONE / np.float32(count)
    # rounding may take t at u = 0 below 0
    if j >= count:
        for i in range(LANES):
            rest = ONE - (of + r[SHIFT_OF, i]) * per * r[TAIL, i]
            r[T, i] = max(ONE / (rest * rest) - ONE, np.float32(0))
    elif kind == GGX:
        for i in range(LANES):
            u = (of + r[SHIFT_OF, i]) * per * r[MOST, i]
            r[T, i] = max(u / (ONE - u), np.float32(0))
    else:
        for i in range(LANES):
            u = (of + r[SHIFT_OF, i]) * per * r[MOST, i]
            r[T, i] = max(-_log_of_any(max(ONE - u, np.float32(1e-11))), np.float32(0))
    phi = np.float32(2) * PI * ((np.float32(j) * GOLDEN) % ONE)
    cos_phi, sin_phi = np.float32(math.cos(phi)), np.float32(math.sin(phi))
    for i in range(LANES):
        t, a2 = r[T, i], r[ALPHA, i] * r[ALPHA, i]
        q = np.float32(ONE / math.sqrt(ONE + t))
        density = q * q * q * q if kind == GGX else _exp(-t)
        c2 = ONE / (ONE + a2 * t)
        cos = math.sqrt(c2)
        p = (density / r[MOST, i] + HALF * q * q * q / r[TAIL, i]) / (np.float32(2) * PI)
        p = p / (a2 * cos * c2)
        sin = r[ALPHA, i] * math.sqrt(t) * cos
        sx = sin * (r[COS, i] * cos_phi - r[SIN, i] * sin_phi)
        sy = sin * (r[SIN, i] * cos_phi + r[COS, i] * sin_phi)
        ax, ay, az = r[AXIS, i], r[AXIS + 1, i], r[AXIS + 2, i]
        hx = ax * cos + r[X, i] * sx + r[Y, i] * sy
        hy = ay * cos + r[X + 1, i] * sx + r[Y + 1, i] * sy
        hz = az * cos + r[Y + 2, i] * sy
        wx, wy, wz = np.float32(2) * hz * hx, np.float32(2) * hz * hy, np.float32(2) * hz * hz - ONE
        cos_i = wx * r[N, i] + wy * r[N + 1, i] + wz * r[N + 2, i]
        ci = wx * ax + wy * ay + wz * az
        above = wx * r[FACET, i] + wy * r[FACET + 1, i] + wz * r[FACET + 2, i] >= 0
        lit = (cos_i > LEAST) & (ci > LEAST) & (hz > LEAST) & above & (az > LEAST)
        ci = max(ci, LEAST)
        hz = max(hz, LEAST)
        o = min(max(az, LEAST), ONE)
        value = _value(kind, r[ALPHA, i], min(ci, ONE), o, min(cos, ONE), hz)
        value *= ci * np.float32(4) * hz * share / p
        if kind == GGX:
            value *= _share(t, r[END, i])
        r[VALUE, i] = value if lit else np.float32(0)
        row, column = _texel(to_light, wx, wy, wz, light_rows, light_columns)
        texels[i] = row * light_columns + column


@_inlined
def _add_texels(r, light, texels):
    """Add to rows OUT row VALUE times texels of the light (T, 3)."""
    for i in range(LANES):
        value, at = r[VALUE, i], texels[i]
        r[OUT, i] += value * light[at, 0]
        r[OUT + 1, i] += value * light[at, 1]
        r[OUT + 2, i] += value * light[at, 2]


@_inlined
def _set_frame(r, i, n, facet, alpha, tilt):
    """Set what `_lobe_samples` needs of one normal in lane i."""
    ax, ay, az = _axis(n, tilt)
    side = math.sqrt(ax * ax + ay * ay)
    xx, xy = ONE, np.float32(0)
    if side > np.float32(1e-6):
        xx, xy = ay / side, -ax / side
    for c in range(3):
        r[N + c, i], r[FACET + c, i], r[OUT + c, i] = n[c], facet[c], np.float32(0)
    r[AXIS, i], r[AXIS + 1, i], r[AXIS + 2, i] = ax, ay, az
    r[X, i], r[X + 1, i] = xx, xy
    r[Y, i], r[Y + 1, i], r[Y + 2, i] = -az * xy, az * xx, ax * xy - ay * xx
    r[ALPHA, i] = alpha


@_compiled
def add_samples(
    kind: int,
    n: np.ndarray,
    facets: np.ndarray,
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
    height, width = light.shape[0], light.shape[1]
    flat, rotation = light.reshape(height * width, 3), _rows(to_light)
    r = np.empty((ROWS, LANES), np.float32)
    texels = np.empty(LANES, np.int32)
    v = np.empty(5, np.float32)
    patterns = min(len(n), 65536)
    turns = np.empty((patterns, 3), np.float32)  # each normal turns and shifts its directions
    for i in range(patterns):
        turn = np.float32(2) * PI * ((np.float32(i) * SHIFT) % ONE)
        turns[i, 0], turns[i, 1] = math.cos(turn), math.sin(turn)
        turns[i, 2] = (np.float32(i) * GOLDEN) % ONE
    short = ONE - np.float32(math.exp(-SHORT_TAILED))
    for first in range(0, len(n), LANES):
        for i in range(LANES):
            at = min(first + i, len(n) - 1)
            _parameters(table, n[at, 2], v)
            end = _end(v[0], extent) if kind == GGX else SHORT_TAILED
            _set_frame(r, i, n[at], facets[at], v[0], v[1])
            r[END, i] = end
            r[MOST, i] = end / (ONE + end) if kind == GGX else short
            r[TAIL, i] = ONE - ONE / math.sqrt(ONE + end)
            pattern = at % 65536
            r[COS, i], r[SIN, i] = turns[pattern, 0], turns[pattern, 1]
            r[SHIFT_OF, i] = turns[pattern, 2]
        for j in range(2 * count):
            if kind == 1:
                _lobe_samples(1, r, j, count, height, width, rotation, texels)
            elif kind == 2:
                _lobe_samples(2, r, j, count, height, width, rotation, texels)
            else:
                _lobe_samples(3, r, j, count, height, width, rotation, texels)
            _add_texels(r, flat, texels)
        for i in range(min(LANES, len(n) - first)):
            low, t = _step(table, n[first + i, 2])
            for c in range(3):
                weight = table[low, 2 + c] + t * (table[low + 1, 2 + c] - table[low, 2 + c])
                out[first + i, c] += r[OUT + c, i] * weight


@_compiled
def add_rows(points: np.ndarray, values: np.ndarray, each: np.ndarray, out: np.ndarray) -> None:
    """Add rows `each` (P,) of values (N, 3) to rows `points` (P,) of out, all of them others."""
    for i in range(len(points)):
        for c in range(3):
            out[points[i], c] += values[each[i], c]


@_compiled
def draw_samples(
    kind: int,
    n: np.ndarray,
    facets: np.ndarray,
    table: np.ndarray,
    extent: np.float32,
    light: np.ndarray,
    to_light: np.ndarray,
    places: np.ndarray,
    w: np.ndarray,
    radiance: np.ndarray,
) -> None:
    """Draw directions that one narrow closure reflects from within its extent at normals (P, 3).

    Half of them follow the closure, half a distribution with a longer tail, as in `add_samples`.

    n, facets, table, extent, light, to_light  as of `add_samples`
    places    (P, J, 2) in [0, 1), of which each gives a direction
    w         (P, J, 3), set to the directions
    radiance  (P, J, 3), set to what the closure reflects of each over its density: the mean over
              all places is what `add_samples` adds
    """
    height, width = light.shape[0], light.shape[1]
    rotation = _rows(to_light)
    v = np.empty(5, np.float32)
    for i in range(len(n)):
        _parameters(table, n[i, 2], v)
        alpha, a2 = v[0], v[0] * v[0]
        ax, ay, az = _axis(n[i], v[1])
        side = math.sqrt(ax * ax + ay * ay)
        xx, xy = ONE, np.float32(0)
        if side > np.float32(1e-6):
            xx, xy = ay / side, -ax / side
        yx, yy, yz = -az * xy, az * xx, ax * xy - ay * xx
        end = _end(alpha, extent) if kind == GGX else SHORT_TAILED
        most = end / (ONE + end) if kind == GGX else ONE - np.float32(math.exp(-end))
        tail = ONE - ONE / math.sqrt(ONE + end)
        for j in range(places.shape[1]):
            u = np.float32(2) * places[i, j, 0]
            if u >= ONE:
                rest = ONE - (u - ONE) * tail
                t = ONE / (rest * rest) - ONE
            elif kind == GGX:
                t = u * most / (ONE - u * most)
            else:
                t = -math.log(max(ONE - u * most, np.float32(1e-11)))
            t = max(t, np.float32(0))
            phi = np.float32(2) * PI * places[i, j, 1]
            q = ONE / math.sqrt(ONE + t)
            density = q * q * q * q if kind == GGX else math.exp(-t)
            c2 = ONE / (ONE + a2 * t)
            cos = math.sqrt(c2)
            p = (density / most + HALF * q * q * q / tail) / (np.float32(2) * PI * a2 * cos * c2)
            sin = alpha * math.sqrt(t) * cos
            sx, sy = sin * math.cos(phi), sin * math.sin(phi)
            hx = ax * cos + xx * sx + yx * sy
            hy = ay * cos + xy * sx + yy * sy
            hz = az * cos + yz * sy
            wx, wy, wz = (
                np.float32(2) * hz * hx,
                np.float32(2) * hz * hy,
                np.float32(2) * hz * hz - ONE,
            )
            cos_i = wx * n[i, 0] + wy * n[i, 1] + wz * n[i, 2]
            ci = wx * ax + wy * ay + wz * az
            above = wx * facets[i, 0] + wy * facets[i, 1] + wz * facets[i, 2] >= 0
            w[i, j, 0], w[i, j, 1], w[i, j, 2] = wx, wy, wz
            for c in range(3):
                radiance[i, j, c] = 0
            if not (cos_i > LEAST and ci > LEAST and hz > LEAST and above and az > LEAST):
                continue
            value = _value(kind, alpha, min(ci, ONE), min(az, ONE), min(cos, ONE), hz)
            value *= ci * np.float32(4) * hz / p
            if kind == GGX:
                value *= _share(t, end)
            row, column = _texel(rotation, wx, wy, wz, height, width)
            for c in range(3):
                radiance[i, j, c] = v[2 + c] * value * light[row, column, c]


@_inlined
def _set_spline(r, row, f, i):
    """Set four rows of the lanes r, from `row`, to Catmull–Rom weights at f in [0, 1)."""
    f2 = f * f
    f3 = f2 * f
    r[row, i] = HALF * (np.float32(2) * f2 - f - f3)
    r[row + 1, i] = HALF * (np.float32(2) - np.float32(5) * f2 + np.float32(3) * f3)
    r[row + 2, i] = HALF * (f + np.float32(4) * f2 - np.float32(3) * f3)
    r[row + 3, i] = HALF * (f3 - f2)


@_inlined
def _set_places(r, size, rows, columns):
    """Set rows ACROSS and DOWN, and rows and columns (LANES,) of a map's first nodes, from row N.

    size  of the map's sides
    """
    for i in range(LANES):
        nx, ny, nz = r[N, i], r[N + 1, i], r[N + 2, i]
        flat = math.sqrt(nx * nx + ny * ny)
        theta = _arctan(flat, nz) * np.float32(2 / math.pi)
        along = theta / max(flat, np.float32(1e-12))
        x = (along * nx + ONE) * HALF * np.float32(size - 3) + ONE
        y = (along * ny + ONE) * HALF * np.float32(size - 3) + ONE
        column = min(max(np.int32(x), np.int32(1)), np.int32(size - 3))
        row = min(max(np.int32(y), np.int32(1)), np.int32(size - 3))
        _set_spline(r, ACROSS, x - np.float32(column), i)
        _set_spline(r, DOWN, y - np.float32(row), i)
        rows[i], columns[i] = row - np.int32(1), column - np.int32(1)


@_compiled
def interpolate(
    n: np.ndarray,
    least: float,
    known: np.ndarray,
    nodes: np.ndarray,
    table: np.ndarray,
    pending: np.ndarray,
    out: np.ndarray,
) -> int:
    """Add to out (N, 3) a map's radiance at normals (N, 3) times the closure's weights there.

    By Catmull–Rom splines over 4 × 4 of the nodes. Where one of them is not known nothing is added,
    and it is marked by 2.

    least    n·v of normals below which nothing is done
    known    (S, S) uint8, 1: the node is known
    nodes    (S, S, 4), of which the last is not used
    table    as of `add_lights`
    pending  (N,) int32, of which the first are set to the normals that lack nodes
    Returns  the number of these
    """
    size = nodes.shape[0]
    flat = nodes.reshape(size, size * 4)
    r = np.empty((ROWS, LANES), np.float32)
    rows, columns = np.empty(LANES, np.int32), np.empty(LANES, np.int32)
    sums = np.empty(16, np.float32)
    lacking = 0
    for first in range(0, len(n), LANES):
        for i in range(LANES):
            at = min(first + i, len(n) - 1)
            r[N, i], r[N + 1, i], r[N + 2, i] = n[at, 0], n[at, 1], n[at, 2]
        _set_places(r, size, rows, columns)
        for i in range(min(LANES, len(n) - first)):
            if r[N + 2, i] < least:
                continue
            row, column = np.intp(rows[i]), np.intp(columns[i])
            complete = np.uint8(1)
            for a in range(4):
                for c in range(4):
                    complete &= known[row + a, column + c]
            if complete != 1:
                pending[lacking] = first + i
                lacking += 1
                for a in range(4):
                    for c in range(4):
                        if known[row + a, column + c] == 0:
                            known[row + a, column + c] = 2
                continue
            down = r[DOWN, i], r[DOWN + 1, i], r[DOWN + 2, i], r[DOWN + 3, i]
            for m in range(16):
                j = 4 * column + m
                sums[m] = (
                    down[0] * flat[row, j]
                    + down[1] * flat[row + 1, j]
                    + down[2] * flat[row + 2, j]
                    + down[3] * flat[row + 3, j]
                )
            low, t = _step(table, r[N + 2, i])
            for c in range(3):
                value = (
                    r[ACROSS, i] * sums[c]
                    + r[ACROSS + 1, i] * sums[4 + c]
                    + r[ACROSS + 2, i] * sums[8 + c]
                    + r[ACROSS + 3, i] * sums[12 + c]
                )
                weight = table[low, 2 + c] + t * (table[low + 1, 2 + c] - table[low, 2 + c])
                out[first + i, c] += max(value, np.float32(0)) * weight
    return lacking


@_compiled
def face(n: np.ndarray, facets: np.ndarray, least: float, cosine: float, out: np.ndarray) -> int:
    """Set out (N, 3) to unit normals (N, 3) whose n·v is raised to `least` before they are scaled.

    Returns  how many of them have a lesser cosine to their facets (N, 3)
    """
    leaning = 0
    for i in range(len(n)):
        x, y, z = n[i, 0], n[i, 1], max(n[i, 2], np.float32(least))
        scale = ONE / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * scale, y * scale, z * scale
        out[i, 0], out[i, 1], out[i, 2] = x, y, z
        leaning += x * facets[i, 0] + y * facets[i, 1] + z * facets[i, 2] < np.float32(cosine)
    return leaning


@_inlined
def _lobe(kind, alpha, o, i, ch, cd):
    """Return f · cos_i and the density by which Cycles draws w, where w may be longer than 1."""
    if kind == DIFFUSE:
        return i / PI, i / PI
    if kind == SHEEN:
        return _sheen(alpha, i, o, ch, cd) * i, HALF / PI
    if kind == ASHIKHMIN_SHIRLEY:
        n = np.float32(2) / (alpha * alpha) - np.float32(2)
        density = (n + ONE) / (np.float32(8) * PI) * _exp(n * _log(ch)) / cd
        return i / max(o, i) * density, density
    c2, a2 = ch * ch, alpha * alpha
    tan2 = max(ONE / (i * i) - ONE, np.float32(0))
    if kind == GGX:
        spread = (ONE - c2) + a2 * c2
        d = a2 / (PI * spread * spread)
        hidden_i = HALF * (math.sqrt(ONE + a2 * tan2) - ONE)
        hidden_o = HALF * (math.sqrt(ONE + a2 * (ONE / (o * o) - ONE)) - ONE)
    else:
        d = _exp(-(ONE - c2) / (c2 * a2)) / (PI * a2 * c2 * c2)
        hidden_i = _smith(min(i, ONE), alpha)
        hidden_o = _smith(o, alpha)
    common = np.float32(0.25) * d / o
    return common / (ONE + hidden_i + hidden_o), common / (ONE + hidden_o)


@_inlined
def _has_ended(kind, alpha, ch):
    """Whether an exponential lobe is below e^−20 of its peak."""
    if kind == BECKMANN:
        return ONE - ch * ch > ENDED * ch * ch * alpha * alpha
    return (np.float32(2) / (alpha * alpha) - np.float32(2)) * (ONE - ch) > ENDED


@_inlined
def _lobe_lanes(kind, r, v, ax, ay, az, least, end, picked):
    alpha, red, green, blue = v[0], v[2], v[3], v[4]
    if kind in (BECKMANN, ASHIKHMIN_SHIRLEY):
        nearest = LEAST
        for j in range(LANES):
            nearest = max(nearest, ax * r[H, j] + ay * r[H + 1, j] + az * r[H + 2, j])
        if _has_ended(kind, alpha, min(nearest, ONE)):
            return
    o = min(az, ONE)
    inverse = ONE / end if end > 0 else np.float32(1e30)  # of which no t is within
    for j in range(LANES):
        ci = ax * r[W, j] + ay * r[W + 1, j] + az * r[W + 2, j]
        ch = ax * r[H, j] + ay * r[H + 1, j] + az * r[H + 2, j]
        lit = (ci > LEAST) & (ch > least)
        ci = max(ci, LEAST)
        ch = min(max(ch, LEAST), ONE)
        f, p = _lobe(kind, alpha, o, ci, ch, r[CD, j])
        if kind != DIFFUSE and kind != SHEEN:
            t = max((ONE - ch * ch) / (ch * ch * alpha * alpha), np.float32(1e-12))
            f *= ONE - _share(t * inverse, ONE)
        f = f if lit else np.float32(0)
        r[P, j] += p * picked if lit else np.float32(0)
        r[SUM, j] += f * red
        r[SUM + 1, j] += f * green
        r[SUM + 2, j] += f * blue


@_inlined
def _add_lobe(kind, r, v, ax, ay, az, least, end, picked):
    """Add a closure's f · cos_i to rows SUM of the lanes r, and its density to row P.

    It reads rows W, H and CD.

    v       (5,) α, tilt and weights; (ax, ay, az) the closure's axis
    least   cosine of half vectors to the axis, of which none reflects
    end     t at which samples take over, 0: nowhere
    picked  chance with which Cycles draws by the closure
    """
    if kind == 0:
        _lobe_lanes(0, r, v, ax, ay, az, least, end, picked)
    elif kind == 1:
        _lobe_lanes(1, r, v, ax, ay, az, least, end, picked)
    elif kind == 2:
        _lobe_lanes(2, r, v, ax, ay, az, least, end, picked)
    elif kind == 3:
        _lobe_lanes(3, r, v, ax, ay, az, least, end, picked)
    else:
        _lobe_lanes(4, r, v, ax, ay, az, least, end, picked)


@_inlined
def _picked(v, counts, shares):
    """Set shares (K,) to the chances with which Cycles draws by each closure.

    They follow the closures' mean weights, but are at least an eighth of their sum before they are
    made to add up to 1.

    v       (K, 5) α, tilt and weights
    counts  (K,) whether the closure may be drawn
    """
    total = np.float32(0)
    for k in range(len(v)):
        shares[k] = (v[k, 2] + v[k, 3] + v[k, 4]) / np.float32(3)
        if not counts[k] or shares[k] < LEAST_WEIGHT:
            shares[k] = np.float32(0)
        total += shares[k]
    several = np.float32(0)
    for k in range(len(v)):
        if shares[k] > 0:
            shares[k] = max(shares[k], LEAST_SHARE * total)
        several += shares[k]
    for k in range(len(v)):
        shares[k] /= max(several, np.float32(1e-30))


@_merged
def _set_closures(n, tables, counts, v, axes, picked):
    """Set what closures are at a normal (3,): v (K, 5), axes (K, 3) and picked (K,).

    v       α, tilt and weights; axes: the tilted normals
    counts  (K,) whether a closure may be drawn; picked: the chance of it
    """
    for k in range(len(v)):
        _parameters(tables[k], abs(n[2]), v[k])
        axes[k, 0], axes[k, 1], axes[k, 2] = _axis(n, v[k, 1])
    _picked(v, counts, picked)


@_merged
def _list_lights(n, facet, away, lights, firsts, centres, sines, counted, eights, which):
    """Set which (T,) to the lights above a normal (3,) and, unless away, below its facet (3,).

    Lights and blocks as of `add_leaning`. Those of a block that lies wholly on one side are skipped
    at once.

    counted  (T,) uint8 room for marks, and eights the same eight by eight
    Returns  how many they are
    """
    nx, ny, co = n[0], n[1], n[2]
    fx, fy, fz = facet[0], facet[1], facet[2]
    many = 0
    for b in range(len(sines)):
        cx, cy, cz = centres[b, 0], centres[b, 1], centres[b, 2]
        if nx * cx + ny * cy + co * cz <= -sines[b]:
            continue  # all of it is below the horizon
        if not away and fx * cx + fy * cy + fz * cz > sines[b]:
            continue  # all of it is above the facet
        x, y, z = (
            lights[0, firsts[b] : firsts[b + 1]],
            lights[1, firsts[b] : firsts[b + 1]],
            lights[2, firsts[b] : firsts[b + 1]],
        )
        for j in range(len(x)):
            lit = nx * x[j] + ny * y[j] + co * z[j] > LEAST
            below = fx * x[j] + fy * y[j] + fz * z[j] < 0
            counted[j] = lit & (below | away)
        for j in range(len(x), (len(x) + 7) // 8 * 8):
            counted[j] = 0
        for m in range((len(x) + 7) // 8):
            if eights[m] == 0:
                continue  # most do not count, and those that do are neighbours
            for j in range(8 * m, 8 * m + 8):
                which[many] = firsts[b] + j
                many += counted[j]
    return many


@_merged
def _set_lights(r, which, first, many, lights, density):
    """Set rows W, H, ENERGY, DENSITY and CD of the lanes r for listed lights from `first` on.

    Lanes beyond the last of `many` repeat the first and have no energy. Rows P and SUM are cleared.
    """
    here = min(LANES, many - first)
    for j in range(here, LANES):
        which[first + j] = which[first]
    for j in range(LANES):
        at = np.intp(which[first + j])
        for m in range(9):
            r[m, j] = lights[m, at]
        r[DENSITY, j] = density[at]
    for j in range(here, LANES):
        r[ENERGY, j] = r[ENERGY + 1, j] = r[ENERGY + 2, j] = np.float32(0)
    for j in range(LANES):
        r[CD, j] = max(r[H + 2, j], np.float32(1e-6))
        r[P, j] = r[SUM, j] = r[SUM + 1, j] = r[SUM + 2, j] = np.float32(0)


@_merged
def _add_lost(r, facet, away, red, green, blue):
    """Return the sums of three channels, plus what the lanes r reflect of what Cycles loses.

    Below the facet (3,) the share p²/(p² + q²) of it is lost, p the density of the closures, and q
    that of the light. away: what is reflected instead, which is all but that share.
    """
    fx, fy, fz = facet[0], facet[1], facet[2]
    whole, sign = (ONE, -ONE) if away else (np.float32(0), ONE)
    for j in range(LANES):
        p2 = r[P, j] * r[P, j]
        below = fx * r[W, j] + fy * r[W + 1, j] + fz * r[W + 2, j] < 0
        share = p2 / max(p2 + r[DENSITY, j] * r[DENSITY, j], np.float32(1e-30))
        share = whole + sign * (share if below else np.float32(0))
        red += share * r[SUM, j] * r[ENERGY, j]
        green += share * r[SUM + 1, j] * r[ENERGY + 1, j]
        blue += share * r[SUM + 2, j] * r[ENERGY + 2, j]
    return red, green, blue


@_compiled
def add_leaning(
    kinds: np.ndarray,
    n: np.ndarray,
    facets: np.ndarray,
    tables: np.ndarray,
    extents: np.ndarray,
    lights: np.ndarray,
    density: np.ndarray,
    firsts: np.ndarray,
    centres: np.ndarray,
    sines: np.ndarray,
    away: bool,
    out: np.ndarray,
) -> None:
    """Add to out (N, 3) what normals that lean from their facets lose below them, or reflect.

    Cycles finds light by directions that it draws towards the light, and by others that follow the
    closures. Of the latter it drops those below the facet, but it weights the former as if it did
    not. Of light that Cycles draws by the densities q and p, the share p²/(p² + q²) is lost.

    kinds    (K,) of the mixture's closures; tables (K, S, 5) as of `add_lights`
    facets   (N, 3) unit normals
    extents  (K,) as of `add_samples`, whose share is left out; 0: nothing is
    lights   (9, T) as of `add_lights`; density (T,) by which Cycles draws them, in 1/sr
    firsts   (B + 1,) where each block of neighbouring lights begins, and T
    centres  (B, 3) of the blocks; sines (B,) of the angles within which their lights lie
    away     False: what is lost. True: what is reflected at normals that face away. Diffuse
             closures reflect there as elsewhere, others where their tilted normal faces the viewer
    """
    closures = len(kinds)
    r = np.empty((ROWS, LANES), np.float32)
    which = np.empty(lights.shape[1] + LANES, np.int32)
    counted = np.empty((lights.shape[1] + 7) // 8 * 8, np.uint8)
    eights = counted.view(np.uint64)
    v = np.empty((closures, 5), np.float32)
    axes = np.empty((closures, 3), np.float32)
    ends = np.empty(closures, np.float32)
    picked = np.empty(closures, np.float32)
    counts = np.ones(closures, np.uint8)
    for i in range(len(n)):
        _set_closures(n[i], tables, counts, v, axes, picked)
        for k in range(closures):
            ends[k] = _end(v[k, 0], extents[k])
        many = _list_lights(
            n[i], facets[i], away, lights, firsts, centres, sines, counted, eights, which
        )
        red = green = blue = np.float32(0)
        for first in range(0, many, LANES):
            _set_lights(r, which, first, many, lights, density)
            for k in range(closures):
                matte = kinds[k] == DIFFUSE
                # Cycles drops closures that it never draws
                if picked[k] > 0 and (matte or axes[k, 2] > LEAST):
                    least = np.float32(-2) if matte else LEAST
                    ax, ay, az = axes[k, 0], axes[k, 1], axes[k, 2]
                    _add_lobe(kinds[k], r, v[k], ax, ay, az, least, ends[k], picked[k])
            red, green, blue = _add_lost(r, facets[i], away, red, green, blue)
        out[i, 0] += red
        out[i, 1] += green
        out[i, 2] += blue


@_inlined
def _draw_turned(r, n, facet, axis, least, exponent, drawn, first):
    """Set rows W, H, CD and BELOW of the lanes r for half vectors that may face away.

    BELOW is 1 where one does not, or where its direction is below the normal or the facet.

    least   sine of the axis' angle to the viewer: of all half vectors only those whose cosine to
            the axis is less may face away
    drawn   (3, …) of which `first` and the following are used: log u, and cosine and sine of φ
    """
    ax, ay, az = axis[0], axis[1], axis[2]
    nx, ny, nz = n[0], n[1], n[2]
    fx, fy, fz = facet[0], facet[1], facet[2]
    side = max(math.sqrt(ax * ax + ay * ay), np.float32(1e-6))
    xx, xy = ay / side, -ax / side
    yx, yy, yz = -az * xy, az * xx, ax * xy - ay * xx
    inverse = ONE / exponent
    for m in range(3):
        for j in range(LANES):
            r[H + m, j] = drawn[m, first + j]
    for j in range(LANES):
        cos = least * _exp(r[H, j] * inverse)  # least · u^(1/exponent)
        sin = math.sqrt(max(ONE - cos * cos, np.float32(0)))
        sx, sy = sin * r[H + 1, j], sin * r[H + 2, j]
        hx = ax * cos + xx * sx + yx * sy
        hy = ay * cos + xy * sx + yy * sy
        hz = az * cos + yz * sy
        cd = max(-hz, np.float32(1e-6))
        wx, wy = np.float32(2) * cd * hx, np.float32(2) * cd * hy
        wz = np.float32(2) * cd * hz - ONE
        counts = (hz < 0) & (wx * nx + wy * ny + wz * nz >= 0) & (wx * fx + wy * fy + wz * fz >= 0)
        r[H, j], r[H + 1, j], r[H + 2, j] = hx, hy, hz
        r[W, j], r[W + 1, j], r[W + 2, j] = wx, wy, wz
        r[CD, j] = cd
        r[BELOW, j] = np.float32(0) if counts else ONE


@_merged
def _set_pattern(count, drawn):
    """Set the first `count` of drawn (3, …) to log u, and cosine and sine of φ, evenly spread."""
    for j in range(count):
        phi = np.float32(2) * PI * ((np.float32(j) * GOLDEN) % ONE)
        drawn[0, j] = math.log((np.float32(j) + HALF) / np.float32(count))
        drawn[1, j], drawn[2, j] = math.cos(phi), math.sin(phi)


@_merged
def _keep_turned(r, n, facet, axis, least, exponent, drawn, count, kept):
    """Set kept (7, …) to rows W, H and CD of the half vectors that face away and count.

    Arguments as of `_draw_turned`, of which `count` are drawn. Returns how many are kept.
    """
    many = 0
    for first in range(0, count, LANES):
        here = min(LANES, count - first)
        _draw_turned(r, n, facet, axis, least, exponent, drawn, first)
        for j in range(here):
            for m in range(6):  # rows W and H
                kept[m, many] = r[m, j]
            kept[6, many] = r[CD, j]
            many += r[BELOW, j] == 0
    return many


@_merged
def _set_kept(r, kept, first, many):
    """Set rows W, H and CD of the lanes r to the kept half vectors from `first` on.

    BELOW is 1 in lanes beyond the last of `many`. Rows P and SUM are cleared.
    """
    here = min(LANES, many - first)
    for m in range(6):
        for j in range(LANES):
            r[m, j] = kept[m, first + j]
    for j in range(LANES):
        r[CD, j] = kept[6, first + j]
        r[BELOW, j] = np.float32(0) if j < here else ONE
        r[P, j] = r[SUM, j] = r[SUM + 1, j] = r[SUM + 2, j] = np.float32(0)


@_merged
def _look_up_light(r, light, density, rotation, height, width, texels):
    """Set rows ENERGY and DENSITY of the lanes r to the light's in directions W of any length.

    light     (T, 3) radiance of the map's texels; density (T,); texels (LANES,) room
    rotation  nine numbers, from the camera frame to the light frame
    """
    for j in range(LANES):
        wx, wy, wz = r[W, j], r[W + 1, j], r[W + 2, j]
        length = math.sqrt(max(wx * wx + wy * wy + wz * wz, np.float32(1e-24)))
        wx, wy, wz = wx / length, wy / length, wz / length
        row, column = _texel(rotation, wx, wy, wz, height, width)
        texels[j] = row * width + column
    for j in range(LANES):
        r[DENSITY, j] = density[texels[j]]
        for c in range(3):
            r[ENERGY + c, j] = light[texels[j], c]


@_merged
def _add_weighted(r, red, green, blue):
    """Return the sums of three channels, plus the lanes' f cos_i L p/(p² + q²) where BELOW is 0.

    That is the weight of a sample that is drawn by the density p beside those by the light's q.
    """
    for j in range(LANES):
        p, q = r[P, j], r[DENSITY, j]
        share = p / max(p * p + q * q, np.float32(1e-30))
        share = share if r[BELOW, j] == 0 else np.float32(0)
        red += share * r[SUM, j] * r[ENERGY, j]
        green += share * r[SUM + 1, j] * r[ENERGY + 1, j]
        blue += share * r[SUM + 2, j] * r[ENERGY + 2, j]
    return red, green, blue


@_compiled
def add_misdirected(
    kinds: np.ndarray,
    n: np.ndarray,
    facets: np.ndarray,
    tables: np.ndarray,
    light: np.ndarray,
    density: np.ndarray,
    to_light: np.ndarray,
    count: int,
    out: np.ndarray,
) -> None:
    """Add to out (N, 3) the light that Cycles finds by half vectors that face away.

    When Ashikhmin and Shirley's closure draws a half vector h with h·v < 0, Cycles turns it round,
    but keeps h·v as it was, so that w = −v + 2 |h·v| h is no mirrored direction, and longer than 1.
    What comes from there is added to the picture, by the weight that it would have as a proper
    sample beside those of the light.

    kinds    (K,) of the mixture's closures; tables (K, S, 5) as of `add_lights`
    facets   (N, 3) unit normals, below which Cycles finds nothing
    density  (height, width) by which Cycles draws directions to the light, in 1/sr
    count    half vectors per normal and closure
    """
    height, width = light.shape[0], light.shape[1]
    closures = len(kinds)
    flat, other = light.reshape(height * width, 3), density.reshape(height * width)
    rotation = _rows(to_light)
    r = np.empty((ROWS, LANES), np.float32)
    texels = np.empty(LANES, np.int32)
    v = np.empty((closures, 5), np.float32)
    axes = np.empty((closures, 3), np.float32)
    picked = np.empty(closures, np.float32)
    counts = np.ones(closures, np.uint8)
    padded = (count + LANES - 1) // LANES * LANES
    drawn = np.zeros((3, padded), np.float32)
    kept = np.ones((7, padded + LANES), np.float32)
    _set_pattern(count, drawn)
    for i in range(len(n)):
        _set_closures(n[i], tables, counts, v, axes, picked)
        for k in range(closures):
            if kinds[k] == DIFFUSE:
                axes[k, 0], axes[k, 1], axes[k, 2] = n[i, 0], n[i, 1], n[i, 2]
        for k in range(closures):
            if kinds[k] != ASHIKHMIN_SHIRLEY or picked[k] <= 0 or axes[k, 2] <= LEAST:
                continue
            exponent = np.float32(2) / (v[k, 0] * v[k, 0]) - ONE
            az = axes[k, 2]
            least = np.float32(math.sqrt(max(ONE - az * az, np.float32(0))))
            chance = np.float32(least**exponent)
            if chance < np.float32(1e-4):
                continue  # hardly any half vector faces away
            many = _keep_turned(r, n[i], facets[i], axes[k], least, exponent, drawn, count, kept)
            red = green = blue = np.float32(0)
            for first in range(0, many, LANES):
                _set_kept(r, kept, first, many)
                for m in range(closures):
                    bx, by, bz = axes[m, 0], axes[m, 1], axes[m, 2]
                    if bz > LEAST:
                        _add_lobe(kinds[m], r, v[m], bx, by, bz, LEAST, np.float32(0), picked[m])
                _look_up_light(r, flat, other, rotation, height, width, texels)
                red, green, blue = _add_weighted(r, red, green, blue)
            scale = picked[k] * chance / np.float32(count)
            out[i, 0] += scale * red
            out[i, 1] += scale * green
            out[i, 2] += scale * blue
