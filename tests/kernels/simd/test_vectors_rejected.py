"""The compiler rejects code that is no vector operation, with a message that names the cure."""

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

from antumbra.kernels import simd

F32, I32, I64 = np.ones(16, np.float32), np.ones(16, np.int32), np.ones(16, np.int64)
READ_ONLY = np.ones(16, np.float32)
READ_ONLY.flags.writeable = False

CASES = {
    "load8: float32 or int32": (lambda a: simd.store(a, 0, simd.load8(a, 0)), I64),
    "C-contiguous": (lambda a: simd.bits(simd.load4(a, 0) < 1), F32[::2]),
    "read-only": (lambda a: simd.store(a, 0, simd.load4(a, 0)), READ_ONLY),
    "array's own element type": (lambda a: simd.store(a, 0, simd.iota4()), F32),
    "index must be an integer": (lambda a: simd.get(a, 0.5), F32),
    "needs an int64 array": (lambda a: simd.atomic_add(a, 0, 1), I32),
    "needs an int32 array": (lambda a: simd.atomic_or(a, 0, 1), I64),
    "needs an int32 array or pointer": (lambda a: simd.atomic_and(a, 0, 1), F32),
    "vector of int32: gather": (lambda a: simd.store(a, 0, simd.gather(a, simd.load4(a, 0))), F32),
    "float32 or int32": (lambda a: simd.bits(simd.gather(a, simd.iota4()) < 1), I64),
    "square_root: vectors? of float32": (lambda a: simd.bits(simd.square_root(simd.iota4()) < 0), F32),
    "positive literal": (lambda a: simd.get(simd.stack_f32(a[0]), 0), I32),
    "one width": (lambda a: simd.bits(simd.minimum(simd.load4(a, 0), simd.load8(a, 0)) < 0), F32),
    "vectors of float32": (lambda a: simd.bits(simd.fma(simd.iota4(), 2, 3) < 0), F32),
    "not all": (lambda a: simd.minimum(a[0], a[1]), F32),
    "must be a mask4": (lambda a: simd.bits(simd.select(simd.load8(a, 0) < 0, simd.load4(a, 0), 0) < 0), F32),
    "two vectors of one type": (lambda a: simd.store(a, 0, simd.join(simd.load4(a, 0), simd.load8(a, 0))), F32),
    "of 4 or 8 lanes": (lambda a: simd.store(a, 0, simd.join(simd.load16(a, 0), simd.load16(a, 0))), F32),
    "one index per lane": (lambda a: simd.bits(simd.shuffle(simd.load4(a, 0), 0, 1) < 0), F32),
    "literal integers from 0 to 3": (
        lambda a: simd.bits(simd.shuffle(simd.load4(a, 0), 0, 1, 2, 4) < 0),
        F32,
    ),
    "vector of boolean": (lambda a: simd.bits(simd.load4(a, 0)), F32),
    "vector of int32": (lambda a: simd.bits(simd.to_f32(simd.load4(a, 0)) < 0), F32),
    # Operators: Numba makes these messages itself.
    "add.*f32x4, i32x4": (lambda a: simd.bits(simd.load4(a, 0) + simd.iota4() < 0), F32),
    "add.*f32x4, f32x8": (lambda a: simd.bits(simd.load4(a, 0) + simd.load8(a, 0) < 0), F32),
    "truediv.*i32x4": (lambda a: simd.bits(simd.load4(a, 0) / 2 < 0), I32),
    "lshift.*f32x4": (lambda a: simd.bits(simd.load4(a, 0) << 1 < 0), F32),
    "add.*i32x4, float": (lambda a: simd.bits(simd.load4(a, 0) + 0.5 < 0), I32),
    "add.*mask4": (lambda a: simd.bits((simd.load4(a, 0) < 0) + True), I32),
    "bool.*mask4": (lambda a: 1 if simd.load4(a, 0) < 0 else 2, I32),
}


@pytest.mark.parametrize("message", CASES)
def test_rejected(message):
    function, array = CASES[message]
    with pytest.raises(NumbaError, match=f"(?s){message.partition(': ')[2] or message}"):
        numba.njit(function)(array)
