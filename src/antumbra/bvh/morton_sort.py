"""Morton codes of triangles, and the parallel radix sort that orders them.

Morton codes interleave the bits of a centroid's x, y and z cell [Lauterbach et al. 2009]: 10 bits per axis in an int32,
or 21 in an int64. Cells are cubes, so a flat scene is not split along its short side before its long sides.

The radix sort orders keys with values, least significant digit first. Each pass counts the digits in every part of the
keys, computes the first position of each (digit, part) by prefix sums, and moves the keys there in order. The sort is
stable, so its result does not depend on parts or threads.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..kernels.array_pool import recycled_empty
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, items, new_ticket, run_short, shares
from ..kernels.simd import extract, get, load4, maximum, minimum, ptr, ptr_at, put, to_i32
from .triangle_bounds import double_centroid_of

# --- Morton codes -----------------------------------------------------------------------------------------------------


_TEN = np.int32(1023)

Codes: TypeAlias = np.int32 | np.int64


class Grid(NamedTuple):
    """Maps twice a centroid to its cell: truncate((c - origin) * factor)."""

    origin: NDArray[np.float32]  # (4,) float32
    factor: np.float32  # 0 if all centroids (nearly) coincide
    last: np.int32  # the last cell on each axis


def grid_of(centroids: NDArray[np.float32], bits: int) -> Grid:
    """The grid over a centroid box, with 2 ** bits cubic cells along its longest side."""
    lower, upper = centroids[:4], -centroids[4:]
    with np.errstate(over="ignore", divide="ignore"):
        factor = np.float32(2**bits) / (upper - lower)[:3].max()
    return Grid(lower.copy(), factor if np.isfinite(factor) else np.float32(0.0), np.int32(2**bits - 1))


@inlined
def _interleave(cells):
    """The lowest ten bits of three lanes, interleaved to 30 bits."""
    x = cells & _TEN
    x = (x | (x << 16)) & 0x030000FF
    x = (x | (x << 8)) & 0x0300F00F
    x = (x | (x << 4)) & 0x030C30C3
    x = (x | (x << 2)) & 0x09249249
    return np.int64(extract(x, 0) << 2 | extract(x, 1) << 1 | extract(x, 2))


@inlined
def _code(cells, last):
    """The code of a cell: 30 bits, or 63 if cells have more than ten bits per axis."""
    code = _interleave(cells)
    if last > _TEN:
        code |= _interleave(cells >> 10) << 30 | _interleave(cells >> 20) << 60
    return code


@inlined
def code_of_triangle(vertices, i, origin, factor, last):
    """The code of triangle `i` in the grid of these numbers; `origin` is a vector."""
    cells = to_i32((double_centroid_of(vertices, i) - origin) * factor)
    return _code(minimum(maximum(cells, np.int32(0)), last), last)


@kernel
def write_codes(ticket, vertices, grid, codes, ids):
    """Worker: write the code and the index of each triangle."""
    v, out, out_ids = ptr(vertices), ptr(codes), ptr(ids)
    origin, factor, last = load4(grid.origin, 0), grid.factor, grid.last
    for i in items(ticket):
        put(out, i, code_of_triangle(v, i, origin, factor, last))
        put(out_ids, i, i)


# --- Radix sort -------------------------------------------------------------------------------------------------------


_NARROW, _WIDE = 8, 10  # bits of a digit
_LEAST = 8192  # minimum keys in a part


def _digit_bits(bits: int) -> int:
    """The bits of a digit, for keys of `bits` bits.

    The write positions of narrow digits fit in the L1 cache; 10 bits made `lbvh63` 1.5 times as slow. Three passes over
    30 bits still take only three quarters of the time of four.
    """
    return _WIDE if bits <= 3 * _WIDE else _NARROW


@kernel
def _count(ticket, keys, shift, counts):
    """Worker: count each digit in each part."""
    k, digits = ptr(keys), counts.shape[1]
    for first, last in shares(ticket):
        row = ptr_at(counts, first // ticket[CHUNK] * digits)
        for d in range(digits):
            put(row, d, 0)
        for i in range(first, last):
            d = (get(k, i) >> shift) & (digits - 1)
            put(row, d, get(row, d) + 1)


@kernel
def _prefix_sums(counts, n):
    """Turn the counts into the first position of each digit in each part. False if all keys have the same digit."""
    at = 0
    for d in range(counts.shape[1]):
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
    # In: keys, values; shift, first bit of the digit; places, (parts, digits) first positions, which are incremented
    # Out: to_keys, to_values
    k, v, out_k, out_v, digits = ptr(keys), ptr(values), ptr(to_keys), ptr(to_values), places.shape[1]
    for first, last in shares(ticket):
        row = ptr_at(places, first // ticket[CHUNK] * digits)
        for i in range(first, last):
            key = get(k, i)
            d = (np.int64(key) >> shift) & (digits - 1)
            at = get(row, d)
            put(row, d, at + 1)
            put(out_k, at, key)
            put(out_v, at, get(v, i))


def radix_sort(
    keys: NDArray[Codes], values: NDArray[np.int32], bits: int, threads: int
) -> tuple[NDArray[Codes], NDArray[np.int32]]:
    """(keys, values) sorted by key in ascending order. Equal keys keep their order.

    Parameters
    ----------
    keys : (n,) int32 or int64, of `bits` bits, treated as unsigned
    values : (n,) int32
        Both arrays are overwritten. The results may be these arrays or new ones.
    """
    n, digit = len(keys), _digit_bits(bits)
    part = max(_LEAST, -(-n // (4 * threads)))
    counts = np.empty((-(-n // part), 1 << digit), np.int32)
    other = recycled_empty((n,), keys.dtype), recycled_empty((n,), values.dtype)
    for shift in range(0, bits, digit):
        run_short(_count, threads, new_ticket(n, part), keys, shift, counts)
        if _prefix_sums(counts, n):
            run_short(_scatter, threads, new_ticket(n, part), keys, values, shift, counts, *other)
            (keys, values), other = other, (keys, values)
    return keys, values
