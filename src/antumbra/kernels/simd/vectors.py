"""The vector types, the conversion of arguments to vectors, and Python's operators on vectors.

To Numba, a vector is a *value*, like a float. It has no address, is never boxed for Python, and lives in a register.
LLVM splits vectors that are wider than the target's registers.

Each operator lowers to one LLVM instruction and broadcasts scalars. Operators use templates and `lower_builtin`,
because `numba.extending.overload` would compile a separate function for every operator and pair of types.
"""

import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn, TypeAlias

from llvmlite import ir
from numba.core import errors, types
from numba.core.datamodel import models
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, register_model

# --- Types and conversion ---------------------------------------------------------------------------------------------


_PREFIX = {types.float32: "f32x", types.float64: "f64x", types.int32: "i32x", types.boolean: "mask"}
_LLVM = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.int32: ir.IntType(32),
    types.boolean: ir.IntType(1),
}
_SCALARS = {
    types.float32: (types.Integer, types.Float),
    types.float64: (types.Integer, types.Float),
    types.int32: (types.Integer,),
    types.boolean: (types.Boolean,),
}
I32 = ir.IntType(32)
I64 = ir.IntType(64)

_Emitter: TypeAlias = Callable[..., Any]  # (builder, vector, *values) -> value


class Vector(types.Type):
    """The Numba type of `lanes` values of one element type: float32, float64, int32 or boolean (a mask)."""

    def __init__(self, element: Any, lanes: int) -> None:
        self.element = element
        self.lanes = lanes
        super().__init__(name=f"{_PREFIX[element]}{lanes}")

    @property
    def is_f32(self) -> bool:
        return bool(self.element == types.float32)

    @property
    def is_real(self) -> bool:
        return self.element in (types.float32, types.float64)

    @property
    def is_i32(self) -> bool:
        return bool(self.element == types.int32)

    @property
    def suffix(self) -> str:
        """The suffix of LLVM intrinsics on this vector type, such as ``v8f32``."""
        return f"v{self.lanes}{'f32' if self.is_f32 else 'i32'}"


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        super().__init__(dmm, fe_type, llvm_type(fe_type))


def llvm_type(vector: Vector) -> ir.VectorType:
    """The LLVM vector type of a `Vector`."""
    return ir.VectorType(_LLVM[vector.element], vector.lanes)


f32x4, f32x8, f32x16 = (Vector(types.float32, lanes) for lanes in (4, 8, 16))
f64x4, f64x8, f64x16 = (Vector(types.float64, lanes) for lanes in (4, 8, 16))
i32x4, i32x8, i32x16 = (Vector(types.int32, lanes) for lanes in (4, 8, 16))
mask4, mask8, mask16 = (Vector(types.boolean, lanes) for lanes in (4, 8, 16))


def reject(function: str, *args: object, cure: str) -> NoReturn:
    """Raise a typing error for `function` that names the argument types and the cure."""
    raise errors.TypingError(f"antumbra.kernels.simd.{function}({', '.join(str(a) for a in args)}): {cure}")


def accepts(vector: Vector, arg: object) -> bool:
    """Whether `arg` is `vector` itself or a scalar that can be broadcast to it."""
    return arg == vector or isinstance(arg, _SCALARS[vector.element])


def common_vector(args: Iterable[Any]) -> Vector | None:
    """The only vector type among the arguments, if all others are scalars that can be broadcast to it; else None."""
    vectors = {arg for arg in args if isinstance(arg, Vector)}
    if len(vectors) != 1:
        return None
    (vector,) = vectors
    return vector if all(accepts(vector, arg) for arg in args) else None


def repeat(builder: Any, value: Any, lanes: int) -> Any:
    """`value` in every lane."""
    vector = ir.VectorType(value.type, lanes)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, I32(0))
    zeros = ir.Constant(ir.VectorType(I32, lanes), [0] * lanes)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def as_vectors(
    context: Any, builder: Any, vector: Vector, arg_types: Iterable[Any], values: Iterable[Any]
) -> list[Any]:
    """The values as `vector`s. Scalars are converted to the element type and broadcast."""
    return [
        value if arg == vector else repeat(builder, context.cast(builder, value, arg, vector.element), vector.lanes)
        for arg, value in zip(arg_types, values)
    ]


def call_llvm(builder: Any, name: str, result: Any, args: Sequence[Any], fastmath: tuple[str, ...] = ()) -> Any:
    """Call the LLVM intrinsic `name`."""
    signature = ir.FunctionType(result, [arg.type for arg in args])
    function = builder.module.globals.get(name) or ir.Function(builder.module, signature, name)
    return builder.call(function, args, fastmath=fastmath)


# --- Operators --------------------------------------------------------------------------------------------------------


def _binary(op: Any, emit: _Emitter, *elements: types.Type, inplace: Any = None, compares: bool = False) -> None:
    """Define `op` and its in-place form for vectors of `elements`; `emit(builder, vector, a, b)` emits the code."""

    class Binary(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            vector = common_vector(args) if len(args) == 2 and not kws else None
            if vector is None or vector.element not in elements:
                return None
            result = Vector(types.boolean, vector.lanes) if compares else vector
            return signature(result, *args)

    def lower(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        vector: Any = common_vector(sig.args)
        return emit(builder, vector, *as_vectors(context, builder, vector, sig.args, values))

    for function in (op, inplace) if inplace else (op,):
        infer_global(function)(type(f"Vector_{function.__name__}", (Binary,), {}))
        lower_builtin(function, Vector, Vector)(lower)
        for scalar in (types.Number, types.Boolean):
            lower_builtin(function, Vector, scalar)(lower)
            lower_builtin(function, scalar, Vector)(lower)


def _unary(op: Any, emit: _Emitter, *elements: types.Type) -> None:
    """Define the unary `op` for vectors of `elements`."""

    class Unary(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 1 and isinstance(args[0], Vector) and args[0].element in elements:
                return signature(args[0], args[0])
            return None

    infer_global(op)(type(f"Vector_{op.__name__}", (Unary,), {}))

    @lower_builtin(op, Vector)  # type: ignore[untyped-decorator]
    def lower(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        return emit(builder, sig.args[0], values[0])


def _method(real: str | None = None, i32: str | None = None) -> _Emitter:
    """An emitter that calls the IR builder's method `real` or `i32`, chosen by the element type."""

    def emit(builder: Any, vector: Vector, *values: Any) -> Any:
        name: Any = real if vector.is_real else i32
        return getattr(builder, name)(*values)

    return emit


def _comparison(symbol: str) -> _Emitter:
    """An emitter of comparisons. As in Python, a NaN lane compares false, except for ``!=``, which is true."""

    def emit(builder: Any, vector: Vector, a: Any, b: Any) -> Any:
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
