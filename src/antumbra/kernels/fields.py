"""Types of the fields of NamedTuples that kernels take, for readers. At run time each is `Any`.

A pointer is an address that `simd.ptr` makes of an array. ``F32x4`` and its like are the vectors of `simd`. Numbers are
``int`` (int64), ``np.float32`` and so on.
"""

from typing import Any, TypeAlias

BoolPtr: TypeAlias = Any
F32Ptr: TypeAlias = Any
F64Ptr: TypeAlias = Any
I8Ptr: TypeAlias = Any
I32Ptr: TypeAlias = Any
I64Ptr: TypeAlias = Any
U8Ptr: TypeAlias = Any
U64Ptr: TypeAlias = Any
F32x4: TypeAlias = Any
F32x8: TypeAlias = Any
F32x16: TypeAlias = Any
F32Lanes: TypeAlias = Any  # F32x8 or F32x16: the same functions take both
F32OrLanes: TypeAlias = Any  # np.float32 or F32x16: the same functions take both
