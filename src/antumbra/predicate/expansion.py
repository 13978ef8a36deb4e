"""Exact signs by expansion arithmetic [Shewchuk 1997, "Adaptive precision floating-point arithmetic"].

An expansion is an unevaluated sum of float64 numbers that do not overlap, smallest first. Everything here starts from
float32 coordinates, so no product of up to four of them leaves float64's range and every step below is exact. This code
runs only for the few triangles that the filters of `filters.py` cannot decide, so it is written to be short.
"""

import numpy as np

from ..jit import kernel

CAPACITY = 1024  # components: two determinants of 6 products of 3 two-part factors and a scale need at most 768
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
    """Add the number x to the expansion ``sum_[:n]`` in place; the new length (zero components are dropped)."""
    m = 0
    for i in range(n):
        s = x + sum_[i]
        virtual = s - x
        low = (x - (s - virtual)) + (sum_[i] - virtual)
        if low != 0.0:
            sum_[m] = low
            m += 1
        x = s
    if x != 0.0:
        sum_[m] = x
        m += 1
    return m


@kernel
def _add_product(sum_, n, a, b, c, scale):
    p1, p0 = two_product(a, b)
    for p in (p0, p1):
        if p != 0.0:
            q1, q0 = two_product(p, c)
            for q in (q0, q1):
                if q != 0.0:
                    r1, r0 = two_product(q, scale)
                    n = grow(sum_, n, r0)
                    n = grow(sum_, n, r1)
    return n


@kernel
def add_determinant(sum_, n, rows, scale):
    """Add scale * det(rows) to the expansion; the new length.

    ``rows`` is (3, 3, 2) float64: three vectors whose components are sums hi + lo.
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for half in range(8):
            x = rows[0, i, half & 1]
            if x == 0.0:
                continue
            h, l = (half >> 1) & 1, half >> 2
            n = _add_product(sum_, n, x, rows[1, j, h], rows[2, k, l], scale)
            n = _add_product(sum_, n, x, rows[1, k, h], rows[2, j, l], -scale)
    return n


@kernel
def sign_of(sum_, n):
    """Sign of an expansion: -1, 0 or 1. Its largest component comes last and outweighs all others."""
    if n == 0:
        return 0
    return 1 if sum_[n - 1] > 0.0 else -1


@kernel
def value_of(sum_, n):
    """The expansion rounded to float64, within one unit in the last place."""
    total = 0.0
    for i in range(n):
        total += sum_[i]
    return total
