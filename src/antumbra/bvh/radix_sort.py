"""Parallel radix sort of keys with their values, by the least significant digit first.

Each pass counts the digits of every part of the keys, adds up where the keys of each (digit, part) begin, and moves
them there in order. A stable sort has one result: parts and threads do not change it.
"""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import CHUNK, N, new_ticket, run, take
from ..kernels.simd import get, ptr, ptr_at, put

DIGIT_BITS = 8  # 256 places to write to fit in a first-level cache; with 10 bits, 63 took half as long again
_DIGITS = 1 << DIGIT_BITS
_LEAST = 16384  # keys in a part, at least


@kernel
def _count(ticket, keys, shift, counts):
    """Worker: how often each digit occurs in each part."""
    k, mask = ptr(keys), np.int64(_DIGITS - 1)
    first = take(ticket)
    while first >= 0:
        row = ptr_at(counts, first // ticket[CHUNK] * _DIGITS)
        for d in range(_DIGITS):
            put(row, d, 0)
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            d = (np.int64(get(k, i)) >> shift) & mask
            put(row, d, get(row, d) + 1)
        first = take(ticket)


@kernel
def _begin(counts, n):
    """Turn counts into where each part puts its first key of each digit; False if all keys have the same digit."""
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
    """Worker: move each part's keys and values to their places."""
    k, v, out_k, out_v, mask = ptr(keys), ptr(values), ptr(to_keys), ptr(to_values), np.int64(_DIGITS - 1)
    first = take(ticket)
    while first >= 0:
        row = ptr_at(places, first // ticket[CHUNK] * _DIGITS)
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            key = get(k, i)
            d = (np.int64(key) >> shift) & mask
            at = np.int64(get(row, d))
            put(row, d, at + 1)
            put(out_k, at, key)
            put(out_v, at, get(v, i))
        first = take(ticket)


def radix_sort(keys, values, bits: int, threads: int):
    """(keys, values) in ascending order of the keys, equal keys in the order they had.

    Parameters
    ----------
    keys : (n,) int32 or int64, of `bits` bits, which are read without sign
    values : (n,) int32
        Both are overwritten; what is returned may be they, or new arrays.
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
