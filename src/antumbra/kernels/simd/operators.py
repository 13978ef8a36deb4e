"""Python's operators on vectors, each lowered to one LLVM instruction. A scalar is repeated in all lanes.

The operators use templates and `lower_builtin`. `numba.extending.overload` would compile a separate function
for every operator and pair of types.
"""

import operator

from numba.core import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin

from .vectors import Vector, as_vectors, common_vector


def _binary(op, emit, *elements, inplace=None, compares=False):
    """Define `op` and its in-place form for vectors of `elements`; `emit(builder, vector, a, b)` makes the code."""

    class Binary(AbstractTemplate):
        def generic(self, args, kws):
            vector = common_vector(args) if len(args) == 2 and not kws else None
            if vector is None or vector.element not in elements:
                return None
            result = Vector(types.boolean, vector.lanes) if compares else vector
            return signature(result, *args)

    def lower(context, builder, sig, values):
        vector = common_vector(sig.args)
        return emit(builder, vector, *as_vectors(context, builder, vector, sig.args, values))

    for function in (op, inplace) if inplace else (op,):
        infer_global(function)(type(f"Vector_{function.__name__}", (Binary,), {}))
        lower_builtin(function, Vector, Vector)(lower)
        for scalar in (types.Number, types.Boolean):
            lower_builtin(function, Vector, scalar)(lower)
            lower_builtin(function, scalar, Vector)(lower)


def _unary(op, emit, *elements):
    """Define the unary `op` for vectors of `elements`."""

    class Unary(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 1 and isinstance(args[0], Vector) and args[0].element in elements:
                return signature(args[0], args[0])
            return None

    infer_global(op)(type(f"Vector_{op.__name__}", (Unary,), {}))

    @lower_builtin(op, Vector)
    def lower(context, builder, sig, values):
        return emit(builder, sig.args[0], values[0])


def _method(real=None, i32=None):
    """An emitter that calls the IR builder's method `real` or `i32`, chosen by the element type."""

    def emit(builder, vector, *values):
        return getattr(builder, real if vector.is_real else i32)(*values)

    return emit


def _comparison(symbol):
    """An emitter of comparisons. Like Python's floats, a NaN lane compares false, except for ``!=``, which is true."""

    def emit(builder, vector, a, b):
        if vector.is_i32:
            return builder.icmp_signed(symbol, a, b)
        compare = builder.fcmp_unordered if symbol == "!=" else builder.fcmp_ordered
        return compare(symbol, a, b)

    return emit


_F32, _F64, _I32, _MASK = types.float32, types.float64, types.int32, types.boolean

_binary(operator.add, _method("fadd", "add"), _F32, _F64, _I32, inplace=operator.iadd)
_binary(operator.sub, _method("fsub", "sub"), _F32, _F64, _I32, inplace=operator.isub)
_binary(operator.mul, _method("fmul", "mul"), _F32, _F64, _I32, inplace=operator.imul)
_binary(operator.truediv, _method("fdiv"), _F32, inplace=operator.itruediv)
_binary(operator.and_, _method(i32="and_"), _I32, _MASK, inplace=operator.iand)
_binary(operator.or_, _method(i32="or_"), _I32, _MASK, inplace=operator.ior)
_binary(operator.xor, _method(i32="xor"), _I32, _MASK, inplace=operator.ixor)
_binary(operator.lshift, _method(i32="shl"), _I32, inplace=operator.ilshift)
_binary(operator.rshift, _method(i32="ashr"), _I32, inplace=operator.irshift)
_unary(operator.neg, _method("fneg", "neg"), _F32, _I32)
_unary(operator.pos, lambda builder, vector, a: a, _F32, _I32)
_unary(operator.invert, _method(i32="not_"), _I32, _MASK)

for _op, _symbol in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _binary(_op, _comparison(_symbol), _F32, _I32, compares=True)
