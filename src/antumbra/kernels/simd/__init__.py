"""Vectors of 4, 8 or 16 numbers as values inside Numba kernels.

Numba leaves vectorisation to LLVM, which cannot vectorise a traversal because of its branches. This package makes
vectors explicit: an ``f32x8`` is eight float32 in one register, and ``a + b`` of two of them is one instruction.
Kernels hold vectors in local variables and tuples, and pass them to other kernels. Python sees only arrays.

- `vectors`: the types, the conversion of arguments to vectors, and Python's operators on vectors
- `lanes`: operations on the lanes of vectors, on the bits of an int64, and the rounding error of a product
- `load_store`: loads, stores, pointers, and memory on the stack

An example::

    import numpy as np
    from antumbra.kernels.jit import kernel
    from antumbra.kernels.simd import bits, fma, load8, popcount

    @kernel
    def count_inside(xs, ys, radius):
        "The number of points inside the circle around the origin; len(xs) is a multiple of 8."
        count = 0
        for i in range(0, len(xs), 8):
            x, y = load8(xs, i), load8(ys, i)
            count += popcount(bits(fma(x, x, y * y) <= radius * radius))
        return count

    points = np.random.default_rng(1).random((2, 800), np.float32)
    inside = count_inside(points[0], points[1], np.float32(1.0))

Types
    ``f32xN`` (float32), ``i32xN`` (int32), ``maskN`` (one bit per lane), for N = 4, 8, 16. ``f64xN`` (float64) supports
    only `load`, `broadcast`, ``+ - *``, `to_f32` and `to_f64`. Vectors of different widths cannot be combined. A vector
    wider than the processor's registers is split into several.
Operators
    ``+ - *`` and comparisons on f32 and i32, ``/`` on f32, ``<< >>`` on i32, ``& | ^ ~`` on i32 and masks,
    and the in-place forms. A scalar operand is converted to the element type and broadcast, as in ``v * 2``; so are
    scalar arguments of functions of vectors. A mask has no truth value: write ``if any_lane(m):``.
Make
    `splat4` (a scalar), `iota4` (0, 1, 2, ...), `mask_from_bits4`, `load4` and `broadcast4` (from memory), and all of
    these for 8 and 16 lanes. `splat1` makes a vector of one lane, which functions of vectors take for a single ray.
Lanes
    `minimum`, `maximum`, `fma`, `absolute`, `square_root`, `flip_sign`, `select`, `to_f32`, `to_f64`, `to_i32`,
    `f32_bits`; `swap_halves`, `shuffle`, `permute`, `join`, `extract`; `reduce_min`, `reduce_max`, `reduce_and`; for
    masks `bits`, `any_lane`, `all_lanes`.
Memory
    `load4`, `broadcast4`, `gather`, `store`, `store_compressed`, `get` and `put` work on arrays and pointers, as do
    `load16x3` and `load8x3_pair`, which deinterleave vectors. `ptr`, `ptr_at`, `as_f32` and `as_i32` make pointers;
    `f32_at`, `f64_at` and `i32_at` make them from an address. `stack_f32`, `stack_f64`, `stack_i32` and `stack_i64`
    allocate scratch memory, `stack_array` an array. Also `prefetch`, `atomic_add`, `atomic_and` and `atomic_or`.
Bits of an int64
    `popcount`, `lowest_bit` (64 for 0) and `highest_bit` (-1 for 0), to iterate over the lanes of ``bits(mask)``.
Float64
    `product_error`, the exact rounding error of a product of two scalars.
Loops
    `widen_loops` lets LLVM vectorise the loops of a kernel for 512-bit registers.

Guarantees and limits
---------------------
Rounding
    Every f32 operation rounds as IEEE 754 requires, including denormals, and gives the same bits on every processor.
    Operations are never reordered or contracted. The exception is `fma` (``llvm.fmuladd``), which rounds once if the
    processor has the instruction, and otherwise twice.
NaN
    In a NaN lane, ``!=`` is true and all other comparisons are false. In `minimum`, `maximum`, `reduce_min` and
    `reduce_max`, a NaN makes the result *unspecified*. Avoid NaN, or replace it by `select` first. `select`,
    `absolute`, `flip_sign` and `store` preserve NaN.
Signed zero
    -0.0 == 0.0. `minimum` and `maximum` of the two may return either. `flip_sign` uses the sign bit, so -0.0 flips.
Integers
    i32 wraps around. ``>>`` is arithmetic and preserves the sign. Shifts by less than 0 or more than 31 are
    unspecified. `to_f32` rounds to nearest. `to_i32` truncates; it is unspecified for NaN and for values outside int32.
Alignment
    Not required. `stack_*` memory is aligned to 64 bytes.
Bounds
    Unchecked. A lane index, an element index or a pointer out of range is undefined behaviour. Negative indices do not
    wrap around. A load or store accesses all of its lanes.
Lifetime
    A pointer does not keep its array alive. Numba frees an array made in the kernel after the last line that names the
    *array*, so take pointers to arguments, or name the array again after the last use of the pointer. `stack_*` memory
    is not cleared. Each call in the source allocates one block, so a loop gets the same block every time. The block
    lives until the kernel that allocated it returns.
Aliasing
    Pointers and arrays may overlap, and may access the same bytes as float32 and as int32.
Speed
    On processors without AVX-512, a mask that is live across iterations of a loop is repacked in each one. Use its
    `bits` instead.
"""

import typing

from ..jit import Intrinsic

if typing.TYPE_CHECKING:

    def __getattr__(name: str) -> typing.Any: ...


_HOMES = {
    "lanes": """
        absolute all_lanes any_lane bits extract f32_bits flip_sign fma iota4 iota8 iota16 join mask_from_bits4
        mask_from_bits8 mask_from_bits16 maximum minimum permute reduce_and reduce_max reduce_min select shuffle splat1
        splat4 splat8 splat16 square_root swap_halves to_f32 to_f64 to_i32 highest_bit lowest_bit popcount product_error
        widen_loops
    """,
    "load_store": """
        as_f32 as_i32 atomic_add atomic_and atomic_or broadcast4 broadcast8 broadcast16 f32_at f64_at gather get
        i32_at load4 load8 load8x3_pair load16 load16x3 prefetch ptr ptr_at put stack_array stack_f32 stack_f64
        stack_i32 stack_i64 store store_compressed
    """,
}
"""Names defined by each module. These modules import Numba, and are not needed for compiled kernels."""

globals().update(
    {name: Intrinsic(f"{__name__}.{home}", name) for home, names in _HOMES.items() for name in names.split()}
)

__all__ = [
    "absolute",
    "all_lanes",
    "any_lane",
    "as_f32",
    "as_i32",
    "atomic_add",
    "atomic_and",
    "atomic_or",
    "bits",
    "broadcast4",
    "broadcast8",
    "broadcast16",
    "extract",
    "f32_at",
    "f32_bits",
    "f64_at",
    "flip_sign",
    "fma",
    "gather",
    "get",
    "highest_bit",
    "i32_at",
    "iota4",
    "iota8",
    "iota16",
    "join",
    "load4",
    "load8",
    "load8x3_pair",
    "load16",
    "load16x3",
    "lowest_bit",
    "mask_from_bits4",
    "mask_from_bits8",
    "mask_from_bits16",
    "maximum",
    "minimum",
    "permute",
    "popcount",
    "prefetch",
    "product_error",
    "ptr",
    "ptr_at",
    "put",
    "reduce_and",
    "reduce_max",
    "reduce_min",
    "select",
    "shuffle",
    "splat1",
    "splat4",
    "splat8",
    "splat16",
    "square_root",
    "stack_array",
    "stack_f32",
    "stack_f64",
    "stack_i32",
    "stack_i64",
    "store",
    "store_compressed",
    "swap_halves",
    "to_f32",
    "to_f64",
    "to_i32",
    "widen_loops",
]
