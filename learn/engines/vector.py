"""Sixteen floats at once: a numba value type, <16 x float> in LLVM, and the kernels' operations.

LLVM splits the vector for the machine at hand: one register on AVX-512, two on AVX2, four on SSE or
NEON. No instruction set is named. Each function below becomes a single LLVM instruction or
intrinsic (`lane_sum` four additions).

Wide    sixteen float32, "lanes"; numbers that meet a Wide in + − × ÷ or in a function are spread
        over the lanes
Mask    sixteen truth values, from `a > b` or `a < b`

FLAGS let LLVM fuse a×b+c and assume finite numbers. `reassoc` is left out on purpose: it would fold
(x + M) − M in learn.engines.exponentials, and two_sum here.
"""

import operator
from collections.abc import Callable, Sequence
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core.base import BaseContext
from numba.core.datamodel import DataModelManager
from numba.core.typing.context import BaseContext as Context
from numba.core.typing.templates import Signature
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from learn.engines.layout import LANES

FLAGS = ("contract", "nsz", "nnan", "ninf", "arcp", "afn")
FLOAT, INT = ir.FloatType(), ir.IntType(32)
FLOATS, INTS = ir.VectorType(FLOAT, LANES), ir.VectorType(INT, LANES)
BITS = ir.VectorType(ir.IntType(1), LANES)
FLOAT_POINTER, INT_POINTER = types.CPointer(types.float32), types.CPointer(types.int32)
single = cast("Callable[[float], float]", types.float32)  # a conversion, in a kernel

# To a type checker sixteen floats are one, and sixteen truth values too; numba knows them apart.
Lanes = float
Mask = bool
Vector = tuple[Lanes, Lanes, Lanes]
# What an instruction's definition gives numba: its signature, and the function that emits it.
Lowering = tuple[Signature, Callable[..., object]]


def instruction(definition: Callable[..., Lowering]) -> Callable[..., Any]:
    """`numba.extending.intrinsic`, typed as kernels call it: without the typing context."""
    return intrinsic(definition)


class WideType(types.Type):
    """numba's type of sixteen float32."""

    def __init__(self) -> None:
        super().__init__(name="Wide")


class MaskType(types.Type):
    """numba's type of sixteen truth values."""

    def __init__(self) -> None:
        super().__init__(name="Mask")


wide, mask = WideType(), MaskType()


@register_model(WideType)
class _WideModel(models.PrimitiveModel):
    def __init__(self, data_model: DataModelManager, kind: types.Type):
        super().__init__(data_model, kind, FLOATS)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, data_model: DataModelManager, kind: types.Type):
        super().__init__(data_model, kind, BITS)


# --- LLVM pieces ---


def constant(value: float) -> ir.Constant:
    """A Wide constant (or, for an int, sixteen 32-bit integers)."""
    return ir.Constant(INTS if isinstance(value, int) else FLOATS, [value] * LANES)


def spread(
    context: BaseContext, builder: ir.IRBuilder, value: ir.Value, numba_type: types.Type
) -> ir.Value:
    """A Wide as it is; a number in every lane."""
    if numba_type == wide:
        return value
    number = context.cast(builder, value, numba_type, types.float32)
    undefined = ir.Constant(FLOATS, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(INT, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(INTS, [0] * LANES))


def call(builder: ir.IRBuilder, name: str, result: ir.Type, *arguments: ir.Value) -> ir.Value:
    """A call of an LLVM intrinsic, declared on first use."""
    function = builder.module.globals.get(name)
    if function is None:
        function = ir.Function(
            builder.module, ir.FunctionType(result, [a.type for a in arguments]), name
        )
    return builder.call(function, arguments, fastmath=FLAGS)


def fused(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
    """a × b + c."""
    return call(builder, f"llvm.fmuladd.v{LANES}f32", FLOATS, a, b, c)


def is_widenable(*numba_types: types.Type) -> bool:
    """Whether all are Wide or numbers."""
    return all(t == wide or isinstance(t, types.Number) for t in numba_types)


# --- operators ---


def _operator(
    function: Callable[..., object], result: types.Type, build: Callable[..., ir.Value]
) -> None:
    """Teach numba a function of the operator module for a Wide with a Wide or a number.

    build  (builder, x, y) → value
    """

    @type_callable(function)
    def typing(context):
        def typer(x, y):
            if wide in (x, y) and is_widenable(x, y):
                return result

        return typer

    def lower(context, builder, signature, arguments):
        return build(
            builder,
            *(
                spread(context, builder, a, t)
                for a, t in zip(arguments, signature.args, strict=True)
            ),
        )

    for pair in ((wide, wide), (wide, types.Number), (types.Number, wide)):
        lower_builtin(function, *pair)(lower)


_operator(operator.add, wide, lambda b, x, y: b.fadd(x, y, flags=FLAGS))
_operator(operator.sub, wide, lambda b, x, y: b.fsub(x, y, flags=FLAGS))
_operator(operator.mul, wide, lambda b, x, y: b.fmul(x, y, flags=FLAGS))
_operator(operator.truediv, wide, lambda b, x, y: b.fdiv(x, y, flags=FLAGS))
_operator(operator.lt, mask, lambda b, x, y: b.fcmp_ordered("<", x, y))
_operator(operator.gt, mask, lambda b, x, y: b.fcmp_ordered(">", x, y))


# --- functions ---


def _unary(build: Callable[..., ir.Value], result: types.Type = wide) -> Callable[..., Any]:
    """A numba function of one Wide (or number): build(builder, x) → value."""

    @instruction
    def function(typing, x):
        def generate(context, builder, signature, arguments):
            return build(builder, spread(context, builder, arguments[0], signature.args[0]))

        return result(x), generate

    return function


def _binary(build: Callable[..., ir.Value]) -> Callable[..., Any]:
    """A numba function of two Wides (or numbers): build(builder, x, y) → value."""

    @instruction
    def function(typing, x, y):
        def generate(context, builder, signature, arguments):
            return build(
                builder,
                *(
                    spread(context, builder, a, t)
                    for a, t in zip(arguments, signature.args, strict=True)
                ),
            )

        return wide(x, y), generate

    return function


def _sum(builder: ir.IRBuilder, x: ir.Value) -> ir.Value:
    """Pairwise in a fixed order, so that every machine adds the same way."""
    half = LANES // 2
    while half:
        undefined, lanes = ir.Constant(x.type, ir.Undefined), ir.VectorType(INT, half)
        low = builder.shuffle_vector(x, undefined, ir.Constant(lanes, list(range(half))))
        high = builder.shuffle_vector(x, undefined, ir.Constant(lanes, list(range(half, 2 * half))))
        x, half = builder.fadd(low, high), half // 2
    return builder.extract_element(x, ir.Constant(INT, 0))


splat = _unary(lambda b, x: x)
sqrt = _unary(lambda b, x: call(b, f"llvm.sqrt.v{LANES}f32", FLOATS, x))
lane_sum = _unary(_sum, types.float32)
lane_max = _unary(
    lambda b, x: call(b, f"llvm.vector.reduce.fmax.v{LANES}f32", FLOAT, x), types.float32
)
maximum = _binary(lambda b, x, y: call(b, f"llvm.maxnum.v{LANES}f32", FLOATS, x, y))
minimum = _binary(lambda b, x, y: call(b, f"llvm.minnum.v{LANES}f32", FLOATS, x, y))


@instruction
def fma(typing: Context, a: types.Type, b: types.Type, c: types.Type) -> Lowering:
    """a × b + c, rounded once where the machine can."""

    def generate(context, builder, signature, arguments):
        return fused(
            builder,
            *(
                spread(context, builder, v, t)
                for v, t in zip(arguments, signature.args, strict=True)
            ),
        )

    return wide(a, b, c), generate


@instruction
def select(typing: Context, condition: types.Type, yes: types.Type, no: types.Type) -> Lowering:
    """`yes` in the lanes where the Mask holds, `no` in the others."""

    def generate(context, builder, signature, arguments):
        yes, no = (spread(context, builder, arguments[i], signature.args[i]) for i in (1, 2))
        return builder.select(arguments[0], yes, no)

    return wide(condition, yes, no), generate


@instruction
def anywhere(typing: Context, condition: types.Type) -> Lowering:
    """Whether the Mask holds in any lane."""

    def generate(context, builder, signature, arguments):
        packed = builder.bitcast(arguments[0], ir.IntType(LANES))
        return builder.icmp_unsigned("!=", packed, ir.Constant(packed.type, 0))

    return types.boolean(condition), generate


@instruction
def bits(typing: Context, condition: types.Type) -> Lowering:
    """The Mask as an integer: bit i is lane i."""

    def generate(context, builder, signature, arguments):
        return builder.zext(builder.bitcast(arguments[0], ir.IntType(LANES)), ir.IntType(64))

    return types.int64(condition), generate


@instruction
def lowest_bit(typing: Context, number: types.Type) -> Lowering:
    """The place of the lowest bit that is set, of an int64 that is not 0."""

    def generate(context, builder, signature, arguments):
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


def _address(
    context: BaseContext,
    builder: ir.IRBuilder,
    pointer: ir.Value,
    index: ir.Value,
    index_type: types.Type,
) -> ir.Value:
    offset = context.cast(builder, index, index_type, types.intp)
    return builder.bitcast(builder.gep(pointer, [offset]), FLOATS.as_pointer())


@instruction
def load(typing: Context, pointer: types.Type, index: types.Type) -> Lowering:
    """Sixteen consecutive floats from pointer[index] on."""

    def generate(context, builder, signature, arguments):
        pointer, index = arguments
        place = _address(context, builder, pointer, index, signature.args[1])
        return builder.load(place, align=4)

    return wide(pointer, index), generate


@instruction
def store(typing: Context, pointer: types.Type, index: types.Type, value: types.Type) -> Lowering:
    """Write sixteen consecutive floats from pointer[index] on."""

    def generate(context, builder, signature, arguments):
        pointer, index, value = arguments
        place = _address(context, builder, pointer, index, signature.args[1])
        builder.store(value, place, align=4)
        return context.get_dummy_value()

    return types.void(pointer, index, value), generate


def _lanes(builder: ir.IRBuilder, values: Sequence[ir.Value], order: Sequence[int]) -> ir.Value:
    """A Wide whose lane i holds values[order[i]]."""
    undefined = ir.Constant(FLOATS, ir.Undefined)
    packed = undefined
    for i, value in enumerate(values):
        packed = builder.insert_element(packed, value, ir.Constant(INT, i))
    return builder.shuffle_vector(packed, undefined, ir.Constant(INTS, order))


def _four(order: Sequence[int]) -> Callable[..., Any]:
    """A numba function of four numbers, which the lanes hold in the order given."""

    @instruction
    def function(typing, a, b, c, d):
        def generate(context, builder, signature, arguments):
            numbers = [
                context.cast(builder, v, t, types.float32)
                for v, t in zip(arguments, signature.args, strict=True)
            ]
            return _lanes(builder, numbers, order)

        return wide(a, b, c, d), generate

    return function


by_four = _four([i // 4 for i in range(LANES)])  # a a a a b b b b …
in_turn = _four([i % 4 for i in range(LANES)])  # a b c d a b c d …


@instruction
def turn_sums(typing: Context, x: types.Type) -> Lowering:
    """Sums (4,) of lanes 0, 4, 8, 12, of lanes 1, 5, 9, 13, and so on, in a fixed order."""

    def generate(context, builder, signature, arguments):
        x = arguments[0]
        for half in (8, 4):
            undefined, lanes = ir.Constant(x.type, ir.Undefined), ir.VectorType(INT, half)
            low = builder.shuffle_vector(x, undefined, ir.Constant(lanes, list(range(half))))
            high = builder.shuffle_vector(
                x, undefined, ir.Constant(lanes, list(range(half, 2 * half)))
            )
            x = builder.fadd(low, high)
        return context.make_tuple(
            builder,
            signature.return_type,
            [builder.extract_element(x, ir.Constant(INT, i)) for i in range(4)],
        )

    return types.UniTuple(types.float32, 4)(x), generate
