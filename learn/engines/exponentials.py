"""2^x, 2^x − 1, log2 and an arc tangent of sixteen floats: polynomials without branches or tables.

x = k + f with k the nearest integer and f in [−½, ½]; 2^x = 2^k 2^f. Adding ROUND leaves k + 127,
which is the exponent field of 2^k, in the low bits of the sum: a shift makes 2^k, no conversion is
needed. c = 2^k (1 + m) with 1 + m in [¾, 1½) for the logarithm.

Coefficients: constant term first, least relative error on the interval named;
tests/learn/engines/test_vector.py holds each function to its own.
"""

from numba import types

from learn.engines.compilation import inlined
from learn.engines.vector import (
    FLOATS,
    INTS,
    Context,
    Lanes,
    Lowering,
    constant,
    fma,
    instruction,
    maximum,
    minimum,
    select,
    sqrt,
    wide,
)

ROUND = 1.5 * 2.0**23 + 127.0
# 2^x is held at 2^-48 below: products stay clear of denormal numbers, which cost a hundred times
# more
LOWEST = -48.0
# (2^f − 1) / f on [−½, ½], 4.3e-7
EXPM1 = (0.69314714, 0.24022351, 0.055505, 0.00966625, 0.00133335)
LOG = (
    1.44269503,
    -0.72134848,
    0.48090208,
    -0.36057592,
    0.28819153,
    -0.24272362,
    0.21632471,
    -0.17422922,
    0.07806572,
)
# LOG: log2(1 + m) / m on [−¼, ½], 2.7e-8
ATAN = (
    0.99999998,
    -0.33333073,
    0.19992619,
    -0.14203642,
    0.10640924,
    -0.07504274,
    0.04269128,
    -0.01606848,
    0.00284985,
)
# ATAN: arctan(r) / r in z = r² on [0, 1], 1.5e-8


@instruction
def _fraction_and_scale(typing: Context, x: types.Type) -> Lowering:
    """(f, 2^k) of x = k + f, for x in [LOWEST, 127]."""

    def generate(context, builder, signature, arguments):
        # no flags here: ROUND must not be cancelled
        shifted = builder.fadd(arguments[0], constant(ROUND))
        fraction = builder.fsub(arguments[0], builder.fsub(shifted, constant(ROUND)))
        scale = builder.bitcast(builder.shl(builder.bitcast(shifted, INTS), constant(23)), FLOATS)
        return context.make_tuple(builder, signature.return_type, (fraction, scale))

    return types.UniTuple(wide, 2)(x), generate


@instruction
def _mantissa_and_exponent(typing: Context, c: types.Type) -> Lowering:
    """(m, k) of c = 2^k (1 + m) > 0, k as floats."""

    def generate(context, builder, signature, arguments):
        bits = builder.bitcast(arguments[0], INTS)
        # 0x3F400000 is ¾
        exponent = builder.ashr(builder.sub(bits, constant(0x3F400000)), constant(23))
        mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, constant(23))), FLOATS)
        pair = builder.fsub(mantissa, constant(1.0)), builder.sitofp(exponent, FLOATS)
        return context.make_tuple(builder, signature.return_type, pair)

    return types.UniTuple(wide, 2)(c), generate


@inlined
def exp2m1_fraction(f: Lanes) -> Lanes:
    """2^f − 1 for f in [−½, ½]."""
    return f * fma(f, fma(f, fma(f, fma(f, EXPM1[4], EXPM1[3]), EXPM1[2]), EXPM1[1]), EXPM1[0])


@inlined
def exp2(x: Lanes) -> Lanes:
    """2^x for x ≤ 127."""
    f, scale = _fraction_and_scale(maximum(x, LOWEST))
    return fma(exp2m1_fraction(f), scale, scale)


@inlined
def exp2m1(x: Lanes) -> Lanes:
    """2^x − 1 for x in [0, 127], to full relative precision near 0: a dark lobe's κ may be 1e-6."""
    f, scale = _fraction_and_scale(x)
    return fma(exp2m1_fraction(f), scale, scale - 1.0)


@inlined
def log2(c: Lanes, one_minus_c: Lanes) -> Lanes:
    """log2 of c in (0, 1], with full relative precision at c → 1, where a lobe has its peak."""
    m, k = _mantissa_and_exponent(c)
    m = select(c > 0.75, 0.0 - one_minus_c, m)
    p = fma(m, fma(m, fma(m, fma(m, LOG[8], LOG[7]), LOG[6]), LOG[5]), LOG[4])
    return fma(m, fma(m, fma(m, fma(m, fma(m, p, LOG[3]), LOG[2]), LOG[1]), LOG[0]), k)


@inlined
def angle(y_squared: Lanes, x_squared: Lanes) -> Lanes:
    """arctan(√y² / √x²) in [0, π/2], not both 0."""
    z = minimum(y_squared, x_squared) / maximum(y_squared, x_squared)
    p = fma(z, fma(z, fma(z, fma(z, ATAN[8], ATAN[7]), ATAN[6]), ATAN[5]), ATAN[4])
    a = sqrt(z) * fma(z, fma(z, fma(z, fma(z, p, ATAN[3]), ATAN[2]), ATAN[1]), ATAN[0])
    return select(y_squared > x_squared, 1.5707963267948966 - a, a)
