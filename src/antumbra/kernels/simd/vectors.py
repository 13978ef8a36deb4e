"""The vector types, and the conversion of arguments to vectors: a scalar is repeated in all lanes.

A vector is a *value* to Numba, as a float is. It has no address, is never boxed for Python, and lives in a
register. LLVM splits a vector that is wider than the target's registers.
"""

from typing import NoReturn

from llvmlite import ir
from numba.core import errors, types
from numba.core.datamodel import models
from numba.extending import register_model

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


class Vector(types.Type):
    """The Numba type of `lanes` values of one element type: float32, float64, int32 or boolean (a mask)."""

    def __init__(self, element, lanes):
        self.element = element
        self.lanes = lanes
        super().__init__(name=f"{_PREFIX[element]}{lanes}")

    @property
    def is_f32(self):
        return self.element == types.float32

    @property
    def is_real(self):
        return self.element in (types.float32, types.float64)

    @property
    def is_i32(self):
        return self.element == types.int32

    @property
    def suffix(self):
        """The suffix of LLVM intrinsics on this vector type, such as ``v8f32``."""
        return f"v{self.lanes}{'f32' if self.is_f32 else 'i32'}"


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, llvm_type(fe_type))


def llvm_type(vector):
    """The LLVM vector type of a `Vector`."""
    return ir.VectorType(_LLVM[vector.element], vector.lanes)


f32x4, f32x8, f32x16 = (Vector(types.float32, lanes) for lanes in (4, 8, 16))
f64x4, f64x8, f64x16 = (Vector(types.float64, lanes) for lanes in (4, 8, 16))
i32x4, i32x8, i32x16 = (Vector(types.int32, lanes) for lanes in (4, 8, 16))
mask4, mask8, mask16 = (Vector(types.boolean, lanes) for lanes in (4, 8, 16))


def reject(function, *args, cure) -> NoReturn:
    """Raise a typing error of `function` that names the argument types and the cure."""
    raise errors.TypingError(f"antumbra.kernels.simd.{function}({', '.join(str(a) for a in args)}): {cure}")


def accepts(vector, arg):
    """Whether `arg` is `vector` itself or a scalar that can be repeated in its lanes."""
    return arg == vector or isinstance(arg, _SCALARS[vector.element])


def common_vector(args):
    """The one vector type among the arguments, if all others are scalars that can be repeated to it; else None."""
    vectors = {arg for arg in args if isinstance(arg, Vector)}
    if len(vectors) != 1:
        return None
    (vector,) = vectors
    return vector if all(accepts(vector, arg) for arg in args) else None


def repeat(builder, value, lanes):
    """`value` in every lane."""
    vector = ir.VectorType(value.type, lanes)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, I32(0))
    zeros = ir.Constant(ir.VectorType(I32, lanes), [0] * lanes)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def as_vectors(context, builder, vector, arg_types, values):
    """The values as `vector`s. Scalars are converted to the element type and repeated."""
    return [
        value if arg == vector else repeat(builder, context.cast(builder, value, arg, vector.element), vector.lanes)
        for arg, value in zip(arg_types, values)
    ]


def call_llvm(builder, name, result, args, fastmath=()):
    """Call the LLVM intrinsic `name`."""
    signature = ir.FunctionType(result, [arg.type for arg in args])
    function = builder.module.globals.get(name) or ir.Function(builder.module, signature, name)
    return builder.call(function, args, fastmath=fastmath)
