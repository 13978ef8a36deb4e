"""Transposition of vectors of eight float32: of a matrix, or of two side by side."""

import numpy as np

from .jit import inlined
from .simd import mask_from_bits8, select, shuffle, swap_halves


@inlined
def _exchange(a, b, other_a, other_b, lower):
    """A step of a transposition: exchange lanes of two vectors; lower (bits): the lanes that the first one retains."""
    mask = mask_from_bits8(np.int64(lower))
    return select(mask, a, other_b), select(mask, other_a, b)


@inlined
def _by_1(a, b):
    return _exchange(a, b, shuffle(a, 1, 0, 3, 2, 5, 4, 7, 6), shuffle(b, 1, 0, 3, 2, 5, 4, 7, 6), 0b01010101)


@inlined
def _by_2(a, b):
    return _exchange(a, b, shuffle(a, 2, 3, 0, 1, 6, 7, 4, 5), shuffle(b, 2, 3, 0, 1, 6, 7, 4, 5), 0b00110011)


@inlined
def _by_4(a, b):
    return _exchange(a, b, swap_halves(a), swap_halves(b), 0b00001111)


@inlined
def transposed8(a, b, c, d, e, f, g, h):
    """The columns of a matrix of eight rows."""
    (a, b), (c, d), (e, f), (g, h) = _by_1(a, b), _by_1(c, d), _by_1(e, f), _by_1(g, h)
    (a, c), (b, d), (e, g), (f, h) = _by_2(a, c), _by_2(b, d), _by_2(e, g), _by_2(f, h)
    (a, e), (b, f), (c, g), (d, h) = _by_4(a, e), _by_4(b, f), _by_4(c, g), _by_4(d, h)
    return a, b, c, d, e, f, g, h


@inlined
def transposed4(a, b, c, d):
    """The columns of two matrices of four rows and columns, side by side."""
    (a, b), (c, d) = _by_1(a, b), _by_1(c, d)
    (a, c), (b, d) = _by_2(a, c), _by_2(b, d)
    return a, b, c, d
