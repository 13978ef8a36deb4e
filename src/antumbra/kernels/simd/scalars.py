"""Bit operations on an int64, for loops over the set lanes of a mask."""

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

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
