"""Vectors of 4, 8 or 16 numbers as values inside Numba kernels.

Numba leaves it to LLVM to find what can be done side by side; in a traversal, which is all branches, LLVM
finds nothing. Here it is said: an ``f32x8`` is eight float32 in one register, and ``a + b`` on two of them
is one instruction. A kernel holds vectors in local variables, in tuples, and passes them to other kernels;
Python only ever sees arrays. ::

    import numpy as np
    from antumbra.kernels.jit import kernel
    from antumbra.kernels.simd import bits, fma, load8, popcount

    @kernel
    def count_inside(xs, ys, radius):
        "How many of the points are in the circle around the origin; len(xs) is a multiple of 8."
        count = 0
        for i in range(0, len(xs), 8):
            x, y = load8(xs, i), load8(ys, i)
            count += popcount(bits(fma(x, x, y * y) <= radius * radius))
        return count

    points = np.random.default_rng(1).random((2, 800), np.float32)
    inside = count_inside(points[0], points[1], np.float32(1.0))

Types
    ``f32xN`` (float32), ``i32xN`` (int32), ``maskN`` (one bit per lane), for N = 4, 8, 16. Vectors of other
    widths do not mix. A width that the processor lacks is split into several registers.
Operators
    ``+ - *`` and comparisons on f32 and i32, ``/`` on f32, ``<< >>`` on i32, ``& | ^ ~`` on i32 and masks,
    and the in-place forms. A scalar operand is converted to the element type and repeated, as in ``v * 2``;
    so is a scalar among the vectors that a function takes. A mask has no truth value: ``if any_lane(m):``.
Make
    `splat4` (a scalar), `iota4` (0, 1, 2, ...), `mask_from_bits4`, `load4` and `broadcast4` (from memory);
    8 and 16 alike.
Lanes
    `minimum`, `maximum`, `fma`, `absolute`, `square_root`, `flip_sign`, `select`, `to_f32`, `to_i32`; `swap_halves`,
    `shuffle`, `join`, `compress`, `extract`; `reduce_min`, `reduce_max`, `reduce_and`; of masks `bits`, `any_lane`,
    `all_lanes`.
Memory
    `load4`, `broadcast4`, `gather`, `store`, `get`, `put` on arrays and pointers; `ptr`, `ptr_at`, `as_f32`, `as_i32`
    make pointers, `f32_at`, `f64_at`, `i32_at` from an address; `stack_f32`, `stack_f64`, `stack_i32`,
    `stack_i64` give scratch memory, `stack_array` an array of it; `prefetch`; `atomic_add`, `atomic_and`, `atomic_or`.
Bits of an int64
    `popcount`, `lowest_bit` (64 for 0) and `highest_bit` (-1 for 0), to walk the lanes of ``bits(mask)``.

What holds, and what does not
-----------------------------
Rounding
    Every f32 operation rounds as IEEE 754 says, alike on every processor, denormals included; nothing is
    reordered or contracted. Only `fma` (``llvm.fmuladd``) differs: it rounds once where the processor has
    the instruction, else twice.
NaN
    Comparisons are false where a lane is NaN, ``!=`` is true. In `minimum`, `maximum`, `reduce_min` and
    `reduce_max` a NaN makes the result *unspecified*, and so whatever is computed from it: keep NaN out, or
    replace it by `select` first. `select`, `absolute`, `flip_sign`, `store` carry NaN through.
Signed zero
    -0.0 == 0.0. `minimum` and `maximum` of the two may give either. `flip_sign` goes by the sign bit, so
    -0.0 flips.
Integers
    i32 wraps around. ``>>`` is arithmetic: it keeps the sign. A shift by less than 0 or more than 31 is
    unspecified. `to_f32` rounds to nearest; `to_i32` truncates, and is unspecified for NaN and for what an
    int32 cannot hold.
Alignment
    None needed. `stack_*` memory is aligned to 64 bytes.
Bounds
    Nothing is checked: a lane index, an element index or a pointer out of range is undefined behaviour, and a
    negative index does not wrap around. A load or store touches all of its lanes.
Lifetime
    A pointer does not keep its array alive. Numba frees an array made in the kernel after the last line
    that names the *array*: take pointers to arguments, or name the array again after the last use of the
    pointer. `stack_*` memory is not cleared, is one block per call written in the source (a loop gets the
    same one each time), and ends with the kernel that asked for it.
Aliasing
    Pointers and arrays may overlap, and may see the same bytes as float32 and as int32.
Speed
    On processors without AVX-512, a mask kept from one iteration of a loop to the next is repacked in each;
    keep its `bits` instead.
"""

import typing

from ..jit import Intrinsic

if typing.TYPE_CHECKING:

    def __getattr__(name: str) -> typing.Any: ...


_HOMES = {
    "lanes": """
        absolute all_lanes any_lane bits compress extract flip_sign fma iota4 iota8 iota16 join mask_from_bits4
        mask_from_bits8 mask_from_bits16 maximum minimum reduce_and reduce_max reduce_min select shuffle splat4
        splat8 splat16 square_root swap_halves to_f32 to_i32
    """,
    "memory": """
        as_f32 as_i32 atomic_add atomic_and atomic_or broadcast4 broadcast8 broadcast16 f32_at f64_at gather get
        i32_at load4 load8 load16 prefetch ptr ptr_at put stack_array stack_f32 stack_f64 stack_i32 stack_i64
        store
    """,
    "scalars": """
        highest_bit lowest_bit popcount
    """,
}
"""Module: what it defines. These modules import Numba; a kernel that is compiled already needs none of them."""

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
    "compress",
    "extract",
    "f32_at",
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
    "load16",
    "lowest_bit",
    "mask_from_bits4",
    "mask_from_bits8",
    "mask_from_bits16",
    "maximum",
    "minimum",
    "popcount",
    "prefetch",
    "ptr",
    "ptr_at",
    "put",
    "reduce_and",
    "reduce_max",
    "reduce_min",
    "select",
    "shuffle",
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
    "swap_halves",
    "to_f32",
    "to_i32",
]
