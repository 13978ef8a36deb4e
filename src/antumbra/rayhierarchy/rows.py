"""The triangle data of node tests: 16 triangles side by side, with one row of 16 numbers per quantity.

The numbers of a triangle are 16 apart. So 16 triangles can be written at once, and each one read separately.
"""

import numpy as np

from ..kernels.jit import inlined
from ..kernels.simd import as_i32, broadcast16, get, put

LANES = 16
NUMBERS = 56
"""Numbers per triangle. The first 16 are the four outer planes, by which tests reject nodes."""

OUTER, INNER, TRIANGLE, COVERS = 0, 16, 54, 55
"""Positions of the outer planes, inner planes (see `planes`), soup index, and whether all inner planes are known.

The modules that write rows name the other positions."""

BLOCK = NUMBERS * LANES
"""Numbers of 16 triangles."""


@inlined
def number(row, k):
    """Number k of a triangle; row: pointer to its first number."""
    return get(row, LANES * k)


@inlined
def number16(row, k):
    """Number k of a triangle, in all lanes."""
    return broadcast16(row, LANES * k)


@inlined
def put_number(row, k, x):
    """Write number k of a triangle."""
    put(row, LANES * k, x)


@inlined
def whole(row, k):
    """Number k of a triangle, read as an int32."""
    return np.int64(get(as_i32(row), LANES * k))


@inlined
def put_whole(row, k, x):
    """Write number k of a triangle as an int32."""
    put(as_i32(row), LANES * k, x)
