"""Exact signs by expansion arithmetic [Shewchuk 1997, "Adaptive precision floating-point arithmetic"].

An expansion is an unevaluated sum of float64 numbers that do not overlap, smallest first. All inputs are float32
coordinates. So no product of up to four of them leaves float64's range, and every step below is exact.

This code runs only for the few triangles that the filters of `filters.py` cannot decide, but it is part of every kernel
that uses them. So each function has one call site, which keeps the code short for LLVM. Otherwise this code would take
two thirds of the time to compile kernels.

Expansions, vectors and products are pointers to float64 (`simd.stack_f64`).
"""

import numpy as np

from ..jit import kernel
from ..simd import get, put

PRODUCT = 64  # float64 numbers in a product of a scale and 3 two-part factors
CAPACITY = 18 * PRODUCT  # components of an expansion: three determinants of 6 products
_SPLITTER = np.float64(134217729.0)  # 2**27 + 1


@kernel
def two_diff(a, b):
    """(hi, lo): hi = fl(a - b) and hi + lo == a - b exactly."""
    hi = a - b
    virtual = a - hi
    return hi, (a - (hi + virtual)) + (virtual - b)


@kernel
def two_product(a, b):
    """(hi, lo): hi = fl(a * b) and hi + lo == a * b exactly (Dekker's split; no fused multiply-add needed)."""
    hi = a * b
    c = _SPLITTER * a
    a1 = c - (c - a)
    a2 = a - a1
    c = _SPLITTER * b
    b1 = c - (c - b)
    b2 = b - b1
    return hi, a2 * b2 - (((hi - a1 * b1) - a2 * b1) - a1 * b2)


@kernel
def grow(sum_, n, x):
    """Add the number x to the expansion of n components in place, drop zeros, and return the new length."""
    m = 0
    for i in range(n):
        y = get(sum_, i)
        s = x + y
        virtual = s - x
        low = (x - (s - virtual)) + (y - virtual)
        if low != 0.0:
            put(sum_, m, low)
            m += 1
        x = s
    if x != 0.0:
        put(sum_, m, x)
        m += 1
    return m


@kernel
def _multiply(product, n, hi, lo):
    """Multiply a sum of n numbers by hi + lo in place, and return the new length."""
    step = 2 if lo == 0.0 else 4
    for i in range(n - 1, -1, -1):
        x, at = get(product, i), step * i
        for half in range(0, step, 2):
            p1, p0 = two_product(x, hi if half == 0 else lo)
            put(product, at + half, p0)
            put(product, at + half + 1, p1)
    return step * n


@kernel
def add_determinant(sum_, n, rows, product, scale):
    """Add scale * det(rows) to the expansion, and return the new length.

    rows : three vectors, each of three sums hi + lo
    product : scratch memory of PRODUCT numbers
    """
    for term in range(6):
        i, odd = term % 3, term // 3
        j = (i + 1 + odd) % 3
        put(product, 0, -scale if odd else scale)
        m = 1
        for row in range(3):
            at = 6 * row + 2 * (i if row == 0 else j if row == 1 else 3 - i - j)
            m = _multiply(product, m, get(rows, at), get(rows, at + 1))
        for k in range(m):
            x = get(product, k)
            if x != 0.0:  # three of four are zero if the factors are float32
                n = grow(sum_, n, x)
    return n


@kernel
def sign_of(sum_, n):
    """Sign of an expansion: -1, 0 or 1. The largest component comes last and decides the sign."""
    if n == 0:
        return 0
    return 1 if get(sum_, n - 1) > 0.0 else -1


@kernel
def value_of(sum_, n):
    """The expansion rounded to float64, within one unit in the last place."""
    total = 0.0
    for i in range(n):
        total += get(sum_, i)
    return total
