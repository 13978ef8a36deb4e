"""Bit operations on an int64, for loops over the set lanes of a mask; and the error of a float64 product."""

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from .by_level import name_of_product_error
from .vectors import I64, call_llvm, reject


def _make_bit_count(name, llvm_name, *flags):
    @intrinsic
    def count(typingctx, x):
        if not isinstance(x, types.Integer):
            reject(name, x, cure="needs an integer")

        def codegen(context, builder, sig, values):
            wide = context.cast(builder, values[0], x, types.int64)
            return call_llvm(builder, llvm_name, I64, [wide, *(ir.IntType(1)(flag) for flag in flags)])

        return types.int64(x), codegen

    return count


popcount = _make_bit_count("popcount", "llvm.ctpop.i64")
lowest_bit = _make_bit_count("lowest_bit", "llvm.cttz.i64", 0)


@intrinsic
def highest_bit(typingctx, x):
    """Index of the highest set bit; -1 for 0."""
    if not isinstance(x, types.Integer):
        reject("highest_bit", x, cure="needs an integer")

    def codegen(context, builder, sig, values):
        wide = context.cast(builder, values[0], x, types.int64)
        zeros = call_llvm(builder, "llvm.ctlz.i64", I64, [wide, ir.IntType(1)(0)])
        return builder.sub(I64(63), zeros)

    return types.int64(x), codegen


@intrinsic
def product_error(typingctx, a, b, product):
    """a b - product, exactly, where `product` is the float64 product of two float64 numbers.

    The numbers must stay within 1e-150 .. 1e150, or be 0.
    """
    if (a, b, product) != (types.float64,) * 3:
        reject("product_error", a, b, product, cure="needs three float64")
    name = name_of_product_error()

    def codegen(context, builder, sig, values):
        return call_llvm(builder, name, ir.DoubleType(), values)

    return types.float64(a, b, product), codegen
