"""Types of the fields of NamedTuples that kernels take, for readers. At run time each is `Any`.

A pointer is an address that `simd.ptr` makes of an array. ``F32x4`` and its like are the vectors of `simd`.
"""

from typing import Any, TypeAlias

F32Ptr: TypeAlias = Any
F64Ptr: TypeAlias = Any
BoolPtr: TypeAlias = Any
I8Ptr: TypeAlias = Any
I32Ptr: TypeAlias = Any
I64Ptr: TypeAlias = Any
F32x4: TypeAlias = Any
I32x16: TypeAlias = Any
