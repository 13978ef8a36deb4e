"""Parallel radix sort of keys with values, least significant digit first.

Each pass counts the digits in every part of the keys. Prefix sums give the first position of each (digit, part). Then
keys move there in order. The sort is stable, so its result does not depend on parts or threads.
"""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import CHUNK, new_ticket, run, shares
from ..kernels.simd import get, ptr, ptr_at, put

DIGIT_BITS = 8  # 256 write positions fit in a first-level cache; with 10 bits, `lbvh63` took half as long again
_DIGITS = 1 << DIGIT_BITS
_LEAST = 16384  # keys in a part, at least


@kernel
def _count(ticket, keys, shift, counts):
    """Worker: count each digit in each part."""
    k, mask = ptr(keys), np.int64(_DIGITS - 1)
    for first, last in shares(ticket):
        row = ptr_at(counts, first // ticket[CHUNK] * _DIGITS)
        for d in range(_DIGITS):
            put(row, d, 0)
        for i in range(first, last):
            d = (np.int64(get(k, i)) >> shift) & mask
            put(row, d, get(row, d) + 1)


@kernel
def _begin(counts, n):
    """Turn counts into each part's first position for each digit. False if all keys share one digit."""
    at = 0
    for d in range(_DIGITS):
        before = at
        for part in range(len(counts)):
            count = counts[part, d]
            counts[part, d] = at
            at += count
        if at - before == n:
            return False
    return True


@kernel
def _scatter(ticket, keys, values, shift, places, to_keys, to_values):
    """Worker: move each part's keys and values to their positions."""
    # In: keys, values; shift, first bit of the digit; places, (parts, 256) first positions, which are counted up
    # Out: to_keys, to_values
    k, v, out_k, out_v, mask = ptr(keys), ptr(values), ptr(to_keys), ptr(to_values), np.int64(_DIGITS - 1)
    for first, last in shares(ticket):
        row = ptr_at(places, first // ticket[CHUNK] * _DIGITS)
        for i in range(first, last):
            key = get(k, i)
            d = (np.int64(key) >> shift) & mask
            at = np.int64(get(row, d))
            put(row, d, at + 1)
            put(out_k, at, key)
            put(out_v, at, get(v, i))


def radix_sort(keys, values, bits: int, threads: int):
    """(keys, values) in ascending order of the keys. Equal keys keep their order.

    Parameters
    ----------
    keys : (n,) int32 or int64, of `bits` bits, read as unsigned
    values : (n,) int32
        Both are overwritten. The results may be the same arrays or new ones.
    """
    n = len(keys)
    part = max(_LEAST, -(-n // (4 * threads)))
    counts = np.empty((-(-n // part), _DIGITS), np.int32)
    other = np.empty_like(keys), np.empty_like(values)
    for shift in range(0, bits, DIGIT_BITS):
        run(_count, threads, new_ticket(n, part), keys, shift, counts)
        if _begin(counts, n):
            run(_scatter, threads, new_ticket(n, part), keys, values, shift, counts, *other)
            (keys, values), other = other, (keys, values)
    return keys, values
