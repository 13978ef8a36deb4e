"""What only devices have, for kernels that run there: thread indices, lanes, local memory, barriers, and atomics.

A *device kernel* is a `kernel` that returns nothing and is launched over many threads. `toolchain.device_code` makes
PTX and SPIR-V of it; Python does not call it. Besides these names, it may use those of `simd`, as long as every pointer
is made from an address that came in as an argument, from `stack_*`, or from `local_*`: ::

    import numpy as np
    from antumbra.kernels.device import i64_at, thread_index
    from antumbra.kernels.jit import kernel
    from antumbra.kernels.simd import f32_at, get, put

    @kernel
    def halve(xs, n):
        "Halve n float32 at the address xs: one thread each."
        i = thread_index()
        if i < n:
            put(f32_at(xs), i, np.float32(0.5) * get(f32_at(xs), i))

Threads
    `thread_index` counts all threads of a launch, which may be more than were asked for: the last block is complete.
    `block_index` and `index_in_block` are its parts, and `block_size` is the number of threads in a block.
Memory
    `load4_aligned` loads 16 bytes at once. `i32_at` and its like in `simd` make pointers from addresses; so do `i64_at`
    and `u8_at`. `atomic_add` and `atomic_min` take int32 and int64 pointers. `local_i32` and `local_f32` are memory
    shared by the threads of a block. Its contents are unspecified when a block starts.
Lanes
    A *subgroup* is what runs in step: a warp of 32 threads in PTX, and in OpenCL the driver's number of work items.
    `lane_count` and `lane_index` describe it. `shuffle` reads a value of another lane, `ballot` gives a bit per lane.
Meetings
    `shuffle` and `ballot` are meetings of all lanes of a subgroup, and `barrier` is one of all threads of a block: all
    of them must get there, even if they have nothing to do. A kernel that returns early or diverges before a meeting is
    undefined on a card; the host device reports it.
Arithmetic
    `fma` contracts scalars as `simd.fma` does vectors: on devices, always. Nothing else is contracted, no operation is
    approximate, and subnormal numbers are not flushed (`toolchain.rounding_checks`).
"""

import typing

from ..jit import Intrinsic

if typing.TYPE_CHECKING:

    def __getattr__(name: str) -> typing.Any: ...


_NAMES = """
    atomic_add atomic_min ballot barrier block_index block_size fma i64_at index_in_block lane_count lane_index
    load4_aligned local_f32 local_i32 shuffle thread_index u8_at
"""
"""Names defined by `operations`, which imports Numba."""

globals().update({name: Intrinsic(f"{__name__}.operations", name) for name in _NAMES.split()})

__all__ = [
    "atomic_add",
    "atomic_min",
    "ballot",
    "barrier",
    "block_index",
    "block_size",
    "fma",
    "i64_at",
    "index_in_block",
    "lane_count",
    "lane_index",
    "load4_aligned",
    "local_f32",
    "local_i32",
    "shuffle",
    "thread_index",
    "u8_at",
]
