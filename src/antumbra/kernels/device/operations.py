"""The intrinsics of `antumbra.kernels.device`, as calls of functions that each target defines in its own IR.

The functions are named `PREFIX` + name. They stay opaque while LLVM optimises a kernel, so that one optimised module
serves all targets (`toolchain.ptx_target`, `toolchain.spirv_target`).
"""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from ..simd.load_store import _address, _check, _make_address, _vector_of
from ..simd.vectors import I32, I64, call_llvm, llvm_type, reject

PREFIX = "antumbra.device."
LOCAL = f"{PREFIX}local."
"""Prefix of functions that return local memory: ``LOCAL first.bytes``."""

# --- Calls of a target's functions ------------------------------------------------------------------------------------


def _call(builder: Any, name: str, result: Any, arguments: list[Any], *attributes: str) -> Any:
    """Call the function `PREFIX` + name, with attributes that allow LLVM to move it, or keep LLVM from doing so."""
    value = call_llvm(builder, PREFIX + name, result, arguments)
    for attribute in ("nounwind", *attributes):
        builder.module.globals[PREFIX + name].attributes.add(attribute)
    return value


def _make_index(name: str, doc: str) -> Any:
    @intrinsic
    def index(typingctx):
        def codegen(context, builder, sig, values):
            return builder.zext(_call(builder, name, I32, [], "readnone"), I64)

        return types.int64(), codegen

    index.__doc__ = doc
    return index


block_index = _make_index("block_index", "The index of this thread's block, an int64.")
block_size = _make_index("block_size", "The number of threads in a block.")
index_in_block = _make_index("index_in_block", "The index of this thread in its block.")
lane_count = _make_index("lane_count", "The number of lanes in a subgroup: a power of two, at most 64.")
lane_index = _make_index("lane_index", "The index of this thread in its subgroup.")


@intrinsic
def thread_index(typingctx):
    """The index of this thread in its launch, an int64."""

    def codegen(context, builder, sig, values):
        block, size, thread = (
            builder.zext(_call(builder, name, I32, [], "readnone"), I64)
            for name in ("block_index", "block_size", "index_in_block")
        )
        return builder.add(builder.mul(block, size), thread)

    return types.int64(), codegen


# --- Meetings ---------------------------------------------------------------------------------------------------------


@intrinsic
def shuffle(typingctx, value, lane):
    """The value, an int32 or float32, of another lane of the subgroup, by its index."""
    if value not in (types.int32, types.float32) or not isinstance(lane, types.Integer):
        reject("shuffle", value, lane, cure="needs an int32 or float32 and the index of a lane")

    def codegen(context, builder, sig, values):
        word = builder.bitcast(values[0], I32)
        source = context.cast(builder, values[1], lane, types.int32)
        found = _call(builder, "shuffle", I32, [word, source], "convergent")
        return builder.bitcast(found, context.get_value_type(value))

    return value(value, lane), codegen


@intrinsic
def ballot(typingctx, condition):
    """The bits of the lanes of the subgroup whose condition is true, an int64."""
    if not isinstance(condition, types.Boolean):
        reject("ballot", condition, cure="needs a boolean")

    def codegen(context, builder, sig, values):
        return _call(builder, "ballot", I64, [values[0]], "convergent")

    return types.int64(condition), codegen


@intrinsic
def barrier(typingctx):
    """Wait for all threads of the block, and see what they wrote to local and global memory."""

    def codegen(context, builder, sig, values):
        _call(builder, "barrier", ir.VoidType(), [], "convergent")
        return context.get_dummy_value()

    return types.void(), codegen


# --- Memory -----------------------------------------------------------------------------------------------------------


def _make_local(name: str, element: Any) -> Any:
    @intrinsic(prefer_literal=True)
    def local(typingctx, first, n):
        """`n` elements of the block's local memory from byte `first` on, a multiple of 16. Both are literals.

        Equal places are the same memory, wherever in the kernel they are named.
        """
        literal = isinstance(first, types.IntegerLiteral) and isinstance(n, types.IntegerLiteral)
        if not literal or first.literal_value < 0 or first.literal_value % 16 or n.literal_value < 1:
            reject(name, first, n, cure="needs a multiple of 16 and a size, literals or module-level constants")

        def codegen(context, builder, sig, values):
            size = n.literal_value * element.bitwidth // 8
            place = f"{LOCAL[len(PREFIX) :]}{first.literal_value}.{size}"
            return _call(builder, place, context.get_data_type(element).as_pointer(), [], "readnone")

        return types.CPointer(element)(first, n), codegen

    return local


local_f32 = _make_local("local_f32", types.float32)
local_i32 = _make_local("local_i32", types.int32)

i64_at = _make_address("i64_at", types.int64)
u8_at = _make_address("u8_at", types.uint8)


@intrinsic
def load4_aligned(typingctx, a, i):
    """Elements i to i + 3 of `a` as a vector. Their address must be a multiple of 16."""
    _check("load4_aligned", a, i)
    vector = _vector_of("load4_aligned", a, 4)

    def codegen(context, builder, sig, values):
        pointer = _address(context, builder, sig, values)
        return builder.load(builder.bitcast(pointer, llvm_type(vector).as_pointer()), align=16)

    return vector(a, i), codegen


@intrinsic
def atomic_add(typingctx, a, i, x):
    """Add x to element i of int32 or int64, atomically; the old value, of that type. It orders no other accesses."""
    return _atomic("add", a, i, x)


@intrinsic
def atomic_min(typingctx, a, i, x):
    """Lower element i to x if that is less, otherwise as `atomic_add`. The order of threads does not matter."""
    return _atomic("min", a, i, x)


def _atomic(operation: str, a: Any, i: Any, x: Any) -> Any:
    name = f"atomic_{operation}"
    _check(name, a, i, writes=True)
    if a.dtype not in (types.int32, types.int64) or not isinstance(x, types.Integer):
        reject(name, a, i, x, cure="needs a pointer to int32 or int64, an index and an integer")

    def codegen(context, builder, sig, values):
        operand = context.cast(builder, values[2], x, a.dtype)
        return builder.atomic_rmw(operation, _address(context, builder, sig, values), operand, "monotonic")

    return a.dtype(a, i, x), codegen


# --- Arithmetic -------------------------------------------------------------------------------------------------------


@intrinsic
def fma(typingctx, a, b, c):
    """a * b + c of float32 or float64 scalars, rounded once."""
    if len({a, b, c}) != 1 or a not in (types.float32, types.float64):
        reject("fma", a, b, c, cure="needs three float32 or three float64")

    def codegen(context, builder, sig, values):
        return call_llvm(builder, f"llvm.fmuladd.f{a.bitwidth}", values[0].type, values)

    return a(a, b, c), codegen
