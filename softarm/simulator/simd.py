"""A vector type for numba with one entry a lane, in SIMD registers by construction.

The compiler's vectoriser gives up on a loop over lanes whose rows are chosen at run time (measured: 9 times slower).
With this type the kernel is written as if for one robot, and every operation is SIMD.

    x = load(memory, row, lanes)      # memory: `Rows` of a block, `lanes`: a tuple as long as a row
    store(memory, row, lanes, select(x > 0.0, x * x, 0.5 - x))

Vectors take + - * / and comparisons with each other and with scalars. They live in compiled functions only.

A sum with a product is a fused multiply-add. It is chosen here and not by the compiler, so that the bits do not depend
on the number of lanes.

A vector of one lane is a scalar: on a graphics card each thread computes one lane (cuda/stepper.py).
"""

# The arguments of code generators are numba's own types.
# mypy: allow-untyped-defs, allow-untyped-calls, allow-subclassing-any
import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model


class Vector(types.Type):
    """Type of `width` numbers of one element type; a comparison gives elements of type boolean."""

    def __init__(self, element: types.Type, width: int) -> None:
        self.element, self.width = element, width
        super().__init__(name=f"Vector({element}, {width})")

    @property
    def key(self) -> tuple[types.Type, int]:
        """Return the element type and the width, which identify the type."""
        return self.element, self.width


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, fe_type):
        super().__init__(manager, fe_type, _llvm(fe_type))


def _llvm(vector: Vector) -> ir.VectorType:
    elements = {types.float32: ir.FloatType(), types.float64: ir.DoubleType(), types.boolean: ir.IntType(1)}
    return ir.VectorType(elements[vector.element], vector.width) if vector.width > 1 else elements[vector.element]


def _suffix(kind: ir.Type) -> str:
    """Return how LLVM's function names end for a type."""
    width, element = (f"v{kind.count}", kind.element) if isinstance(kind, ir.VectorType) else ("", kind)
    return f"{width}f{64 if element == ir.DoubleType() else 32}"


def _splat(context, builder, value, value_type, vector):
    """Make a vector of a scalar; a vector stays as it is."""
    if isinstance(value_type, Vector):
        return value
    scalar = context.cast(builder, value, value_type, vector.element)
    if vector.width == 1:
        return scalar
    one = builder.insert_element(ir.Constant(_llvm(vector), ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.width), None)
    return builder.shuffle_vector(one, one, zeros)


def _common(types_of_arguments: tuple[types.Type, ...]) -> Vector | None:
    """Return the vector type among operands when all others are numbers or the same vector."""
    vectors = {t for t in types_of_arguments if isinstance(t, Vector)}
    if len(vectors) == 1 and all(isinstance(t, Vector | types.Number) for t in types_of_arguments):
        return vectors.pop()
    return None


def _define(function, build, result=lambda vector: vector):
    """Register an operator with numba: its types and its LLVM instruction."""

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            vector = None if kws else _common(args)
            return None if vector is None else signature(result(vector), *args)

    def lower(context, builder, sig, args):
        vector = _common(sig.args)
        return build(builder, *(_splat(context, builder, a, t, vector) for a, t in zip(args, sig.args, strict=True)))

    for pattern in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
        lower_builtin(function, *pattern)(lower)


def _mask(vector: Vector) -> Vector:
    return Vector(types.boolean, vector.width)


def _factors(value: ir.Value) -> tuple[ir.Value, ir.Value] | None:
    """Return the factors of a value that the same expression has just multiplied, else None."""
    return tuple(value.operands) if getattr(value, "opname", "") == "fmul" else None


def _fused(builder, x, y, z):
    """Return x * y + z, rounded once."""
    called = ir.FunctionType(x.type, [x.type] * 3)
    name = f"llvm.fma.{_suffix(x.type)}"
    return builder.call(cgutils.get_or_insert_function(builder.module, called, name), (x, y, z))


def _negative(builder, x):
    # Cards do not know LLVM's `fneg`.
    zero = ir.Constant(x.type, [-0.0] * x.type.count if isinstance(x.type, ir.VectorType) else -0.0)
    return builder.fsub(zero, x)


def _sum(builder, x, y):
    if factors := _factors(y):
        return _fused(builder, *factors, x)
    if factors := _factors(x):
        return _fused(builder, *factors, y)
    return builder.fadd(x, y)


def _difference(builder, x, y):
    if factors := _factors(y):
        return _fused(builder, _negative(builder, factors[0]), factors[1], x)
    if factors := _factors(x):
        return _fused(builder, *factors, _negative(builder, y))
    return builder.fsub(x, y)


_define(operator.add, _sum)
_define(operator.sub, _difference)
_define(operator.mul, lambda b, x, y: b.fmul(x, y))
_define(operator.truediv, lambda b, x, y: b.fdiv(x, y))
_define(operator.lt, lambda b, x, y: b.fcmp_ordered("<", x, y), _mask)
_define(operator.gt, lambda b, x, y: b.fcmp_ordered(">", x, y), _mask)
_define(operator.ge, lambda b, x, y: b.fcmp_ordered(">=", x, y), _mask)
_define(operator.ne, lambda b, x, y: b.fcmp_unordered("!=", x, y), _mask)


class Rows(types.CPointer):  # type: ignore[name-defined]
    """Pointer to rows of numbers, `stride` numbers apart; unlike an array it counts no references."""

    def __init__(self, element: types.Type, stride: int) -> None:
        super().__init__(element)
        self.stride = stride
        self.name = f"Rows({element}, {stride})"

    @property
    def key(self) -> tuple[types.Type, int]:
        """Return the element type and the stride, which identify the type."""
        return self.dtype, self.stride


register_model(Rows)(models.PointerModel)


@intrinsic
def block(typingctx, memory, number, lanes):
    """Return the rows of a block of a memory [blocks, rows * lanes]."""

    def build(context, builder, sig, args):
        array = context.make_array(memory)(context, builder, args[0])
        stride = cgutils.unpack_tuple(builder, array.strides)[0]
        number = context.cast(builder, args[1], sig.args[1], types.intp)
        return cgutils.pointer_add(builder, array.data, builder.mul(number, stride))

    return Rows(memory.dtype, len(lanes))(memory, number, lanes), build


def _row(context, builder, memory_type, memory, row, vector):
    """Return a pointer to a row of a block or of a flat array, as a vector."""
    if isinstance(memory_type, types.Array):
        memory, stride = context.make_array(memory_type)(context, builder, memory).data, vector.width
    else:
        stride = memory_type.stride
    start = builder.mul(row, ir.Constant(row.type, stride))
    return builder.bitcast(builder.gep(memory, [start]), _llvm(vector).as_pointer())


@intrinsic
def load(typingctx, memory, row, lanes):
    """Read a row of a block or of a flat array."""
    vector = Vector(memory.dtype, len(lanes))

    def build(context, builder, sig, args):
        row = context.cast(builder, args[1], sig.args[1], types.intp)
        pointer = _row(context, builder, sig.args[0], args[0], row, vector)
        return builder.load(pointer, align=memory.dtype.bitwidth // 8)

    return vector(memory, row, lanes), build


@intrinsic
def store(typingctx, memory, row, lanes, value):
    """Write a row of a block or of a flat array; a scalar goes to every lane."""
    vector = Vector(memory.dtype, len(lanes))

    def build(context, builder, sig, args):
        row = context.cast(builder, args[1], sig.args[1], types.intp)
        pointer = _row(context, builder, sig.args[0], args[0], row, vector)
        whole = _splat(context, builder, args[3], sig.args[3], vector)
        builder.store(whole, pointer, align=memory.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.none(memory, row, lanes, value), build


@intrinsic
def select(typingctx, condition, yes, no):
    """Return `yes` where the condition holds, else `no`; at least one is a vector."""
    vector = _common((yes, no))
    if vector is None:
        raise TypingError(f"select({condition}, {yes}, {no}): one of the last two must be a vector")

    def build(context, builder, sig, args):
        values = (_splat(context, builder, a, t, vector) for a, t in zip(args[1:], sig.args[1:], strict=True))
        return builder.select(args[0], *values)

    return vector(condition, yes, no), build


@intrinsic
def fill(typingctx, like, value):
    """Return a vector like `like` that holds the scalar in every lane."""

    def build(context, builder, sig, args):
        return _splat(context, builder, args[1], sig.args[1], like)

    return like(like, value), build


@intrinsic
def some(typingctx, mask):
    """Return whether a condition holds in any lane, as a scalar to branch on."""

    def build(context, builder, sig, args):
        bits = builder.bitcast(args[0], ir.IntType(mask.width))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(mask), build


def _function(name):
    """Return one of LLVM's own functions of a vector."""

    @intrinsic
    def function(typingctx, x):
        def build(context, builder, sig, args):
            kind = _llvm(x)
            called = ir.FunctionType(kind, [kind])
            full = f"llvm.{name}.{_suffix(kind)}" if x.width > 1 else f"__nv_{name}f"  # of CUDA's own library
            return builder.call(cgutils.get_or_insert_function(builder.module, called, full), args)

        return x(x), build

    return function


floor = _function("floor")  # rounds towards minus infinity
magnitude = _function("fabs")
root = _function("sqrt")
